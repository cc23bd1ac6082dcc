//! PhaseModel: the fundamental of the modulation, a two-Gaussian waveform on a learned cardiac phase (paper, Methods).

use std::path::Path;

use heartian_graph::{Context, Inputs, Need, Node, NodeError, Outputs, ParamError, Port, SourceFile, params, register};
use heartian_pulse::losses::LossWeights;
use heartian_pulse::reference::weak_phase;
use heartian_pulse::{
    Parameterization, PhaseOptions, Prescription, Pulse, PulseError, PulseFile, Reference, Rhythm, Scene, fit_phase,
    modulation_from_fundamental,
};
use heartian_signal::methods::PosWindow;
use heartian_signal::stats::mean;
use heartian_signal::trace::{Weighting, mean_rgb};
use heartian_space::{AlbedoOperator, Clip, Metrics, Modulation, Series, Skin};
use serde::{Deserialize, Serialize};

use crate::bound::bound_message;

/// How long and from where the fit runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Preset {
    /// The paper's 60,000 iterations and decays.
    Paper,
    /// A twentieth of them, for a look.
    Fast,
}

/// Which losses the fundamental is fitted to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LossesUsed {
    /// Phase, weak phase, waveform and photometric.
    All,
    /// Mean squared error and Pearson correlation of the waveform.
    Waveform,
}

/// Where the weak phase prior comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum WeakPrior {
    /// POS over the whole clip at once (clean footage).
    Global,
    /// POS over sliding windows of 1.6 s (compressed footage).
    Sliding,
    /// None.
    Off,
}

params! {
    /// Fits cardiac phase and two-Gaussian waveform to a contact PPG, to another recording, or to a prescribed heartbeat,
    /// and scales it to the skin's albedo.
    pub struct PhaseModel {
        /// Heart rate to write instead of the clip's PPG.
        heart_rate_bpm: Option<f64> = None, unit("bpm"), range(20.0, 300.0);
        /// A pulse to write instead of the clip's PPG, as CSV on its own clock (its start falls on the clip's first frame):
        /// `time_s,ppg` another person's recording or any waveform, `beat_s` times of beats, `rr_ms` their intervals.
        pulse_file: Option<String> = None;
        /// Of a prescribed rate: standard deviation of the beat intervals (SDNN).
        sdnn_ms: f64 = 0.0, unit("ms"), range(0.0, 300.0);
        /// Of a prescribed rate: power of the slow variation of intervals (0.04–0.15 Hz) over the respiratory one.
        lf_hf: f64 = 1.0, range(0.05, 20.0);
        /// Of a prescribed rate: intervals that vary slowly and with the breath, or freely as in atrial fibrillation.
        rhythm: Rhythm = Rhythm::Sinus, choices(&["Sinus", "Irregular"]);
        /// Of a prescribed rate: breaths a minute.
        breaths_per_minute: f64 = 15.0, unit("1/min"), range(9.0, 24.0);
        /// Of a prescribed rate: swing of the baseline with the breath, as a share of a beat's height.
        breath_baseline: f64 = 0.0, range(0.0, 1.0);
        /// Of a prescribed rate: swing of the beats' height with the breath, as a share of it.
        breath_amplitude: f64 = 0.0, range(0.0, 0.9);
        /// Of a prescribed rate: ectopic beats, early and weak, with the pause after them.
        ectopic_per_minute: f64 = 0.0, unit("1/min"), range(0.0, 30.0);
        /// Accumulated positive increments (the paper), a free point on the circle per frame, or anchors at the beats,
        /// which do not drift.
        parameterization: Parameterization = Parameterization::Cumulative,
            choices(&["Cumulative", "Direct", "Anchored"]);
        /// Peak-to-peak of the pulse, as a share of the skin's mean green albedo.
        amplitude: f64 = 0.025, range(0.0001, 0.5);
        /// Bound on the pulse in the picture, peak to peak, at the pixel and in the frame that answer most: spikes are folded
        /// in smoothly below it.
        most_levels: f64 = 6.0, unit("8-bit levels"), range(0.01, 255.0);
        /// Weak phase prior from the recording's own pulse; dropped when that pulse does not keep step with the one written.
        weak_prior: WeakPrior = WeakPrior::Global, choices(&["Global", "Sliding", "Off"]);
        /// Whether the pulse swings about the skin's colour; without, it only adds light, as in the paper, and the mean
        /// colour shifts.
        centred: bool = true;
        /// All losses of the paper, or the waveform's alone.
        losses: LossesUsed = LossesUsed::All, choices(&["All", "Waveform"]);
        /// Length of the fit.
        preset: Preset = Preset::Paper, choices(&["Paper", "Fast"]);
    }
}
register!(PhaseModel);

const NO_PULSE: &str = "the recording came without a PPG, and no heartbeat is prescribed";
const PULSE_REMEDY: &str = "give frames.ppg a CSV with the header `time_s,ppg`, or set phase.heart_rate_bpm, or \
                            phase.pulse_file to another recording";

impl Node for PhaseModel {
    const KIND: &'static str = "PhaseModel";
    const REVISION: u32 = 5;
    const INPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The recording: its frame times, and its own pulse for the weak prior."),
        Port::one::<Series>("ppg", "Contact PPG on the clip's clock, at any rate.").optional(),
        Port::one::<Skin>("skin", "The Gaussians to modulate."),
        Port::one::<AlbedoOperator>("operator", "The frozen renderer; without it the photometric loss is left out.")
            .optional(),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Pulse>("pulse", "Phase, waveform and strength."),
        Port::one::<Modulation>("modulation", "The fundamental alone, the same for every skin Gaussian."),
        Port::one::<Series>("target", "The waveform that was to be written, at the clip's frame times."),
        Port::one::<Metrics>("metrics", "phase.*: losses and strength."),
    ];

    fn sources(&self) -> Vec<SourceFile> {
        let remedy = "give a CSV file with the header `time_s,ppg`, `beat_s` or `rr_ms`";
        self.pulse_file.iter().map(|path| SourceFile::new("pulse_file", path).remedy(remedy)).collect()
    }

    fn needs(&self) -> Vec<Need> {
        let own = self.heart_rate_bpm.is_some() || self.pulse_file.is_some();
        let need = Need { input: "ppg", message: NO_PULSE.to_owned(), remedy: PULSE_REMEDY.to_owned() };
        (!own).then_some(need).into_iter().collect()
    }

    fn validate(&self) -> Vec<ParamError> {
        let plain = Self::default();
        let varied = [
            ("sdnn_ms", self.sdnn_ms != plain.sdnn_ms),
            ("lf_hf", self.lf_hf != plain.lf_hf),
            ("rhythm", self.rhythm != plain.rhythm),
            ("breaths_per_minute", self.breaths_per_minute != plain.breaths_per_minute),
            ("breath_baseline", self.breath_baseline != plain.breath_baseline),
            ("breath_amplitude", self.breath_amplitude != plain.breath_amplitude),
            ("ectopic_per_minute", self.ectopic_per_minute != plain.ectopic_per_minute),
        ];
        let orphan = varied.into_iter().filter(|(_, set)| *set && self.heart_rate_bpm.is_none());
        let message = "acts on a prescribed heart rate only; set heart_rate_bpm as well";
        let mut wrong: Vec<ParamError> = orphan.map(|(name, _)| ParamError::new(name, message)).collect();
        if self.heart_rate_bpm.is_some() && self.pulse_file.is_some() {
            wrong.push(ParamError::new("pulse_file", "contradicts heart_rate_bpm; give one of the two"));
        }
        wrong
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (clip, skin) = (inputs.get::<Clip>("clip")?, inputs.get::<Skin>("skin")?);
        let reference = self.reference(&clip, inputs.optional::<Series>("ppg")?.as_deref(), context)?;
        if let Some(message) = unshown_message(&reference) {
            context.warn(&message);
        }
        let weak = match self.window() {
            Some(window) => weak_phase(&mean_rgb(&clip, Weighting::Alpha)?, &reference, window)?,
            None => None,
        };
        let operator = inputs.optional::<AlbedoOperator>("operator")?;
        let albedo: Vec<f64> = skin.green_albedo.iter().copied().map(f64::from).collect();
        let scene = Scene {
            weak_phase: weak.as_ref(),
            renderer: operator.as_deref().map(|o| o as _),
            mean_green_albedo: mean(&albedo),
        };
        let watch = &mut |p: heartian_space::Progress| context.progress(p.step, p.total, p.metric);
        let (pulse, report) = fit_phase(&reference, &scene, &self.options(), watch)?;
        let (modulation, limited) = modulation_from_fundamental(&pulse, &skin)?;
        if let Some(message) = bound_message(&limited, &pulse) {
            context.warn(&message);
        }
        let metrics = Metrics::new()
            .with("phase.loss_rad2", report.phase_loss)
            .with("phase.pos_loss_rad2", report.pos_loss)
            .with("phase.shown_share", reference.shown_share())
            .with("phase.waveform_pearson", report.fundamental_pearson)
            .with("phase.levels_8bit", report.levels)
            .with("phase.most_levels_8bit", report.most_levels)
            .with("phase.bound_levels", pulse.strength.most_levels)
            .with("phase.limited_frames", limited.frames as f64)
            .with("phase.weak_prior_coherence", weak.as_ref().map_or(0.0, |weak| weak.coherence));
        Ok(Outputs::new()
            .put("modulation", modulation)
            .put("target", reference.series()?)
            .put("pulse", pulse)
            .put("metrics", metrics))
    }
}

/// Below this share of plainly shown beats the pulse that is written is largely a guess.
const PLAINLY_SHOWN: f64 = 0.7;

/// What to say of a PPG that does not show its beats.
fn unshown_message(reference: &Reference) -> Option<String> {
    let (share, [from, to]) = (reference.shown_share(), reference.longest_guess()?);
    (share < PLAINLY_SHOWN).then(|| {
        format!(
            "the PPG plainly shows its beats in {:.0} % of the clip, and least from {from:.1} s to {to:.1} s; what is \
             written there is a guess. Take another stretch with frames.start_seconds, or prescribe phase.heart_rate_bpm",
            100.0 * share
        )
    })
}

/// The error with the parameter of the prescription it is about.
fn at_fault(error: PulseError) -> NodeError {
    let parameter = match &error {
        PulseError::Parameter { name: "sdnn_seconds", .. } => "sdnn_ms",
        PulseError::Parameter { name, .. } => name,
        _ => "heart_rate_bpm",
    };
    NodeError::from(error).parameter(parameter)
}

impl PhaseModel {
    fn reference(&self, clip: &Clip, ppg: Option<&Series>, context: &Context) -> Result<Reference, NodeError> {
        let times = &clip.times_seconds;
        if let Some(heart_rate_bpm) = self.heart_rate_bpm {
            return self.prescription(heart_rate_bpm, context.seed()).reference(times).map_err(at_fault);
        }
        if let Some(path) = &self.pulse_file {
            let remedy = "give a file at least as long as the clip, or a shorter part of the clip by frames.seconds";
            let reference = PulseFile::read(Path::new(path)).and_then(|file| file.reference(times));
            return reference.map_err(|error| NodeError::from(error).parameter("pulse_file").remedy(remedy));
        }
        let missing = || NodeError::new(NO_PULSE).remedy(PULSE_REMEDY).parameter("heart_rate_bpm");
        Ok(Reference::from_ppg(ppg.ok_or_else(missing)?, times)?)
    }

    fn prescription(&self, heart_rate_bpm: f64, seed: u64) -> Prescription {
        let Self { lf_hf, rhythm, breaths_per_minute, breath_baseline, breath_amplitude, ectopic_per_minute, .. } =
            *self;
        Prescription {
            heart_rate_bpm,
            sdnn_seconds: self.sdnn_ms / 1000.0,
            lf_hf,
            rhythm,
            breaths_per_minute,
            breath_baseline,
            breath_amplitude,
            ectopic_per_minute,
            seed,
            ..Prescription::default()
        }
    }

    fn window(&self) -> Option<PosWindow> {
        match self.weak_prior {
            WeakPrior::Global => Some(PosWindow::Global),
            WeakPrior::Sliding => Some(PosWindow::SLIDING),
            WeakPrior::Off => None,
        }
    }

    fn options(&self) -> PhaseOptions {
        let base = match self.preset {
            Preset::Fast => PhaseOptions::default(),
            Preset::Paper => PhaseOptions::paper(),
        };
        let Self { parameterization, amplitude, most_levels, centred, .. } = *self;
        let weights = match self.losses {
            LossesUsed::All => base.weights,
            LossesUsed::Waveform => LossWeights { phase: 0.0, pos: 0.0, base: 0.0, ..base.weights },
        };
        PhaseOptions { parameterization, amplitude, most_levels, centred, weights, ..base }
    }
}
