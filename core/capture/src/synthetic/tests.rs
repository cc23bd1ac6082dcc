//! Laws of the synthetic recording as a whole.

use super::*;
use heartian_artifact::{Artifact, BundleReader};
use heartian_space::color::linear_from_srgb;

fn still() -> SyntheticOptions {
    SyntheticOptions { seconds: 8.0, size: 96, motion: 0.0, pulse_strength: 0.03, ..SyntheticOptions::default() }
}

fn record(options: &SyntheticOptions) -> Result<SyntheticRecording, CaptureError> {
    generate(options, &mut |_| ControlFlow::Continue(()))
}

/// Mean linear RGB of each frame over the pixels that are skin in every frame.
fn skin_traces(recording: &SyntheticRecording) -> [Vec<f64>; 3] {
    let (clip, truth) = (&recording.clip, &recording.truth);
    let pixels: Vec<usize> = (0..clip.width * clip.height)
        .filter(|pixel| (0..clip.len()).all(|frame| truth.is_skin(frame, *pixel)))
        .collect();
    assert!(pixels.len() > clip.width * clip.height / 10, "{} pixels of skin", pixels.len());
    std::array::from_fn(|channel| {
        let light = |frame: usize, pixel: &usize| {
            f64::from(linear_from_srgb(f32::from(clip.frame(frame)[3 * pixel + channel]) / 255.0))
        };
        (0..clip.len())
            .map(|frame| pixels.iter().map(|pixel| light(frame, pixel)).sum::<f64>() / pixels.len() as f64)
            .collect()
    })
}

/// Relative change of a trace for a unit of pulse, and their correlation.
fn response(trace: &[f64], pulse: &[f64]) -> (f64, f64) {
    let count = trace.len() as f64;
    let (mean, centre) = (trace.iter().sum::<f64>() / count, pulse.iter().sum::<f64>() / count);
    let (mut together, mut own, mut drive) = (0.0, 0.0, 0.0);
    for (value, pulse) in trace.iter().zip(pulse) {
        let (value, pulse) = (value / mean - 1.0, pulse - centre);
        together += value * pulse;
        own += value * value;
        drive += pulse * pulse;
    }
    (together / drive, together / (own * drive).sqrt())
}

#[test]
fn bytes_do_not_depend_on_the_number_of_threads() -> Result<(), Box<dyn std::error::Error>> {
    let options = SyntheticOptions { seconds: 0.7, size: 64, ..SyntheticOptions::default() };
    let with = |threads: usize| -> Result<_, Box<dyn std::error::Error>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        Ok(pool.install(|| record(&options))?)
    };
    let one = with(1)?;
    assert!(one == with(2)?, "one thread and two differ");
    assert!(one.clip.frames != record(&SyntheticOptions { seed: 2, ..options })?.clip.frames, "the seed matters");
    Ok(())
}

#[test]
fn skin_darkens_with_blood_as_much_as_asked() -> Result<(), CaptureError> {
    let recording = record(&still())?;
    let responses = skin_traces(&recording).map(|trace| response(&trace, &recording.truth.pulse));
    let [red, green, blue] = responses.map(|(slope, _)| slope);
    assert!(responses[1].1 < -0.98, "correlation of green with blood: {}", responses[1].1);
    // The face's mean strength lies between the neck's 0.4 and the cheeks' 1.0, and a few percent of the light is gloss.
    assert!((-1.0..-0.5).contains(&(green / 0.03)), "{green}");
    assert!((red / green - 0.30).abs() < 0.05 && (blue / green - 0.55).abs() < 0.08, "{red} {green} {blue}");
    let twice = record(&SyntheticOptions { pulse_strength: 0.06, ..still() })?;
    let doubled = response(&skin_traces(&twice)[1], &twice.truth.pulse).0;
    assert!((doubled / green - 2.0).abs() < 0.03, "{doubled} {green}");
    Ok(())
}

#[test]
fn without_pulse_the_light_carries_none() -> Result<(), CaptureError> {
    let recording = record(&SyntheticOptions { pulse_strength: 0.0, ..still() })?;
    for trace in skin_traces(&recording) {
        let (slope, correlation) = response(&trace, &recording.truth.pulse);
        assert!(slope.abs() < 0.03 * 0.03 && correlation.abs() < 0.3, "{slope} {correlation}");
    }
    Ok(())
}

#[test]
fn the_matte_is_full_on_the_face_soft_at_the_rim_and_gone_below_the_neck() -> Result<(), CaptureError> {
    let recording = record(&SyntheticOptions { seconds: 1.0, frames_per_second: 5.0, ..SyntheticOptions::default() })?;
    let (clip, size) = (&recording.clip, 256);
    for frame in 0..clip.len() {
        let alpha = clip.frame_alpha(frame);
        let share = |range: std::ops::RangeInclusive<u8>| {
            alpha.iter().filter(|a| range.contains(a)).count() as f64 / alpha.len() as f64
        };
        assert_eq!(alpha[size / 2 * size + size / 2], 255);
        assert!((0.2..0.6).contains(&share(250..=255)) && share(0..=0) > 0.4);
        assert!((0.004..0.08).contains(&share(10..=245)), "{}", share(10..=245));
        let border = (0..size).flat_map(|i| [i, size * (size - 1) + i, i * size, i * size + size - 1]);
        assert!(border.into_iter().all(|pixel| alpha[pixel] == 0), "the head lies inside the picture");
        let down_the_neck: Vec<u8> = (size / 2..size).map(|y| alpha[y * size + size / 2]).collect();
        assert!(down_the_neck.windows(2).all(|pair| pair[0].abs_diff(pair[1]) < 60), "the neck fades, it is not cut");
    }
    Ok(())
}

#[test]
fn landmarks_are_projections_of_the_true_head_plus_the_noise_asked_for() -> Result<(), CaptureError> {
    let noisy = SyntheticOptions { seconds: 6.0, size: 64, ..SyntheticOptions::default() };
    let (seen, exact) = (record(&noisy)?, record(&SyntheticOptions { landmark_noise_px: 0.0, ..noisy.clone() })?);
    let track = &seen.truth.track;
    let head = track.baked_head();
    let (mut square, mut lagged, mut count, mut missing) = (0.0, 0.0, 0.0, 0);
    let mut before = vec![None; 478];
    for frame in 0..seen.clip.len() {
        let world = head.pose(&track.frames[frame]);
        let irises = head.irises(&track.frames[frame]);
        let of_mesh = |landmark: &heartian_face::Landmark| landmark.index < 468;
        missing += head.landmarks.len() - seen.observations.frame(frame).filter(of_mesh).count();
        for (noisy, exact) in seen.observations.frame(frame).zip(exact.observations.frame(frame)) {
            let anchor = head.landmarks.iter().find(|anchor| anchor.index == exact.index);
            let of_head = anchor.map(|anchor| head.landmark_position(anchor, &world));
            let of_iris = || irises[usize::from(exact.index == 468)].map(|iris| iris.centre);
            let point = of_head.or_else(of_iris);
            let truth = point.and_then(|point| track.camera.project(Vec3::from_array(point)));
            assert!(truth.is_some_and(|truth| truth.distance(exact.position_px.into()) < 1e-3));
            assert!((0.0..=1.0).contains(&noisy.weight));
            let error = f64::from(noisy.position_px[0] - exact.position_px[0]);
            square += error * error;
            lagged += error * before[noisy.index as usize].unwrap_or(0.0);
            before[noisy.index as usize] = Some(error);
            count += 1.0;
        }
    }
    let rms = (square / count).sqrt();
    assert!((rms / 0.6 - 1.0).abs() < 0.03, "{rms}");
    assert!((lagged / square - 0.5).abs() < 0.05, "errors last a little: {}", lagged / square);
    assert!(missing > 0, "single points drop out");
    Ok(())
}

#[test]
fn landmarks_that_turn_away_lose_weight() -> Result<(), CaptureError> {
    let recording = record(&SyntheticOptions { size: 64, motion: 2.0, ..SyntheticOptions::default() })?;
    let mut lowest = f32::MAX;
    let (mut faceless, mut middle) = (0, f32::MAX);
    for frame in 0..recording.clip.len() {
        faceless += usize::from(!recording.observations.has_face(frame));
        for landmark in recording.observations.frame(frame) {
            lowest = lowest.min(landmark.weight);
            if landmark.index == 9 {
                middle = middle.min(landmark.weight);
            }
        }
    }
    assert!(lowest < 0.3 && middle > 0.9, "oval {lowest}, forehead {middle}");
    assert!((1..20).contains(&faceless), "a few whole frames of {} are missed: {faceless}", recording.clip.len());
    Ok(())
}

#[test]
fn contact_trace_spans_the_clip_and_truth_survives_the_disk() -> Result<(), Box<dyn std::error::Error>> {
    let recording = record(&SyntheticOptions { seconds: 0.9, size: 48, ..SyntheticOptions::default() })?;
    assert_eq!(recording.clip.label, "input");
    assert_eq!(recording.ppg.resampled(&recording.clip.times_seconds, 0.0)?.len(), 27);
    let bytes = recording.truth.to_bundle()?.to_bytes()?;
    assert!(GroundTruth::from_bundle(BundleReader::new(&bytes)?)? == recording.truth);
    let cut = GroundTruth { pulse: vec![0.0; 3], ..recording.truth.clone() };
    assert!(
        cut.to_bundle().is_err()
            || GroundTruth::from_bundle(BundleReader::new(&cut.to_bundle()?.to_bytes()?)?).is_err()
    );
    Ok(())
}

#[test]
fn one_frame_and_cancellation_have_defined_answers() -> Result<(), CaptureError> {
    let shortest = record(&SyntheticOptions { seconds: 0.001, size: 32, ..SyntheticOptions::default() })?;
    assert_eq!((shortest.clip.len(), shortest.truth.pulse.len()), (1, 1));
    let stopped = generate(&still(), &mut |_| ControlFlow::Break(()));
    assert!(matches!(stopped, Err(CaptureError::Cancelled)));
    assert!(matches!(record(&SyntheticOptions { seconds: f64::NAN, ..still() }), Err(CaptureError::Option { .. })));
    Ok(())
}
