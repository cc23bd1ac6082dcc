//! Unsupervised rPPG: a pulse trace from a clip's mean RGB, by seven classical methods with rPPG-Toolbox's conventions.
//!
//! Input: one mean colour a frame, `[R, G, B]`, any positive unit (0–255 in the toolbox), at an even frame rate in hertz.
//! Output: a trace in arbitrary units, brightness-like in sign where the method defines a sign. Everything is f64; the
//! toolbox's float32 results differ by up to 1e-4 of a standard deviation (PBV: 0.3, its float32 solve is singular).

mod eigen;
mod ica;
mod linear;
mod windowed;

pub use ica::ica;
pub use linear::{lgi, omit, pbv};
pub use windowed::{PosWindow, chrom, pos, pos_filtered, pos_trace, pseudo_label};

use crate::detrend::Smoothness;
use crate::error::{Result, SignalError, check_finite, check_rate};

/// Smoothness of the detrending inside the toolbox's POS and ICA.
const TOOLBOX_SMOOTHNESS: Smoothness = Smoothness::Fixed(100.0);

/// One colour a frame.
pub type Rgb = [f64; 3];

/// A classical method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Method {
    /// Plane orthogonal to skin (Wang et al. 2017).
    Pos,
    /// Chrominance (de Haan & Jeanne 2013).
    Chrom,
    /// Independent components by JADE (Poh et al. 2011).
    Ica,
    /// The green channel (Verkruysse et al. 2008).
    Green,
    /// Local group invariance (Pilz et al. 2018).
    Lgi,
    /// Blood-volume-pulse signature (de Haan & van Leest 2014).
    Pbv,
    /// Orthogonal matrix image transformation (Álvarez Casado & Bordallo López 2023).
    Omit,
}

impl Method {
    /// All, in the toolbox's order.
    pub const ALL: [Self; 7] = [Self::Pos, Self::Chrom, Self::Ica, Self::Green, Self::Lgi, Self::Pbv, Self::Omit];

    /// The name in reports: `POS`, `CHROM`, …
    pub fn name(self) -> &'static str {
        match self {
            Self::Pos => "POS",
            Self::Chrom => "CHROM",
            Self::Ica => "ICA",
            Self::Green => "GREEN",
            Self::Lgi => "LGI",
            Self::Pbv => "PBV",
            Self::Omit => "OMIT",
        }
    }

    /// The method of that name, in any case.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.name().eq_ignore_ascii_case(name))
    }

    /// The method's trace exactly as the toolbox computes it. As many samples as frames, except CHROM, whose half-window
    /// hop drops a remainder.
    ///
    /// # Errors
    /// When a colour is not finite, the rate not positive, there are too few frames, a channel is black, or colours do
    /// not vary where the method must divide by their variation.
    pub fn trace(self, rgb: &[Rgb], rate_hertz: f64) -> Result<Vec<f64>> {
        self.trace_smoothed(rgb, rate_hertz, TOOLBOX_SMOOTHNESS)
    }

    /// The method's trace with another smoothness of the detrending inside POS and ICA; the others have none.
    ///
    /// # Errors
    /// As [`trace`](Self::trace).
    pub fn trace_smoothed(self, rgb: &[Rgb], rate_hertz: f64, smoothness: Smoothness) -> Result<Vec<f64>> {
        match self {
            Self::Pos => windowed::pos_smoothed(rgb, rate_hertz, smoothness),
            Self::Chrom => chrom(rgb, rate_hertz),
            Self::Ica => ica::ica_smoothed(rgb, rate_hertz, smoothness),
            Self::Green => green(rgb),
            Self::Lgi => lgi(rgb),
            Self::Pbv => pbv(rgb),
            Self::Omit => omit(rgb),
        }
    }
}

/// The mean green channel, nothing else.
///
/// # Errors
/// When there is no frame or a colour is not finite.
pub fn green(rgb: &[Rgb]) -> Result<Vec<f64>> {
    check_colors(rgb)?;
    Ok(rgb.iter().map(|color| color[1]).collect())
}

/// Refuses no frames and colours that are not finite.
fn check_colors(rgb: &[Rgb]) -> Result<()> {
    check_finite("the mean colours", rgb.as_flattened()).map_err(|error| match error {
        SignalError::NotFinite { what, index, value } => SignalError::NotFinite { what, index: index / 3, value },
        other => other,
    })
}

/// Refuses colours and a rate that cannot be used.
fn check_colors_at(rgb: &[Rgb], rate_hertz: f64) -> Result<()> {
    check_colors(rgb)?;
    check_rate(rate_hertz)
}

/// Mean colour of a window that starts at `frame`, refused where a channel is not positive: ratios are taken to it.
fn window_mean(window: &[Rgb], frame: usize) -> Result<Rgb> {
    let mut sum = [0.0; 3];
    for color in window {
        for channel in 0..3 {
            sum[channel] += color[channel];
        }
    }
    let mean = sum.map(|value| value / window.len() as f64);
    match mean.iter().position(|value| *value <= 0.0) {
        Some(channel) => {
            Err(SignalError::Dark { channel: ["red", "green", "blue"][channel], value: mean[channel], frame })
        }
        None => Ok(mean),
    }
}
