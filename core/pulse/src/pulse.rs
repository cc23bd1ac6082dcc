//! The `pulse` artifact: everything that was learnt about the heartbeat, and the values it takes at each frame.
//!
//! Offsets are in linear green albedo. Arrays `times_seconds`, `theta`, `beat`, `fundamental`, `reference`, `most_levels_per_albedo` have one entry
//! a frame, T ≥ 1.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};
use heartian_space::{Modulation, Skin};

use crate::arrival::Arrival;
use crate::error::{PulseError, check_length};
use crate::fit::FitReport;
use crate::limit::{Limit, Limited};
use crate::phase::{Anchors, Parameterization, Phase};
use crate::residual::{Residual, Shape};
use crate::waveform::Waveform;

/// How strongly the skin pulses.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Strength {
    /// A of equation 1, linear albedo.
    pub scale: f64,
    /// What is subtracted from the waveform before scaling (its mean when centred, 0 in the paper).
    pub level: f64,
    /// B of equation 2; 0 without residual.
    pub residual_weight: f64,
    /// 8-bit levels on the picture for one unit of albedo.
    pub levels_per_albedo: f64,
    /// Bound on the peak-to-peak of the pixel that answers most, 8-bit levels.
    pub most_levels: f64,
}

/// A fitted heartbeat.
#[derive(Clone, Debug, PartialEq)]
pub struct Pulse {
    /// Frame times, seconds.
    pub times_seconds: Vec<f64>,
    /// θ(t), radians in [−π, π].
    pub theta: Vec<f64>,
    /// b(t), from 0.
    pub beat: Vec<u32>,
    /// A·(fundamental − level), linear green albedo.
    pub fundamental: Vec<f64>,
    /// The pulse that was aimed at, arbitrary unit.
    pub reference: Vec<f64>,
    /// Learnt phase parameters.
    pub phase: Phase,
    /// Learnt waveform parameters.
    pub waveform: Waveform,
    /// 8-bit levels for one unit of albedo at the pixel that answers most, above 0: light and pose change it.
    pub most_levels_per_albedo: Vec<f64>,
    /// Scales and bounds.
    pub strength: Strength,
    /// The residual network, once fitted.
    pub residual: Option<Residual>,
    /// Mean beat rate of the reference over the clip, bpm.
    pub reference_bpm: f64,
    /// How the fit went.
    pub report: FitReport,
}

impl Pulse {
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.times_seconds.len()
    }

    /// Never true of a fitted pulse.
    pub fn is_empty(&self) -> bool {
        self.times_seconds.is_empty()
    }

    /// Mean frame rate, hertz; 0 for a single frame.
    pub fn rate_hertz(&self) -> f64 {
        match self.times_seconds[..] {
            [first, .., last] if last > first => (self.len() - 1) as f64 / (last - first),
            _ => 0.0,
        }
    }

    /// The fundamental before scaling and centring: u(θ) with the prescription's envelope, one value a frame.
    pub fn shape(&self) -> Vec<f64> {
        let scale = self.strength.scale.max(1e-300);
        self.fundamental.iter().map(|value| value / scale + self.strength.level).collect()
    }

    /// Half of the bound on 8-bit levels at a frame, as linear albedo: no offset is larger in magnitude there, so that no
    /// pixel moves by more.
    pub fn most_offset(&self, frame: usize) -> f64 {
        0.5 * self.strength.most_levels / self.most_levels_per_albedo[frame].max(1e-9)
    }

    /// The bound frame by frame.
    pub(crate) fn limits(&self) -> Vec<Limit> {
        (0..self.len()).map(|frame| Limit::new(self.most_offset(frame))).collect()
    }

    fn checked(self) -> Result<Self, PulseError> {
        let count = self.times_seconds.len();
        for (what, found) in [
            ("theta", self.theta.len()),
            ("beat", self.beat.len()),
            ("fundamental", self.fundamental.len()),
            ("reference", self.reference.len()),
            ("most_levels_per_albedo", self.most_levels_per_albedo.len()),
            ("phase", self.phase.len()),
        ] {
            check_length(what, count, found)?;
        }
        let anchors = &self.phase.anchors;
        if self.phase.parameterization == Parameterization::Anchored {
            check_length("the phase's corrections", anchors.seconds.len(), self.phase.raw.len())?;
            check_length("the phase's anchors", anchors.seconds.len(), anchors.phase.len())?;
            if !anchors.seconds.is_sorted_by(|a, b| a < b) {
                return Err(heartian_space::SpaceError::Order("the phase's anchors").into());
            }
        }
        if let Some(residual) = &self.residual {
            let expected = residual.shape.checked()?.layout().len;
            check_length("the residual's weights", expected, residual.weights.len())?;
        }
        Ok(self)
    }
}

/// The modulation of the fundamental alone (graphs without residual): the same at every skin Gaussian, unless the skin has
/// a perfusion map. Also says where the bound on 8-bit levels acted.
///
/// # Errors
/// When there is no skin, or the pulse has no frame.
pub fn modulation_from_fundamental(pulse: &Pulse, skin: &Skin) -> Result<(Modulation, Limited), PulseError> {
    let count = skin.gaussians.len();
    if count == 0 {
        return Err(PulseError::NoSkin);
    }
    let (arrival, limits) = (Arrival::new(pulse, skin), pulse.limits());
    let mut counts = vec![0; pulse.len()];
    let mut offsets = Vec::with_capacity(count * pulse.len());
    for (frame, changed) in counts.iter_mut().enumerate() {
        for gaussian in 0..count {
            let (offset, limited) = limits[frame].apply(arrival.at(frame, gaussian));
            offsets.push(offset);
            *changed += u64::from(limited);
        }
    }
    let modulation = Modulation {
        gaussians: skin.gaussians.clone(),
        times_seconds: pulse.times_seconds.clone(),
        offsets,
        red_blue: skin.red_blue.clone(),
    };
    Ok((modulation.checked()?, Limited::from_counts(&counts)))
}

impl Artifact for Pulse {
    const TYPE: ArtifactType = ArtifactType { name: "pulse", version: 3 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let count = self.len();
        let mut bundle = Bundle::new()
            .tensor("times_seconds", &[count], &self.times_seconds)?
            .tensor("theta", &[count], &self.theta)?
            .tensor("beat", &[count], &self.beat)?
            .tensor("fundamental", &[count], &self.fundamental)?
            .tensor("reference", &[count], &self.reference)?
            .tensor("most_levels_per_albedo", &[count], &self.most_levels_per_albedo)?
            .tensor("phase", &[self.phase.raw.len()], &self.phase.raw)?
            .tensor("anchor_seconds", &[self.phase.anchors.seconds.len()], &self.phase.anchors.seconds)?
            .tensor("anchor_phase", &[self.phase.anchors.phase.len()], &self.phase.anchors.phase)?
            .meta("phase", &(self.phase.parameterization, self.phase.initial))?
            .meta("waveform", &self.waveform)?
            .meta("strength", &self.strength)?
            .meta("reference_bpm", &self.reference_bpm)?
            .meta("report", &self.report)?
            .meta("residual", &self.residual.as_ref().map(|residual| residual.shape))?;
        if let Some(residual) = &self.residual {
            bundle = bundle.tensor("residual", &[residual.weights.len()], &residual.weights)?;
        }
        Ok(bundle)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let (parameterization, initial) = reader.meta("phase")?;
        let times_seconds: Vec<f64> = reader.tensor("times_seconds")?.1;
        let anchors = Anchors {
            seconds: reader.tensor("anchor_seconds")?.1,
            phase: reader.tensor("anchor_phase")?.1,
            frame_seconds: if parameterization == Parameterization::Anchored { times_seconds.clone() } else { vec![] },
        };
        let residual = match reader.meta::<Option<Shape>>("residual")? {
            Some(shape) => Some(Residual { shape, weights: reader.tensor("residual")?.1 }),
            None => None,
        };
        Self {
            times_seconds,
            theta: reader.tensor("theta")?.1,
            beat: reader.tensor("beat")?.1,
            fundamental: reader.tensor("fundamental")?.1,
            reference: reader.tensor("reference")?.1,
            most_levels_per_albedo: reader.tensor("most_levels_per_albedo")?.1,
            phase: Phase { parameterization, initial, raw: reader.tensor("phase")?.1, anchors },
            waveform: reader.meta("waveform")?,
            strength: reader.meta("strength")?,
            residual,
            reference_bpm: reader.meta("reference_bpm")?,
            report: reader.meta("report")?,
        }
        .checked()
        .map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}
