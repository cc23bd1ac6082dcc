//! What is foretold of the errors against the errors made: landmarks that err alone, that err together, and that are missing.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};

use crate::tracker::tests::{Random, Scene, scene, silent};
use crate::{FaceError, HeadModel, Landmark, Observations, Track, TrackOptions, TrackSigma, track};

/// Adds to every frame an error that is smooth over the face: each landmark's is a mean of a few waves across it.
fn smear(scene: &Scene, rms_px: f64, seed: u64) -> Result<Observations, FaceError> {
    let mut random = Random(seed);
    let frames = (0..scene.observations.len())
        .map(|t| {
            // Waves of about the face's own size, other ones in every frame.
            let waves: Vec<[f64; 5]> =
                (0..12).map(|_| [0.06, 0.06, TAU, 1.0, 1.0].map(|size| size * random.normal())).collect();
            let moved: Vec<Landmark> = scene
                .observations
                .frame(t)
                .map(|mut landmark| {
                    let [x, y] = landmark.position_px.map(f64::from);
                    for [across, down, phase, right, below] in &waves {
                        let height = rms_px * (across * x + down * y + phase).sin() * (2.0 / 12.0_f64).sqrt();
                        landmark.position_px[0] += (height * right) as f32;
                        landmark.position_px[1] += (height * below) as f32;
                    }
                    landmark
                })
                .collect();
            scene.observations.has_face(t).then_some(moved)
        })
        .collect();
    Observations::new(256, 256, scene.observations.times_seconds.clone(), frames)
}

/// Root mean squares over the frames fitted: error of the turn against the clip's mean, what was foretold; the same of the
/// jaw, degrees.
fn spread(scene: &Scene, track: &Track) -> [[f64; 2]; 2] {
    let turn = |v: [f32; 3]| DQuat::from_scaled_axis(DVec3::from_array(v.map(f64::from)));
    let fitted: Vec<usize> = (0..track.frames.len()).filter(|&t| track.frames[t].fitted).collect();
    let count = fitted.len() as f64;
    let rms = |values: &[f64]| (values.iter().map(|value| value * value).sum::<f64>() / count).sqrt();
    let off = |t: usize| (turn(scene.poses[t].rotation).inverse() * turn(track.frames[t].rotation)).to_scaled_axis();
    let mean = fitted.iter().map(|&t| off(t)).sum::<DVec3>() / count;
    let turns: Vec<f64> = fitted.iter().map(|&t| (off(t) - mean).length().to_degrees()).collect();
    let foretold: Vec<f64> = fitted.iter().map(|&t| track.sigma.turn_deg(t)).collect();
    let jaw = |t: usize| f64::from(track.frames[t].jaw[0] - scene.poses[t].jaw[0]).to_degrees();
    let mean_jaw = fitted.iter().map(|&t| jaw(t)).sum::<f64>() / count;
    let jaws: Vec<f64> = fitted.iter().map(|&t| jaw(t) - mean_jaw).collect();
    let foretold_jaw: Vec<f64> = fitted.iter().map(|&t| f64::from(track.sigma.jaw_deg[t])).collect();
    [[rms(&turns), rms(&foretold)], [rms(&jaws), rms(&foretold_jaw)]]
}

#[test]
fn errors_are_as_large_as_foretold_whether_landmarks_err_alone_or_together() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    for (noise_px, smeared_px) in [(1.0, 0.0), (2.0, 0.0), (0.3, 1.0)] {
        let scene = scene(&head, 100, (noise_px, 0.05), 17)?;
        let observations = smear(&scene, smeared_px, 23)?;
        let found =
            track(&head, &observations, &TrackOptions { key_frames: 12, ..TrackOptions::default() }, &mut silent)?;
        for (what, [error, foretold]) in ["turn", "jaw"].into_iter().zip(spread(&scene, &found)) {
            println!(
                "{noise_px} px alone, {smeared_px} px together: {what} off by {error:.3}°, foretold {foretold:.3}°"
            );
            assert!((0.5..2.0).contains(&(foretold / error)), "{what}: {error} {foretold}");
        }
    }
    Ok(())
}

#[test]
fn a_focal_length_is_refined_where_the_clip_determines_it_and_kept_where_not() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    // Near the camera and turning, seen well: guessed a quarter too long. The same through a haze: nothing can be told.
    for (noise_px, refined) in [(0.5, true), (5.0, false)] {
        let scene = scene(&head, 80, (noise_px, 0.0), 31)?;
        let options = TrackOptions { focal_px: Some(1.25 * 307.2), key_frames: 12, ..TrackOptions::default() };
        let found = track(&head, &scene.observations, &options, &mut silent)?;
        let percent = found.sigma.focal_percent.map_or(f64::NAN, f64::from);
        let off = 100.0 * (f64::from(found.camera.focal_px[0]) / 307.2).ln();
        println!("{noise_px} px: focal length off by {off:.1} %, foretold {percent:.1} %");
        assert_eq!((off - 100.0 * 1.25_f64.ln()).abs() > 1e-3, refined);
        assert!(!refined || off.abs() < 3.0 * percent, "{off} {percent}");
    }
    Ok(())
}

#[test]
fn a_frame_that_shows_less_is_less_sure() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    let scene = scene(&head, 60, (0.7, 0.0), 4)?;
    let few = |t: usize, keep: &dyn Fn(usize) -> bool| -> Option<Vec<Landmark>> {
        let all = scene.observations.frame(t).enumerate().filter(|(k, _)| t != 20 || keep(*k));
        scene.observations.has_face(t).then(|| all.map(|(_, landmark)| landmark).collect())
    };
    let sigma = |keep: &dyn Fn(usize) -> bool| -> Result<TrackSigma, FaceError> {
        let frames = (0..60).map(|t| few(t, keep)).collect();
        let observations = Observations::new(256, 256, scene.observations.times_seconds.clone(), frames)?;
        let options = TrackOptions { key_frames: 6, ..TrackOptions::default() };
        Ok(track(&head, &observations, &options, &mut silent)?.sigma)
    };
    let (all, half, none) = (sigma(&|_| true)?, sigma(&|k| k % 2 == 0)?, sigma(&|_| false)?);
    let turns = [&all, &half, &none].map(|sigma| sigma.turn_deg(20));
    assert!(turns[0] < turns[1] && turns[1] < turns[2], "{turns:?}");
    let lids = [&all, &half, &none].map(|sigma| sigma.eyelids[20][0]);
    assert!(lids[0] < lids[1] && lids[1] < lids[2], "{lids:?}");
    // A frame without a face between its neighbours (the scene has three).
    assert!(all.turn_deg(31) > all.turn_deg(28), "{} {}", all.turn_deg(31), all.turn_deg(28));
    assert!(all.median_turn_deg() > 0.0 && TrackSigma::default().median_turn_deg().is_nan());
    Ok(())
}
