//! FrameLoader: the one door through which recordings enter a graph.

use std::path::{Path, PathBuf};

use heartian_capture::dataset::{self, Place};
use heartian_capture::ppg::{self, ClipPpg, cover_clip, read_ppg};
use heartian_capture::real::{RealOptions, load_real};
use heartian_capture::synthetic::{GroundTruth, Light, SkinTone, SyntheticOptions, generate, generate_with_pulse};
use heartian_capture::{CaptureError, CropMotion, MatteSource, matte_clip};
use heartian_face::Observations;
use heartian_face::models::iris_path;
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, ParamError, Port, SourceFile, params, register};
use heartian_space::{Clip, Progress, Series};

/// The source that needs no file.
const SYNTHETIC: &str = "synthetic";

params! {
    /// Reads a recording: a video, a folder of pictures, a recording of a data set, or the built-in synthetic one. Crops a square around the face,
    /// mattes head and neck, finds the landmarks, and puts the contact PPG on the clip's clock.
    pub struct FrameLoader {
        /// `synthetic`, a video file (.mp4, .avi; others through the ffmpeg program), a folder of PNG, JPEG, EXR or BMP
        /// frames, or a recording of UBFC-rPPG, PURE, MMPD, SCAMPS or iBVP as `heartian datasets ls` names it.
        source: String = SYNTHETIC.to_owned();
        /// Contact PPG as CSV with the header `time_s,ppg`, on the video's clock, at any sampling rate. Recordings of data
        /// sets bring their own. So does the synthetic one; given another, its person's blood follows it.
        ppg: Option<String> = None;
        /// How much of the recording is read.
        seconds: f64 = 20.0, unit("s"), range(0.5, 3600.0);
        /// Where in a file reading starts.
        start_seconds: f64 = 0.0, unit("s"), range(0.0, 86400.0);
        /// Side of the square clip.
        size: usize = 256, unit("px"), range(32.0, 2048.0);
        /// How the crop lies over a file's frames: fixed, or going with a person who moves across the picture. A crop that
        /// follows is like a camera that pans: poses and light are that camera's, and the frame's edge moves.
        crop: CropMotion = CropMotion::Fixed, choices(&["Fixed", "Following"]);
        /// Which face is followed where a recording shows several: 1 is the largest at its start, 2 the next.
        face: usize = 1, range(1.0, 16.0);
        /// Cut out head and neck; without, the whole crop counts.
        matte: bool = true;
        /// Instead of the person network: a folder of PNG masks of the square clip, one a frame in natural order, white on
        /// the person, black elsewhere.
        masks: Option<String> = None;
        /// Instead of the person network: the colour of a plain ground, as `#00b140`.
        key_color: Option<String> = None;
        /// How far from the ground's colour the person begins, as a share of that colour's saturation.
        key_tolerance: f64 = 0.25, range(0.01, 2.0);
        /// Frame rate of the synthetic recording, and of a folder of pictures without times.
        frames_per_second: f64 = 30.0, unit("Hz"), range(1.0, 240.0);
        /// Bring uneven or dropped frames of a file to this even rate, mixing neighbours by time; without, frames keep
        /// their true times. Holes of more than a quarter of a second stay holes.
        resample_hertz: Option<f64> = None, unit("Hz"), range(1.0, 240.0);
        /// Synthetic: which person, motion, heart and noise.
        seed: u64 = 1;
        /// Synthetic: mean heart rate.
        heart_rate_bpm: f64 = 72.0, unit("bpm"), range(30.0, 220.0);
        /// Synthetic: standard deviation of the beat intervals.
        hrv_ms: f64 = 35.0, unit("ms"), range(0.0, 150.0);
        /// Synthetic: relative change of green skin albedo from trough to peak of a beat.
        pulse_strength: f64 = 0.012, range(0.0, 0.2);
        /// Synthetic: how much the head moves and talks.
        motion: f64 = 1.0, range(0.0, 2.0);
        /// Synthetic: the light.
        light: Light = Light::Studio, choices(&["Studio", "Window", "Warm", "Cool", "Overcast"]);
        /// Synthetic: the skin tone.
        skin_tone: SkinTone = SkinTone::Light, choices(&["Light", "Medium", "Tan", "Brown", "Dark"]);
    }
}
register!(FrameLoader);

impl Node for FrameLoader {
    const KIND: &'static str = "FrameLoader";
    const REVISION: u32 = 7;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "Frames, matte and frame times, labelled `input`."),
        Port::one::<Observations>("landmarks", "Face landmarks seen in each frame."),
        Port::one::<Series>("ppg", "Contact PPG on the clip's clock, at its own rate.").optional(),
        Port::one::<Series>("ppg_at_frames", "The same at the clip's frame times.").optional(),
        Port::one::<GroundTruth>(
            "truth",
            "What a synthetic recording knows of itself; for judging, never for fitting.",
        )
        .optional(),
    ];

    fn sources(&self) -> Vec<SourceFile> {
        let remedy = "give a video file, a folder of pictures, a recording of a data set, or \"synthetic\"";
        let video = (self.source != SYNTHETIC).then(|| SourceFile::new("source", &self.source).remedy(remedy));
        // A data set may keep the pulse, and the frames' times, beside the video.
        let labels = self.place().map(|place| place.labels);
        let beside = labels.filter(|labels| labels.is_file() && !labels.starts_with(&self.source));
        let beside = beside.map(|labels| SourceFile::new("source", labels));
        let remedy = "give a CSV file with the header `time_s,ppg`";
        let ppg = self.ppg.as_ref().map(|path| SourceFile::new("ppg", path).remedy(remedy));
        let remedy = "give a folder of PNG masks, one a frame";
        let masks = self.masks.as_ref().map(|path| SourceFile::new("masks", path).remedy(remedy));
        // Which irises are seen hangs on whether their network is there.
        let irises = iris_path().filter(|_| self.source != SYNTHETIC).map(|path| SourceFile::new("source", path));
        video.into_iter().chain(beside).chain(ppg).chain(masks).chain(irises).collect()
    }

    fn leaves_empty(&self) -> Vec<&'static str> {
        let synthetic = self.source == SYNTHETIC;
        let with_labels = || self.place().is_some_and(|place| place.labels.is_file());
        let without_ppg = !synthetic && self.ppg.is_none() && !with_labels();
        let ppg = without_ppg.then_some(["ppg", "ppg_at_frames"]);
        ppg.into_iter().flatten().chain((!synthetic).then_some("truth")).collect()
    }

    fn validate(&self) -> Vec<ParamError> {
        let empty = self.source.is_empty();
        let message = "is empty; give a video file, a folder of pictures, a recording of a data set, or \"synthetic\"";
        let color = self.key_color.as_deref().is_some_and(|text| color(text).is_none());
        let colored =
            color.then(|| ParamError::new("key_color", "is no colour; write it as #rrggbb, for example #00b140"));
        empty.then(|| ParamError::new("source", message)).into_iter().chain(colored).collect()
    }

    fn run(&self, _: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        // The trace first: a mistake in it is found before minutes of video are read.
        let trace = match (&self.ppg, self.place()) {
            (Some(path), _) => Some(Trace::read(path)?),
            (None, Some(place)) if place.labels.is_file() => Some(Trace::of(&place)?),
            _ => None,
        };
        for note in trace.iter().flat_map(|trace| &trace.notes) {
            context.warn(note);
        }
        if self.source == SYNTHETIC { self.synthesise(trace, context) } else { self.read(trace, context) }
    }
}

impl FrameLoader {
    /// The data set's recording that `source` names.
    fn place(&self) -> Option<Place> {
        if self.source == SYNTHETIC { None } else { dataset::locate(Path::new(&self.source)) }
    }

    fn synthesise(&self, trace: Option<Trace>, context: &Context) -> Result<Outputs, NodeError> {
        let options = SyntheticOptions {
            seconds: self.seconds,
            size: self.size,
            frames_per_second: self.frames_per_second,
            seed: self.seed,
            heart_rate_bpm: self.heart_rate_bpm,
            hrv_ms: self.hrv_ms,
            light: self.light,
            skin_tone: self.skin_tone,
            pulse_strength: self.pulse_strength,
            motion: self.motion,
            ..SyntheticOptions::default()
        };
        let watch = &mut |p: Progress| context.progress(p.step, p.total, p.metric);
        let recording = match &trace {
            Some(trace) => generate_with_pulse(&options, &trace.whole, watch),
            None => generate(&options, watch),
        }
        .map_err(named)?;
        let ppg = match trace {
            Some(trace) => trace.over(&recording.clip)?,
            None => {
                let at_frames = recording.ppg.resampled(&recording.clip.times_seconds, 1.0)?;
                ClipPpg { contact: recording.ppg, at_frames }
            }
        };
        Ok(Outputs::new()
            .put("clip", recording.clip)
            .put("landmarks", recording.observations)
            .put("ppg", ppg.contact)
            .put("ppg_at_frames", ppg.at_frames)
            .put("truth", recording.truth))
    }

    /// What tells person from ground when the network does not.
    fn own_matte(&self) -> Option<MatteSource> {
        let key = self.key_color.as_deref().and_then(color);
        let key = key.map(|color| MatteSource::Key { color, tolerance: self.key_tolerance as f32 });
        self.masks.as_ref().map(|folder| MatteSource::Masks(folder.into())).or(key)
    }

    fn read(&self, trace: Option<Trace>, context: &Context) -> Result<Outputs, NodeError> {
        let options = RealOptions {
            start_seconds: self.start_seconds,
            seconds: self.seconds,
            size: self.size,
            crop: self.crop,
            matte: self.matte && self.own_matte().is_none(),
            folder_hertz: self.frames_per_second,
            resample_hertz: self.resample_hertz,
            face: self.face.saturating_sub(1),
        };
        let watch = &mut |p: Progress| context.progress(p.step, p.total, p.metric);
        let mut recording = load_real(Path::new(&self.source), &options, watch).map_err(named)?;
        if let Some(source) = self.own_matte().filter(|_| self.matte) {
            recording.clip = matte_clip(recording.clip, &recording.observations, &source, watch).map_err(named)?;
        }
        recording.warnings.iter().for_each(|warning| context.warn(warning));
        let ppg = trace.map(|trace| trace.over(&recording.clip)).transpose()?;
        let (contact, at_frames) = ppg.map(|ppg| (ppg.contact, ppg.at_frames)).unzip();
        Ok(Outputs::new()
            .put("clip", recording.clip)
            .put("landmarks", recording.observations)
            .put_some("ppg", contact)
            .put_some("ppg_at_frames", at_frames))
    }
}

/// `#rrggbb`.
fn color(text: &str) -> Option<[u8; 3]> {
    let digits = text.strip_prefix('#').filter(|digits| digits.len() == 6 && digits.is_ascii())?;
    let channel = |k: usize| u8::from_str_radix(&digits[2 * k..2 * k + 2], 16).ok();
    Some([channel(0)?, channel(1)?, channel(2)?])
}

/// A contact PPG and the file it came from.
struct Trace {
    path: PathBuf,
    whole: Series,
    /// The parameter that named it.
    parameter: &'static str,
    /// What is doubtful about it, a line each.
    notes: Vec<String>,
}

impl Trace {
    fn read(path: &str) -> Result<Self, NodeError> {
        let path = PathBuf::from(path);
        let whole = read_ppg(&path).map_err(|error| NodeError::from(error).parameter("ppg"))?;
        Ok(Self::new(path, ppg::Trace::of(whole), "ppg"))
    }

    /// A data set's own.
    fn of(place: &Place) -> Result<Self, NodeError> {
        let trace = dataset::trace(place).map_err(|error| NodeError::from(error).parameter("source"))?;
        Ok(Self::new(place.labels.clone(), trace, "source"))
    }

    fn new(path: PathBuf, trace: ppg::Trace, parameter: &'static str) -> Self {
        let notes = trace.notes.iter().map(|note| format!("{}: {note}", path.display())).collect();
        Self { path, whole: trace.series, parameter, notes }
    }

    fn over(&self, clip: &Clip) -> Result<ClipPpg, NodeError> {
        cover_clip(&self.path, &self.whole, clip).map_err(|error| NodeError::from(error).parameter(self.parameter))
    }
}

/// The error with the parameter it is about.
fn named(error: CaptureError) -> NodeError {
    let parameter = match &error {
        CaptureError::Option { name, .. } => Some(*name),
        CaptureError::Video(_) | CaptureError::DataSet(_) | CaptureError::NoFace { .. } => Some("source"),
        CaptureError::TooLarge { .. } => Some("seconds"),
        CaptureError::Masks { .. } => Some("masks"),
        _ => None,
    };
    let node_error = NodeError::from(error);
    match parameter {
        Some(parameter) => node_error.parameter(parameter),
        None => node_error,
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// A PPG file of that rate and length, 78 bpm.
    fn file(rate_hertz: f64, seconds: f64) -> std::path::PathBuf {
        let name = format!("heartian-loader-{}-{rate_hertz}-{seconds}.csv", std::process::id());
        let path = std::env::temp_dir().join(name);
        let line = |k: usize| {
            let time = k as f64 / rate_hertz;
            format!("{time},{}\n", 500.0 + 40.0 * (std::f64::consts::TAU * 1.3 * time).sin())
        };
        let lines: String = (0..=(seconds * rate_hertz) as usize).map(line).collect();
        std::fs::write(&path, format!("time_s,ppg\n{lines}")).unwrap();
        path
    }

    #[test]
    fn colours_are_read_and_rubbish_is_refused() {
        assert_eq!(color("#00b140"), Some([0, 177, 64]));
        for text in ["", "#", "00b140", "#00b14", "#00b1400", "#zzzzzz", "#ééé"] {
            assert_eq!(color(text), None, "{text}");
        }
        let loader = FrameLoader { key_color: Some("green".to_owned()), ..Default::default() };
        assert_eq!(loader.validate().len(), 1);
    }

    #[test]
    fn a_data_set_brings_its_own_pulse() {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("vid.avi");
        std::fs::write(&video, "a video").unwrap();
        let loader = |source: &Path| FrameLoader { source: source.display().to_string(), ..Default::default() };
        assert_eq!(loader(&video).leaves_empty(), ["ppg", "ppg_at_frames", "truth"]);
        let labels = folder.path().join("ground_truth.txt");
        std::fs::write(&labels, "1 2\n60 60\n0 0.1\n").unwrap();
        // Given as a folder, the folder's digest holds the labels; given as a file, they are a source of their own.
        for (source, count) in [(folder.path(), 1), (&video, 2)] {
            assert_eq!(loader(source).leaves_empty(), ["truth"]);
            let sources = loader(source).sources();
            assert_eq!((sources.len(), &*sources[0].path), (count, source));
        }
        assert_eq!(loader(&video).sources()[1].path, labels);
    }

    #[test]
    fn a_ppg_file_of_any_rate_that_reaches_over_the_clip_is_laid_on_its_clock() {
        for (rate, seconds) in [(20.0, 3.0), (117.3, 2.0), (1000.0, 2.0), (25.0, 300.0)] {
            let path = file(rate, seconds);
            let ppg = Some(path.display().to_string());
            let loader = FrameLoader { seconds: 2.0, size: 32, ppg, ..FrameLoader::default() };
            let outputs = loader.run(&Inputs::new(), &Context::silent()).unwrap();
            let series = |port: &str| outputs.get(port).unwrap().downcast::<Series>().unwrap();
            assert_eq!(series("ppg_at_frames").len(), 60);
            assert!((series("ppg").rate_hertz() / rate - 1.0).abs() < 0.01 && series("ppg").len() < 4 * rate as usize);
            std::fs::remove_file(path).unwrap();
        }
        let path = file(100.0, 1.0);
        let short = FrameLoader { seconds: 2.0, size: 32, ppg: Some(path.display().to_string()), ..Default::default() };
        let error = short.run(&Inputs::new(), &Context::silent()).err().unwrap();
        std::fs::remove_file(path).unwrap();
        assert!(error.message.contains("seconds"), "{error:?}");
    }
}
