//! Which Gaussians are facial skin, and what is added to their albedo: the two tables that pass between the avatar, the
//! pulse and the readers. Plain data, so that writer and reader of the heartbeat need not know each other.
//!
//! Green alone is modulated in the paper. Blood colours all three channels, and along one line: `red_blue` holds, per
//! Gaussian, how much red and blue go with a unit of green, so three channels cost two numbers a Gaussian and none a frame.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::SpaceError;

/// How strongly and when blood reaches each place of the skin. Both lists have one entry a Gaussian, or none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Perfusion {
    /// Strength of the pulse relative to the mean over the skin, ≥ 0.
    pub strength: Vec<f32>,
    /// Arrival after the mean over the skin, seconds; negative is earlier.
    pub delay_seconds: Vec<f32>,
}

/// The skin Gaussians 𝒢ˢ of an avatar (paper, Methods). All arrays have length `n ≥ 1`, the last two may be empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skin {
    /// Indices into the avatar's Gaussians, increasing.
    pub gaussians: Vec<u32>,
    /// Canonical positions scaled into [−1, 1]³ over the selection.
    pub positions: Vec<[f32; 3]>,
    /// Unmodulated linear green albedo, in [0, 1].
    pub green_albedo: Vec<f32>,
    /// Distance to the head mesh in canonical space, metres.
    pub distances_metres: Vec<f32>,
    /// What red and blue albedo change by when green changes by one; empty: green alone pulses.
    pub red_blue: Vec<[f32; 2]>,
    /// Where and when blood arrives; empty: everywhere alike.
    pub perfusion: Perfusion,
}

/// Offsets added to the linear green albedo of some Gaussians, frame by frame: `A · mᵢ(t)` of the paper's equation 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Modulation {
    /// `n` indices into the avatar's Gaussians, increasing.
    pub gaussians: Vec<u32>,
    /// `T` frame times, seconds.
    pub times_seconds: Vec<f64>,
    /// `T×n`, linear albedo units, frame-major.
    pub offsets: Vec<f32>,
    /// `n` pairs: red and blue offset for one unit of green offset; empty: green alone.
    pub red_blue: Vec<[f32; 2]>,
}

impl Perfusion {
    /// Whether blood arrives everywhere alike.
    pub fn is_even(&self) -> bool {
        self.strength.is_empty()
    }

    fn check(&self, expected: usize) -> Result<(), SpaceError> {
        let what = "the skin's perfusion";
        for found in [self.strength.len(), self.delay_seconds.len()] {
            if found != self.strength.len() || (found != 0 && found != expected) {
                return Err(SpaceError::Length { what, expected, found });
            }
        }
        let broken = |value: &f32, least: f32| !(value.is_finite() && *value >= least);
        for (values, least) in [(&self.strength, 0.0), (&self.delay_seconds, f32::MIN)] {
            if let Some(index) = values.iter().position(|value| broken(value, least)) {
                let value = f64::from(values[index]);
                return Err(SpaceError::NotFinite { what, index, seconds: 0.0, value });
            }
        }
        Ok(())
    }
}

impl Skin {
    /// Checks lengths and order.
    ///
    /// # Errors
    /// When nothing is selected or the arrays contradict one another.
    pub fn checked(self) -> Result<Self, SpaceError> {
        let expected = self.gaussians.len();
        if expected == 0 {
            return Err(SpaceError::Empty("the skin selection"));
        }
        for found in [self.positions.len(), self.green_albedo.len(), self.distances_metres.len()] {
            if found != expected {
                return Err(SpaceError::Length { what: "the skin selection", expected, found });
            }
        }
        check_increasing(&self.gaussians)?;
        check_red_blue("the skin selection", &self.red_blue, expected)?;
        self.perfusion.check(expected)?;
        Ok(self)
    }
}

impl Modulation {
    /// Checks lengths, order and finiteness.
    ///
    /// # Errors
    /// When an array contradicts another, or an offset is not finite.
    pub fn checked(self) -> Result<Self, SpaceError> {
        let expected = self.gaussians.len().saturating_mul(self.times_seconds.len());
        if expected == 0 {
            return Err(SpaceError::Empty("the modulation"));
        }
        if self.offsets.len() != expected {
            return Err(SpaceError::Length { what: "the modulation", expected, found: self.offsets.len() });
        }
        check_increasing(&self.gaussians)?;
        crate::series::check_times("the modulation", &self.times_seconds)?;
        check_red_blue("the modulation", &self.red_blue, self.gaussians.len())?;
        if let Some(index) = self.offsets.iter().position(|offset| !offset.is_finite()) {
            let seconds = self.times_seconds[index / self.gaussians.len()];
            let value = f64::from(self.offsets[index]);
            return Err(SpaceError::NotFinite { what: "the modulation", index, seconds, value });
        }
        Ok(self)
    }

    /// The `n` offsets of one frame.
    pub fn frame(&self, index: usize) -> &[f32] {
        let n = self.gaussians.len();
        &self.offsets[index * n..(index + 1) * n]
    }
}

/// Either empty or one finite pair a Gaussian.
fn check_red_blue(what: &'static str, red_blue: &[[f32; 2]], expected: usize) -> Result<(), SpaceError> {
    if !red_blue.is_empty() && red_blue.len() != expected {
        return Err(SpaceError::Length { what, expected, found: red_blue.len() });
    }
    match red_blue.as_flattened().iter().position(|value| !value.is_finite()) {
        Some(at) => {
            let value = f64::from(red_blue.as_flattened()[at]);
            Err(SpaceError::NotFinite { what, index: at / 2, seconds: 0.0, value })
        }
        None => Ok(()),
    }
}

fn check_increasing(gaussians: &[u32]) -> Result<(), SpaceError> {
    if gaussians.is_sorted_by(|a, b| a < b) {
        Ok(())
    } else {
        Err(SpaceError::Order("the indices of the selected Gaussians"))
    }
}

fn pairs(reader: &BundleReader<'_>) -> Result<Vec<[f32; 2]>, ArtifactError> {
    Ok(reader.shaped::<f32>("red_blue", &[None, Some(2)])?.as_chunks::<2>().0.to_vec())
}

impl Artifact for Skin {
    const TYPE: ArtifactType = ArtifactType { name: "skin", version: 2 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let n = self.gaussians.len();
        Bundle::new()
            .tensor("gaussians", &[n], &self.gaussians)?
            .tensor("positions", &[n, 3], self.positions.as_flattened())?
            .tensor("green_albedo", &[n], &self.green_albedo)?
            .tensor("distances_metres", &[n], &self.distances_metres)?
            .tensor("red_blue", &[self.red_blue.len(), 2], self.red_blue.as_flattened())?
            .tensor("perfusion_strength", &[self.perfusion.strength.len()], &self.perfusion.strength)?
            .tensor("perfusion_delay_seconds", &[self.perfusion.strength.len()], &self.perfusion.delay_seconds)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let positions: Vec<f32> = reader.shaped("positions", &[None, Some(3)])?;
        Self {
            gaussians: reader.tensor("gaussians")?.1,
            positions: positions.as_chunks::<3>().0.to_vec(),
            green_albedo: reader.tensor("green_albedo")?.1,
            distances_metres: reader.tensor("distances_metres")?.1,
            red_blue: pairs(&reader)?,
            perfusion: Perfusion {
                strength: reader.tensor("perfusion_strength")?.1,
                delay_seconds: reader.tensor("perfusion_delay_seconds")?.1,
            },
        }
        .checked()
        .map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}

impl Artifact for Modulation {
    const TYPE: ArtifactType = ArtifactType { name: "modulation", version: 2 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let (t, n) = (self.times_seconds.len(), self.gaussians.len());
        Bundle::new()
            .tensor("gaussians", &[n], &self.gaussians)?
            .tensor("times_seconds", &[t], &self.times_seconds)?
            .tensor("offsets", &[t, n], &self.offsets)?
            .tensor("red_blue", &[self.red_blue.len(), 2], self.red_blue.as_flattened())
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Self {
            gaussians: reader.tensor("gaussians")?.1,
            times_seconds: reader.tensor("times_seconds")?.1,
            offsets: reader.tensor("offsets")?.1,
            red_blue: pairs(&reader)?,
        }
        .checked()
        .map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_that_contradict_themselves_are_refused() {
        let good = Modulation {
            gaussians: vec![1, 5],
            times_seconds: vec![0.0, 0.1],
            offsets: vec![0.0; 4],
            ..Modulation::default()
        };
        assert!(good.clone().checked().is_ok());
        assert!(Modulation { offsets: vec![0.0; 3], ..good.clone() }.checked().is_err());
        assert!(Modulation { gaussians: vec![5, 1], ..good.clone() }.checked().is_err());
        assert!(Modulation { offsets: vec![f32::INFINITY; 4], ..good.clone() }.checked().is_err());
        assert!(Modulation { times_seconds: vec![0.1, 0.1], ..good.clone() }.checked().is_err());
        assert!(Modulation { red_blue: vec![[0.4, 0.5]; 2], ..good.clone() }.checked().is_ok());
        assert!(Modulation { red_blue: vec![[0.4, 0.5]], ..good.clone() }.checked().is_err());
        assert!(Modulation { red_blue: vec![[0.4, f32::NAN]; 2], ..good }.checked().is_err());
    }

    #[test]
    fn tables_survive_the_disk() -> Result<(), ArtifactError> {
        let skin = Skin {
            gaussians: vec![2, 9],
            positions: vec![[0.0, 0.5, 1.0], [-1.0, 0.0, 0.25]],
            green_albedo: vec![0.3, 0.4],
            distances_metres: vec![0.0, 0.001],
            red_blue: vec![[0.5, 0.25], [0.6, 0.2]],
            perfusion: Perfusion { strength: vec![1.5, 0.5], delay_seconds: vec![-0.01, 0.01] },
        };
        let even = Skin { red_blue: Vec::new(), perfusion: Perfusion::default(), ..skin.clone() };
        for skin in [skin.clone(), even] {
            let bytes = skin.to_bundle()?.to_bytes()?;
            assert_eq!(Skin::from_bundle(BundleReader::new(&bytes)?)?, skin);
        }
        for (strength, delay_seconds) in [
            (vec![1.0], vec![0.0]),
            (vec![-1.0, 1.0], vec![0.0; 2]),
            (vec![1.0; 2], vec![f32::NAN; 2]),
            (vec![], vec![0.0; 2]),
        ] {
            let broken = Skin { perfusion: Perfusion { strength, delay_seconds }, ..skin.clone() };
            assert!(broken.checked().is_err());
        }
        Ok(())
    }
}
