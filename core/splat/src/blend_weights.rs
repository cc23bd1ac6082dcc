//! The render as a linear operator: how much of each Gaussian's features a cell of the picture holds.
//!
//! With geometry frozen, the composited value of a cell of `k × k` pixels is `Σ weight·feature` over the Gaussians, the
//! weight being the sum over the cell's pixels of `factor·α·T`. What always holds: rows are cells in row-major order, the
//! columns of a row ascend, no pair appears twice, and the operator times the features equals the pooled picture.

use crate::bin::{TILE_HEIGHT, TILE_WIDTH};
use crate::error::{SplatError, expect_length};
use crate::raster;
use crate::render::Prepared;
use rayon::prelude::*;

/// A sparse matrix by rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Csr {
    /// `rows + 1` starts of the rows in the other two.
    pub offsets: Vec<u32>,
    /// Gaussian of each entry, ascending in a row.
    pub columns: Vec<u32>,
    /// Weight of each entry.
    pub values: Vec<f32>,
}

impl Csr {
    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// The entries of a row; empty when there is no such row.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (u32, f32)> + '_ {
        let range = match (self.offsets.get(row), self.offsets.get(row + 1)) {
            (Some(&from), Some(&to)) => from as usize..to as usize,
            _ => 0..0,
        };
        self.columns[range.clone()].iter().copied().zip(self.values[range].iter().copied())
    }
}

/// The operator from the Gaussians' features to sums over cells of `cell_px × cell_px` pixels (the last row and column of
/// cells may be cut by the picture's edge): `ceil(height/cell) · ceil(width/cell)` rows.
///
/// `subset` marks the Gaussians that get columns (all, when `None`; the others still hide what is behind them), `factor` is
/// a picture that multiplies each pixel's weights (1 when `None`).
///
/// # Errors
/// When a length contradicts the scene or the picture, or the cell has no size.
pub fn blend_weights(
    prepared: &Prepared,
    subset: Option<&[bool]>,
    cell_px: usize,
    factor: Option<&[f32]>,
) -> Result<Csr, SplatError> {
    let (width, height) = (prepared.camera.width, prepared.camera.height);
    if let Some(subset) = subset {
        expect_length("the subset", prepared.count, subset.len())?;
    }
    if let Some(factor) = factor {
        expect_length("the factor picture", width * height, factor.len())?;
    }
    if cell_px == 0 {
        return Err(SplatError::Length { what: "a cell's side in pixels", expected: 1, found: 0 });
    }
    let tiles: Vec<Vec<(u64, f32)>> = (0..prepared.tiles.columns * prepared.tiles.rows)
        .into_par_iter()
        .map(|index| tile_weights(prepared, index, subset, cell_px, factor))
        .collect();
    // A cell is fed by several tiles: order by cell, then Gaussian; equal keys stay in the order of the tiles.
    let mut entries: Vec<(u64, f32)> = tiles.concat();
    entries.par_sort_by_key(|(key, _)| *key);
    let cells = width.div_ceil(cell_px) * height.div_ceil(cell_px);
    let mut out = Csr { offsets: vec![0; cells + 1], columns: Vec::with_capacity(entries.len()), values: Vec::new() };
    let mut last = None;
    for (key, weight) in entries {
        if last == Some(key) {
            if let Some(value) = out.values.last_mut() {
                *value += weight;
            }
            continue;
        }
        last = Some(key);
        out.offsets[(key >> 32) as usize + 1] += 1;
        out.columns.push(key as u32);
        out.values.push(weight);
    }
    for cell in 0..cells {
        out.offsets[cell + 1] += out.offsets[cell];
    }
    Ok(out)
}

/// Weights of one tile as (cell ‖ Gaussian, weight).
fn tile_weights(
    prepared: &Prepared,
    index: usize,
    subset: Option<&[bool]>,
    cell: usize,
    factor: Option<&[f32]>,
) -> Vec<(u64, f32)> {
    let job = prepared.job(index);
    let width = prepared.camera.width;
    let cells_in_row = width.div_ceil(cell);
    let first = [job.origin[0] / cell, job.origin[1] / cell];
    let span = [TILE_WIDTH.div_ceil(cell) + 1, TILE_HEIGHT.div_ceil(cell) + 1];
    let column_of: [usize; TILE_WIDTH] = std::array::from_fn(|x| (job.origin[0] + x) / cell - first[0]);
    let mut sums = vec![0.0f32; span[0] * span[1]];
    let mut out = Vec::new();
    raster::weights(&job, prepared.channels, &mut |gaussian, pixels: &mut dyn Iterator<Item = (usize, usize, f32)>| {
        if subset.is_some_and(|subset| !subset[gaussian as usize]) {
            return;
        }
        for (x, y, weight) in pixels {
            let row = (job.origin[1] + y) / cell - first[1];
            let scaled = factor.map_or(weight, |f| weight * f[(job.origin[1] + y) * width + job.origin[0] + x]);
            sums[row * span[0] + column_of[x]] += scaled;
        }
        for (at, sum) in sums.iter_mut().enumerate().filter(|(_, sum)| **sum != 0.0) {
            let (row, column) = (first[1] + at / span[0], first[0] + at % span[0]);
            out.push((((row * cells_in_row + column) as u64) << 32 | u64::from(gaussian), std::mem::take(sum)));
        }
    });
    out
}
