//! FlameTracker: a head model with FLAME's interface fitted to the landmarks of a clip.

use heartian_capture::observe_clip;
use heartian_face::models::{head_path, iris_path};
use heartian_face::{FaceError, HeadModel, HeadSource, Observations, Track, TrackOptions, track};
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, SourceFile, params, register};
use heartian_space::{Clip, Labels, Metrics, Progress};

/// The head model that needs no file.
const PROCEDURAL: &str = "procedural";
/// The one that was installed.
const INSTALLED: &str = "installed";

params! {
    /// Fits one head and camera, and a pose, jaw, expression, eyelids and, where irises were seen, gaze per frame, by damped
    /// Gauss–Newton. It sees landmarks and nothing else, so the neck stays at rest: those wired in, or those it finds in the clip itself with the installed face models.
    pub struct FlameTracker {
        /// Focal length; a face crop of a webcam has about 2.
        focal: f64 = 2.2, unit("picture widths"), range(0.3, 50.0);
        /// Refine the focal length where the recording determines it, as when the head turns or comes nearer a good deal;
        /// otherwise the given one stays. `track.focal_sigma_percent` says how well it is known.
        refine_focal: bool = true;
        /// Strength of the temporal terms; 0 leaves frames independent.
        smoothness: f64 = 1.0, range(0.0, 1000.0);
        /// `procedural` (built in), `installed` (the head of `heartian models install head`), or your FLAME 2020 or 2023 as
        /// a .pkl or .npz file.
        head_model: String = PROCEDURAL.to_owned();
        /// For a FLAME file: where the face mesh's landmarks sit on it (.npz or .npy with `lmk_face_idx`, `lmk_b_coords`,
        /// `landmark_indices`); without, they are found by aligning the built-in head.
        head_landmarks: Option<String> = None;
        /// Key frames that decide the identity.
        key_frames: usize = 24, range(1.0, 1000.0);
    }
}
register!(FlameTracker);

impl Node for FlameTracker {
    const KIND: &'static str = "FlameTracker";
    const REVISION: u32 = 3;
    const INPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The clip to track."),
        Port::one::<Observations>("landmarks", "Landmarks seen in it; without, the face models look for them.")
            .optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Track>(
            "track",
            "Head model, identity, camera, and per frame a pose and how sure it is (sigma.*: standard deviations).",
        ),
        Port::one::<Metrics>("metrics", "track.*: landmark error, jitter, how sure it is, and frames lost."),
        Port::one::<Labels>(
            "labels",
            "track.head_model: the name of the head model that was fitted; track.gaze_from: what the eyes follow.",
        ),
    ];

    fn sources(&self) -> Vec<SourceFile> {
        let remedy = "run `heartian models install head`, or give \"procedural\" or your FLAME file (.pkl, .npz)";
        let model = match self.head_model.as_str() {
            PROCEDURAL => None,
            INSTALLED => head_path().ok().map(|path| SourceFile::new("head_model", path)),
            path => Some(SourceFile::new("head_model", path)),
        };
        let landmarks = self.head_landmarks.as_ref().map(|path| SourceFile::new("head_landmarks", path));
        // Which irises are seen hangs on whether their network is there.
        let irises = iris_path().map(|path| SourceFile::new("head_model", path));
        model.into_iter().chain(landmarks).map(|source| source.remedy(remedy)).chain(irises).collect()
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let head = HeadModel::load(&self.head()).map_err(|error| NodeError::from(error).parameter("head_model"))?;
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
        let track = track(&head, &landmarks, &options, watch).map_err(with_remedy)?;
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
            .with("track.rotation_sigma_deg", track.sigma.median_turn_deg())
            .with("track.focal_widths", f64::from(track.camera.focal_px[0]) / clip.width.max(clip.height) as f64)
            .with("track.focal_sigma_percent", track.sigma.focal_percent.map_or(f64::NAN, f64::from))
            .with("track.frames_lost", lost as f64)
            .with("track.lost_frames", lost as f64);
        let gaze = if landmarks.shows_irises() { "irises" } else { "straight ahead" };
        let mut labels = Labels::of("track.head_model", &track.head.name);
        labels.0.insert("track.gaze_from".to_owned(), gaze.to_owned());
        Ok(Outputs::new().put("track", track).put("metrics", metrics).put("labels", labels))
    }
}

impl FlameTracker {
    fn head(&self) -> HeadSource {
        match self.head_model.as_str() {
            PROCEDURAL => HeadSource::Procedural,
            INSTALLED => HeadSource::Installed,
            path => HeadSource::File { model: path.into(), landmarks: self.head_landmarks.as_ref().map(Into::into) },
        }
    }
}

fn with_remedy(error: FaceError) -> NodeError {
    NodeError::from(error).remedy("look at frames.clip: one face, frontal and lit, in most frames; or choose another part with frames.start_seconds")
}
