//! Which Gaussians are facial skin, and what is added to their green albedo: the two tables that pass between the
//! avatar, the pulse and the readers. Plain data, so that writer and reader of the heartbeat need not know each other.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::SpaceError;

/// The skin Gaussians 𝒢ˢ of an avatar (paper, Methods). All arrays have length `n ≥ 1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Skin {
    /// Indices into the avatar's Gaussians, increasing.
    pub gaussians: Vec<u32>,
    /// Canonical positions scaled into [−1, 1]³ over the selection.
    pub positions: Vec<[f32; 3]>,
    /// Unmodulated linear green albedo, in [0, 1].
    pub green_albedo: Vec<f32>,
    /// Distance to the head mesh in canonical space, metres.
    pub distances_metres: Vec<f32>,
}

/// Offsets added to the linear green albedo of some Gaussians, frame by frame: `A · mᵢ(t)` of the paper's equation 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Modulation {
    /// `n` indices into the avatar's Gaussians, increasing.
    pub gaussians: Vec<u32>,
    /// `T` frame times, seconds.
    pub times_seconds: Vec<f64>,
    /// `T×n`, linear albedo units, frame-major.
    pub offsets: Vec<f32>,
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

fn check_increasing(gaussians: &[u32]) -> Result<(), SpaceError> {
    if gaussians.is_sorted_by(|a, b| a < b) {
        Ok(())
    } else {
        Err(SpaceError::Order("the indices of the selected Gaussians"))
    }
}

impl Artifact for Skin {
    const TYPE: ArtifactType = ArtifactType { name: "skin", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let n = self.gaussians.len();
        Bundle::new()
            .tensor("gaussians", &[n], &self.gaussians)?
            .tensor("positions", &[n, 3], self.positions.as_flattened())?
            .tensor("green_albedo", &[n], &self.green_albedo)?
            .tensor("distances_metres", &[n], &self.distances_metres)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        let positions: Vec<f32> = reader.shaped("positions", &[None, Some(3)])?;
        Self {
            gaussians: reader.tensor("gaussians")?.1,
            positions: positions.as_chunks::<3>().0.to_vec(),
            green_albedo: reader.tensor("green_albedo")?.1,
            distances_metres: reader.tensor("distances_metres")?.1,
        }
        .checked()
        .map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}

impl Artifact for Modulation {
    const TYPE: ArtifactType = ArtifactType { name: "modulation", version: 1 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        let (t, n) = (self.times_seconds.len(), self.gaussians.len());
        Bundle::new()
            .tensor("gaussians", &[n], &self.gaussians)?
            .tensor("times_seconds", &[t], &self.times_seconds)?
            .tensor("offsets", &[t, n], &self.offsets)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Self {
            gaussians: reader.tensor("gaussians")?.1,
            times_seconds: reader.tensor("times_seconds")?.1,
            offsets: reader.tensor("offsets")?.1,
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
        let good = Modulation { gaussians: vec![1, 5], times_seconds: vec![0.0, 0.1], offsets: vec![0.0; 4] };
        assert!(good.clone().checked().is_ok());
        assert!(Modulation { offsets: vec![0.0; 3], ..good.clone() }.checked().is_err());
        assert!(Modulation { gaussians: vec![5, 1], ..good.clone() }.checked().is_err());
        assert!(Modulation { offsets: vec![f32::INFINITY; 4], ..good.clone() }.checked().is_err());
        assert!(Modulation { times_seconds: vec![0.1, 0.1], ..good }.checked().is_err());
    }

    #[test]
    fn tables_survive_the_disk() -> Result<(), ArtifactError> {
        let skin = Skin {
            gaussians: vec![2, 9],
            positions: vec![[0.0, 0.5, 1.0], [-1.0, 0.0, 0.25]],
            green_albedo: vec![0.3, 0.4],
            distances_metres: vec![0.0, 0.001],
        };
        let bytes = skin.to_bundle()?.to_bytes()?;
        assert_eq!(Skin::from_bundle(BundleReader::new(&bytes)?)?, skin);
        Ok(())
    }
}
