//! The renderer as stage 2 sees it: per frame, a sparse linear map from a change of albedo to a change of the picture.
//!
//! Geometry, light and blending are frozen in stage 2, so the rendered linear green of a pixel is affine in the green
//! albedo of the Gaussians that cover it. Pixels are pooled into square cells. For cell `c` of a frame
//! `green(c) = base(c) + Σ_i weight(c, i) · offset_i`, with `weight` the mean over the cell's pixels of
//! irradiance × blend weight. Plain data: whoever reads it knows neither Gaussians nor a camera.

use heartian_artifact::{Artifact, ArtifactError, ArtifactType, Bundle, BundleReader};

use crate::SpaceError;

/// A sparse linear map from albedo offsets to pooled linear green, for some frames of a clip.
///
/// Always holds: offsets start at 0, never decrease and end at the length of what they index; columns are below
/// `column_count`; all values are finite.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AlbedoOperator {
    /// Number of columns: one per modulated Gaussian, in the order of the skin selection.
    pub column_count: usize,
    /// Pixels of a whole picture, skin or not: what a mean over the picture divides by.
    pub picture_pixels: usize,
    /// `F` indices into the clip, increasing: the frames described (training frames only).
    pub frames: Vec<u32>,
    /// `F + 1`: the rows of frame `f` are `row_offsets[f]..row_offsets[f + 1]`.
    pub row_offsets: Vec<u32>,
    /// `R + 1`: the entries of row `r` are `entry_offsets[r]..entry_offsets[r + 1]`.
    pub entry_offsets: Vec<u32>,
    /// `E` column indices.
    pub columns: Vec<u32>,
    /// `E` weights, ∂(linear green of the cell) / ∂(green albedo of the column).
    pub weights: Vec<f32>,
    /// `R` mean linear green of the baseline render over the cell.
    pub base: Vec<f32>,
    /// `R` mean linear green of the recording over the cell.
    pub target: Vec<f32>,
    /// `R` number of pixels in the cell that count.
    pub pixels: Vec<f32>,
}

impl AlbedoOperator {
    /// Checks what always holds.
    ///
    /// # Errors
    /// Names the array that contradicts the others.
    pub fn checked(self) -> Result<Self, SpaceError> {
        let rows = self.base.len();
        let entries = self.columns.len();
        check_offsets("the operator's row offsets", &self.row_offsets, self.frames.len(), rows)?;
        check_offsets("the operator's entry offsets", &self.entry_offsets, rows, entries)?;
        for (what, expected, found) in [
            ("the operator's weights", entries, self.weights.len()),
            ("the operator's targets", rows, self.target.len()),
            ("the operator's pixel counts", rows, self.pixels.len()),
        ] {
            if expected != found {
                return Err(SpaceError::Length { what, expected, found });
            }
        }
        if self.picture_pixels == 0 {
            return Err(SpaceError::Empty("the operator's picture"));
        }
        if let Some(index) = self.columns.iter().position(|&column| column as usize >= self.column_count) {
            let found = self.columns[index] as usize;
            return Err(SpaceError::Length { what: "the operator's columns", expected: self.column_count, found });
        }
        for values in [&self.weights, &self.base, &self.target, &self.pixels] {
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                let value = f64::from(values[index]);
                return Err(SpaceError::NotFinite { what: "the albedo operator", index, seconds: 0.0, value });
            }
        }
        Ok(self)
    }

    /// The rows of the `f`-th described frame.
    pub fn rows_of(&self, f: usize) -> std::ops::Range<usize> {
        self.row_offsets[f] as usize..self.row_offsets[f + 1] as usize
    }

    /// The columns and weights of row `r`.
    pub fn row(&self, r: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let range = self.entry_offsets[r] as usize..self.entry_offsets[r + 1] as usize;
        self.columns[range.clone()].iter().map(|&column| column as usize).zip(self.weights[range].iter().copied())
    }
}

fn check_offsets(what: &'static str, offsets: &[u32], groups: usize, end: usize) -> Result<(), SpaceError> {
    let runs =
        offsets.first() == Some(&0) && offsets.is_sorted() && offsets.last().map(|&last| last as usize) == Some(end);
    if offsets.len() == groups + 1 && runs {
        Ok(())
    } else {
        Err(SpaceError::Length { what, expected: groups + 1, found: offsets.len() })
    }
}

impl Artifact for AlbedoOperator {
    const TYPE: ArtifactType = ArtifactType { name: "albedo_operator", version: 2 };

    fn to_bundle(&self) -> Result<Bundle<'_>, ArtifactError> {
        Bundle::new()
            .tensor("frames", &[self.frames.len()], &self.frames)?
            .tensor("row_offsets", &[self.row_offsets.len()], &self.row_offsets)?
            .tensor("entry_offsets", &[self.entry_offsets.len()], &self.entry_offsets)?
            .tensor("columns", &[self.columns.len()], &self.columns)?
            .tensor("weights", &[self.weights.len()], &self.weights)?
            .tensor("base", &[self.base.len()], &self.base)?
            .tensor("target", &[self.target.len()], &self.target)?
            .tensor("pixels", &[self.pixels.len()], &self.pixels)?
            .meta("column_count", &self.column_count)?
            .meta("picture_pixels", &self.picture_pixels)
    }

    fn from_bundle(reader: BundleReader<'_>) -> Result<Self, ArtifactError> {
        Self {
            column_count: reader.meta("column_count")?,
            picture_pixels: reader.meta("picture_pixels")?,
            frames: reader.tensor("frames")?.1,
            row_offsets: reader.tensor("row_offsets")?.1,
            entry_offsets: reader.tensor("entry_offsets")?.1,
            columns: reader.tensor("columns")?.1,
            weights: reader.tensor("weights")?.1,
            base: reader.tensor("base")?.1,
            target: reader.tensor("target")?.1,
            pixels: reader.tensor("pixels")?.1,
        }
        .checked()
        .map_err(|error| ArtifactError::Invalid(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contradictory_arrays_are_refused() {
        let good = AlbedoOperator {
            column_count: 2,
            picture_pixels: 64,
            frames: vec![4],
            row_offsets: vec![0, 2],
            entry_offsets: vec![0, 1, 3],
            columns: vec![0, 0, 1],
            weights: vec![0.5; 3],
            base: vec![0.1; 2],
            target: vec![0.2; 2],
            pixels: vec![16.0; 2],
        };
        assert!(good.clone().checked().is_ok_and(|operator| operator.row(1).count() == 2));
        let broken: [fn(&mut AlbedoOperator); 5] = [
            |operator| operator.columns[2] = 2,
            |operator| operator.picture_pixels = 0,
            |operator| operator.entry_offsets[1] = 9,
            |operator| operator.weights[0] = f32::NAN,
            |operator| operator.row_offsets = vec![1, 2],
        ];
        for damage in broken {
            let mut operator = good.clone();
            damage(&mut operator);
            assert!(operator.checked().is_err());
        }
    }
}
