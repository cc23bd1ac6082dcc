//! FlameTracker: a head model with FLAME's interface fitted to the landmarks of a clip.

use heartian_capture::observe_clip;
use heartian_face::{FaceError, HeadModel, Observations, Track, TrackOptions, track};
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_space::{Clip, Labels, Metrics, Progress};

params! {
    /// Fits one head and camera, and a pose, jaw, expression and eyelids per frame, by damped Gauss–Newton. It sees landmarks
    /// and nothing else: those wired in, or those it finds in the clip itself with the installed face models.
    pub struct FlameTracker {
        /// Focal length; a face crop of a webcam has about 2.
        focal: f64 = 2.2, unit("picture widths"), range(0.3, 50.0);
        /// Refine the focal length; sensible when the head turns or comes nearer a good deal.
        refine_focal: bool = false;
        /// Strength of the temporal terms; 0 leaves frames independent.
        smoothness: f64 = 1.0, range(0.0, 1000.0);
        /// Key frames that decide the identity.
        key_frames: usize = 24, range(1.0, 1000.0);
    }
}
register!(FlameTracker);

impl Node for FlameTracker {
    const KIND: &'static str = "FlameTracker";
    const REVISION: u32 = 2;
    const INPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The clip to track."),
        Port::one::<Observations>("landmarks", "Landmarks seen in it; without, the face models look for them.")
            .optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Track>("track", "Head model, identity, camera, and a pose per frame."),
        Port::one::<Metrics>("metrics", "track.*: landmark error, jitter and frames lost."),
        Port::one::<Labels>("labels", "track.head_model: the name of the head model that was fitted."),
    ];

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let clip = inputs.get::<Clip>("clip")?;
        let watch = &mut |p: Progress| context.progress(p.step, p.total, p.metric);
        let landmarks = match inputs.optional::<Observations>("landmarks")? {
            Some(landmarks) => landmarks,
            None => observe_clip(&clip, watch)?.into(),
        };
        let options = TrackOptions {
            focal_px: Some(self.focal * clip.width.max(clip.height) as f64),
            refine_focal: self.refine_focal,
            smoothness: self.smoothness,
            key_frames: self.key_frames,
            ..TrackOptions::default()
        };
        let track = track(&HeadModel::procedural(), &landmarks, &options, watch).map_err(with_remedy)?;
        let lost = track.frames.iter().filter(|frame| !frame.fitted).count();
        if lost > 0 {
            context.warn(&format!(
                "{lost} of {} frames show no face that could be fitted; their pose is interpolated",
                track.frames.len()
            ));
        }
        let metrics = Metrics::new()
            .with("track.landmark_rms_px", track.landmark_rms_px)
            .with("track.landmark_rms_percent_of_interocular", 100.0 * track.landmark_rms_px / track.interocular_px)
            .with("track.interocular_px", track.interocular_px)
            .with("track.landmark_rms_fraction", track.landmark_rms_px / track.interocular_px)
            .with("track.jitter_deg_rms", track.jitter_deg_rms())
            .with("track.frames_lost", lost as f64)
            .with("track.lost_frames", lost as f64);
        let labels = Labels::of("track.head_model", &track.head.name);
        Ok(Outputs::new().put("track", track).put("metrics", metrics).put("labels", labels))
    }
}

fn with_remedy(error: FaceError) -> NodeError {
    NodeError::from(error).remedy("look at frames.clip: one face, frontal and lit, in most frames; or choose another part with frames.start_seconds")
}
