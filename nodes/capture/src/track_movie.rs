//! TrackMovie: a track drawn over its clip, and how near it came to the truth where that is known.

use heartian_capture::overlay::Overlay;
use heartian_capture::synthetic::GroundTruth;
use heartian_face::{Observations, Track};
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_space::{Clip, Metrics};

params! {
    /// Draws mesh, landmarks, the crop that the landmark network reads, and the matte's edge over the clip; frames without
    /// a face get a red border. Of a synthetic recording it also says how near the track came to the truth.
    pub struct TrackMovie {
        /// How much is drawn, from the clip's start.
        seconds: f64 = 8.0, unit("s"), range(0.1, 600.0);
        /// Picture pixels for each pixel of the clip.
        scale: usize = 2, range(1.0, 8.0);
    }
}
register!(TrackMovie);

impl Node for TrackMovie {
    const KIND: &'static str = "TrackMovie";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The clip that was tracked."),
        Port::one::<Track>("track", "Its track."),
        Port::one::<Observations>("landmarks", "The landmarks fitted; without, they and the crop are not drawn.")
            .optional(),
        Port::one::<GroundTruth>("truth", "The truth of a synthetic recording, to score the track by.").optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The drawing, labelled `tracked`."),
        Port::one::<Metrics>("metrics", "frames.count and, with a truth, track.*: rotation, jaw and blinks."),
    ];

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
        }
        Ok(Outputs::new().put("clip", movie).put("metrics", metrics))
    }
}
