//! TrackMovie: a track drawn over its clip, and how near it came to the truth where that is known.

use heartian_capture::overlay::Overlay;
use heartian_capture::synthetic::GroundTruth;
use heartian_capture::{CaptureError, network_iou};
use heartian_face::models::{self, Set, State};
use heartian_face::{Observations, Track};
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, SourceFile, params, register};
use heartian_space::{Clip, Metrics};

params! {
    /// Draws mesh, landmarks, irises, the crop that the landmark network reads, and the matte's edge over the clip; frames
    /// without a face get a red border. Of a synthetic recording it also says how near the track came to the truth.
    pub struct TrackMovie {
        /// How much is drawn, from the clip's start.
        seconds: f64 = 8.0, unit("s"), range(0.1, 600.0);
        /// Picture pixels for each pixel of the clip.
        scale: usize = 2, range(1.0, 8.0);
        /// Of a synthetic recording, so many frames are matted by the installed person network and held against their true
        /// matte (`matte.iou`); 0 for none.
        matte_frames: usize = 24, range(0.0, 600.0);
    }
}
register!(TrackMovie);

impl Node for TrackMovie {
    const KIND: &'static str = "TrackMovie";
    const REVISION: u32 = 4;
    const INPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The clip that was tracked."),
        Port::one::<Track>("track", "Its track."),
        Port::one::<Observations>("landmarks", "The landmarks fitted; without, they and the crop are not drawn.")
            .optional(),
        Port::one::<GroundTruth>("truth", "The truth of a synthetic recording, to score the track by.").optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The drawing, labelled `tracked`."),
        Port::one::<Metrics>(
            "metrics",
            "frames.count and, with a truth, track.*: rotation, jaw and blinks; matte.iou.",
        ),
    ];

    fn sources(&self) -> Vec<SourceFile> {
        // What is not installed is not used: with the networks come other figures, so another key.
        let all = if self.matte_frames > 0 { models::list().unwrap_or_default() } else { Vec::new() };
        let there = all.into_iter().filter(|model| model.set == Set::Face && model.state == State::Installed);
        there.map(|model| SourceFile::new("matte_frames", model.path)).collect()
    }

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let (clip, track) = (inputs.get::<Clip>("clip")?, inputs.get::<Track>("track")?);
        let landmarks = inputs.optional::<Observations>("landmarks")?;
        let overlay = Overlay { clip: &clip, track: &track, observations: landmarks.as_deref(), scale: self.scale };
        let end = clip.times_seconds.partition_point(|time| *time < clip.times_seconds[0] + self.seconds);
        let movie = overlay.movie(0..end)?;
        let mut metrics = Metrics::new().with("frames.count", clip.len() as f64);
        if let Some(truth) = inputs.optional::<GroundTruth>("truth")? {
            let scores = truth.score(&track);
            metrics = metrics
                .with("track.rotation_error_deg", scores.rotation_error_deg)
                .with("track.landmark_error_fraction", scores.landmark_error_fraction)
                .with("track.jaw_correlation", scores.jaw_correlation)
                .with("track.blink_f1", scores.blink_f1)
                .with("track.blink_frame_f1", scores.blink_frame_f1);
            if scores.gaze_correlation.is_finite() {
                metrics = metrics.with("track.gaze_correlation", scores.gaze_correlation);
            }
            if let (Some(seen), 1..) = (&landmarks, self.matte_frames) {
                match network_iou(&clip, seen, self.matte_frames) {
                    Ok(iou) => metrics = metrics.with("matte.iou", iou),
                    Err(CaptureError::Models(_)) => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
        Ok(Outputs::new().put("clip", movie).put("metrics", metrics))
    }
}
