//! PhaseModel: the fundamental of the modulation, a two-Gaussian waveform on a learned cardiac phase (paper, Methods).

use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_pulse::reference::weak_phase;
use heartian_pulse::{
    Parameterization, PhaseOptions, Prescription, Pulse, Reference, Scene, fit_phase, modulation_from_fundamental,
};
use heartian_signal::methods::PosWindow;
use heartian_signal::stats::mean;
use heartian_signal::trace::{Weighting, mean_rgb};
use heartian_space::{AlbedoOperator, Clip, Metrics, Modulation, Series, Skin};
use serde::{Deserialize, Serialize};

/// How long and from where the fit runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Preset {
    /// The paper's 60,000 iterations and decays.
    Paper,
    /// A twentieth of them, for a look.
    Fast,
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
    /// Fits cardiac phase and two-Gaussian waveform to a contact PPG, or to a prescribed heart rate, and scales it to the
    /// skin's albedo.
    pub struct PhaseModel {
        /// Heart rate to write instead of the clip's PPG.
        heart_rate_bpm: Option<f64> = None, unit("bpm"), range(20.0, 300.0);
        /// Heart-rate variability of a prescribed rate: standard deviation of the beat intervals.
        sdnn_ms: f64 = 0.0, unit("ms"), range(0.0, 300.0);
        /// Accumulated positive increments, or a free point on the circle per frame.
        parameterization: Parameterization = Parameterization::Cumulative, choices(&["Cumulative", "Direct"]);
        /// Peak-to-peak of the pulse, as a share of the skin's mean green albedo.
        amplitude: f64 = 0.025, range(0.0001, 0.5);
        /// Bound on the pulse in the picture, peak to peak.
        most_levels: f64 = 6.0, unit("8-bit levels"), range(0.01, 255.0);
        /// Weak phase prior from the recording's own pulse; dropped when that pulse does not keep step with the one written.
        weak_prior: WeakPrior = WeakPrior::Global, choices(&["Global", "Sliding", "Off"]);
        /// Length of the fit.
        preset: Preset = Preset::Paper, choices(&["Paper", "Fast"]);
    }
}
register!(PhaseModel);

impl Node for PhaseModel {
    const KIND: &'static str = "PhaseModel";
    const REVISION: u32 = 2;
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

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (clip, skin) = (inputs.get::<Clip>("clip")?, inputs.get::<Skin>("skin")?);
        let reference = self.reference(&clip, inputs.optional::<Series>("ppg")?.as_deref(), context)?;
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
        let metrics = Metrics::new()
            .with("phase.loss_rad2", report.phase_loss)
            .with("phase.pos_loss_rad2", report.pos_loss)
            .with("phase.waveform_pearson", report.fundamental_pearson)
            .with("phase.levels_8bit", report.levels)
            .with("phase.weak_prior_coherence", weak.as_ref().map_or(0.0, |weak| weak.coherence));
        Ok(Outputs::new()
            .put("modulation", modulation_from_fundamental(&pulse, &skin)?)
            .put("target", reference.series()?)
            .put("pulse", pulse)
            .put("metrics", metrics))
    }
}

impl PhaseModel {
    fn reference(&self, clip: &Clip, ppg: Option<&Series>, context: &Context) -> Result<Reference, NodeError> {
        let times = &clip.times_seconds;
        if let Some(heart_rate_bpm) = self.heart_rate_bpm {
            let sdnn_seconds = self.sdnn_ms / 1000.0;
            let seed = context.seed();
            let prescription = Prescription { heart_rate_bpm, sdnn_seconds, seed, ..Prescription::default() };
            return prescription.reference(times).map_err(|error| NodeError::from(error).parameter("heart_rate_bpm"));
        }
        let missing = || {
            NodeError::new("the recording came without a PPG, and no heart rate is prescribed")
                .remedy("give frames.ppg a CSV with the header `time_s,ppg`, or set phase.heart_rate_bpm")
                .parameter("heart_rate_bpm")
        };
        Ok(Reference::from_ppg(ppg.ok_or_else(missing)?, times)?)
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
        let Self { parameterization, amplitude, most_levels, .. } = *self;
        PhaseOptions { parameterization, amplitude, most_levels, ..base }
    }
}
