//! L_base of stage 2 without rasterising: the L1 of sRGB green over pooled cells as a quadratic in the albedo offsets.
//!
//! The rendered linear green of a cell is affine in the offsets (`heartian_space::AlbedoOperator`). The sRGB transfer
//! is linearised at the cell's base value, and |e| is bounded from above by e²/(2|e₀|) + |e₀|/2 with e₀ the error at
//! zero offset, floored at one 8-bit level. Columns are pooled into groups that share an offset, so that a frame's loss
//! is ½xᵀHx + bᵀx + c with x one offset a group. Differs from the paper, whose L_base also has D-SSIM: offsets of a
//! few tenths of an 8-bit level leave local structure as it is.

use heartian_space::AlbedoOperator;
use heartian_space::color::{srgb_from_linear, srgb_from_linear_derivative};

use crate::error::{PulseError, check_length};

/// A renderer whose geometry and light are frozen, as much of it as stage 2 needs. [`AlbedoOperator`] is the one it uses;
/// [`crate::FrameByFrame`], which renders anew at every step, is what it is judged by.
pub trait FrozenRenderer {
    /// Number of skin Gaussians.
    fn gaussians(&self) -> usize;

    /// How many 8-bit levels one unit of uniform albedo offset moves the picture; `None` when it never shows the skin.
    fn levels_per_albedo(&self) -> Option<f64>;

    /// How many 8-bit levels one unit of albedo offset moves the pixel that answers most, one value for each of `frames`
    /// frames: what the bound on visible flashes is held against.
    fn most_levels_per_albedo(&self, frames: usize) -> Option<Vec<f64>> {
        self.levels_per_albedo().map(|levels| vec![levels; frames])
    }

    /// L_base where skin Gaussian i has the offset of group `group_of[i] < groups`.
    ///
    /// # Errors
    /// When `group_of` does not name a group for each skin Gaussian.
    fn base_loss<'a>(&'a self, group_of: &[usize], groups: usize) -> Result<Box<dyn BaseLoss + 'a>, PulseError>;
}

/// The photometric loss of stage 2 on offsets that groups share.
pub trait BaseLoss {
    /// The loss at `offsets` (T×groups, linear albedo); **adds** `scale` times its gradient to `gradient`.
    ///
    /// # Errors
    /// When the renderer refuses.
    fn evaluate(&self, offsets: &[f64], scale: f64, gradient: &mut [f64]) -> Result<f64, PulseError>;
}

impl FrozenRenderer for AlbedoOperator {
    fn gaussians(&self) -> usize {
        self.column_count
    }

    fn levels_per_albedo(&self) -> Option<f64> {
        levels_per_albedo(self)
    }

    fn most_levels_per_albedo(&self, frames: usize) -> Option<Vec<f64>> {
        most_levels_per_albedo(self, frames)
    }

    fn base_loss<'a>(&'a self, group_of: &[usize], groups: usize) -> Result<Box<dyn BaseLoss + 'a>, PulseError> {
        Ok(Box::new(RenderLoss::new(self, group_of, groups)?))
    }
}

impl BaseLoss for RenderLoss {
    fn evaluate(&self, offsets: &[f64], scale: f64, gradient: &mut [f64]) -> Result<f64, PulseError> {
        Ok(self.loss(offsets, scale, gradient))
    }
}

/// Share of the absolute error in L_base; the rest is D-SSIM (stage 1 has the same).
const L1_SHARE: f64 = 0.8;
/// Errors below one 8-bit level are penalised quadratically.
const LEAST_ERROR: f64 = 1.0 / 255.0;

/// The quadratic surrogate for `groups` shared offsets a frame. Values are means over the described frames of means over
/// all pixels and channels of a picture, as L_base is; what no skin reaches counts as without error.
#[derive(Clone, Debug)]
pub struct RenderLoss {
    groups: usize,
    frames: Vec<usize>,
    hessian: Vec<f64>,
    slope: Vec<f64>,
    constant: f64,
}

/// What L_base's mean divides by: channels of pixels of the described frames.
fn values_counted(operator: &AlbedoOperator) -> f64 {
    (3 * operator.picture_pixels * operator.frames.len()).max(1) as f64
}

/// A cell's error and its sensitivity to the linear green, in sRGB units, with its weight in L_base.
fn cell(operator: &AlbedoOperator, row: usize, values: f64) -> (f64, f64, f64) {
    let (base, target) = (operator.base[row].max(0.0), operator.target[row].max(0.0));
    let error = f64::from(srgb_from_linear(base)) - f64::from(srgb_from_linear(target));
    (error, f64::from(srgb_from_linear_derivative(base)), L1_SHARE * f64::from(operator.pixels[row]) / values)
}

impl RenderLoss {
    /// Pools the operator's columns: column i belongs to `group_of[i] < groups`.
    ///
    /// # Errors
    /// When `group_of` does not name a group for each column.
    pub fn new(operator: &AlbedoOperator, group_of: &[usize], groups: usize) -> Result<Self, PulseError> {
        check_length("the group of each skin Gaussian", operator.column_count, group_of.len())?;
        let values = values_counted(operator);
        let frames: Vec<usize> = operator.frames.iter().map(|&frame| frame as usize).collect();
        let mut hessian = vec![0.0; frames.len() * groups * groups];
        let (mut slope, mut constant) = (vec![0.0; frames.len() * groups], 0.0);
        let mut pooled = vec![0.0; groups];
        for f in 0..frames.len() {
            let hessian = &mut hessian[f * groups * groups..(f + 1) * groups * groups];
            let slope = &mut slope[f * groups..(f + 1) * groups];
            for row in operator.rows_of(f) {
                let (error, transfer, share) = cell(operator, row, values);
                constant += share * error.abs();
                pooled.fill(0.0);
                for (column, weight) in operator.row(row) {
                    pooled[group_of[column].min(groups - 1)] += f64::from(weight) * transfer;
                }
                let curvature = share / error.abs().max(LEAST_ERROR);
                for a in 0..groups {
                    if pooled[a] == 0.0 {
                        continue;
                    }
                    slope[a] += curvature * error * pooled[a];
                    for b in 0..groups {
                        hessian[a * groups + b] += curvature * pooled[a] * pooled[b];
                    }
                }
            }
        }
        Ok(Self { groups, frames, hessian, slope, constant })
    }

    /// The surrogate and its gradient: `offsets` is T×groups in linear albedo; `scale`·gradient is added to `gradient`.
    /// Frames beyond the offsets are skipped.
    pub fn loss(&self, offsets: &[f64], scale: f64, gradient: &mut [f64]) -> f64 {
        let g = self.groups;
        let mut loss = self.constant;
        for (f, &frame) in self.frames.iter().enumerate() {
            let Some(x) = offsets.get(frame * g..(frame + 1) * g) else { continue };
            let pulled = &mut gradient[frame * g..(frame + 1) * g];
            for a in 0..g {
                let row = &self.hessian[(f * g + a) * g..(f * g + a + 1) * g];
                let curved: f64 = row.iter().zip(x).map(|(h, x)| h * x).sum();
                loss += x[a] * (0.5 * curved + self.slope[f * g + a]);
                pulled[a] += scale * (curved + self.slope[f * g + a]);
            }
        }
        loss
    }
}

/// The plain text of what the surrogate bounds, for dense `offsets` (T×n).
pub fn exact_l1(operator: &AlbedoOperator, offsets: &[f64]) -> f64 {
    let n = operator.column_count;
    let values = values_counted(operator);
    let mut loss = 0.0;
    for (f, &frame) in operator.frames.iter().enumerate() {
        for row in operator.rows_of(f) {
            let shift: f64 = operator.row(row).map(|(i, w)| f64::from(w) * offsets[frame as usize * n + i]).sum();
            let green = (f64::from(operator.base[row]) + shift).max(0.0);
            let error = srgb_from_linear(green as f32) - srgb_from_linear(operator.target[row].max(0.0));
            loss += L1_SHARE * f64::from(error.abs()) * f64::from(operator.pixels[row]) / values;
        }
    }
    loss
}

/// How many 8-bit levels one unit of uniform albedo offset moves the picture: the pixel-weighted mean over lit cells;
/// `None` when no cell sees the skin.
pub fn levels_per_albedo(operator: &AlbedoOperator) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for row in 0..operator.base.len() {
        let reach: f64 = operator.row(row).map(|(_, weight)| f64::from(weight)).sum();
        if reach > 0.0 {
            let transfer = f64::from(srgb_from_linear_derivative(operator.base[row].max(1e-4)));
            // Cells that barely see the skin should not dilute the answer: weigh by reach too.
            let weight = f64::from(operator.pixels[row]) * reach;
            sum += weight * 255.0 * transfer * reach;
            count += weight;
        }
    }
    (count > 0.0).then(|| sum / count)
}

/// Step of albedo by which the answer of a cell is taken, downward: sRGB is concave, so a darker cell answers more, and
/// no smaller step in either direction is underestimated.
const ANSWER_STEP: f32 = 0.02;

/// How many 8-bit levels one unit of albedo offset moves the cell that answers most, frame by frame; between described
/// frames the larger of both neighbours, so that no frame is thought calmer than it is. `None` without a lit cell.
pub fn most_levels_per_albedo(operator: &AlbedoOperator, frames: usize) -> Option<Vec<f64>> {
    let answer = |row: usize| {
        let reach: f32 = operator.row(row).map(|(_, weight)| weight).sum();
        let base = operator.base[row].max(0.0);
        let darker = (base - reach * ANSWER_STEP).max(0.0);
        255.0 * f64::from((srgb_from_linear(base) - srgb_from_linear(darker)) / ANSWER_STEP)
    };
    let described: Vec<(usize, f64)> = (0..operator.frames.len())
        .map(|f| (operator.frames[f] as usize, operator.rows_of(f).map(answer).fold(0.0, f64::max)))
        .filter(|(_, most)| *most > 0.0)
        .collect();
    let (Some(&first), Some(&last)) = (described.first(), described.last()) else { return None };
    let of = |frame: usize| {
        let after = described.partition_point(|(described, _)| *described < frame);
        let (before, after) = (described.get(after.wrapping_sub(1)), described.get(after));
        before.map_or(first.1, |b| b.1).max(after.map_or(last.1, |a| a.1))
    };
    Some((0..frames).map(of).collect())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
pub(crate) mod tests {
    use super::*;
    use crate::numeric::Random;

    /// A made-up picture: `frames` × `cells` cells, each seen by three of `columns` Gaussians.
    pub(crate) fn made_up_operator(frames: u32, cells: usize, columns: usize, seed: u64) -> AlbedoOperator {
        let mut random = Random::new(seed);
        let rows = frames as usize * cells;
        let mut operator = AlbedoOperator {
            column_count: columns,
            picture_pixels: 256 * cells,
            frames: (0..frames).collect(),
            row_offsets: (0..=frames).map(|f| f * cells as u32).collect(),
            entry_offsets: (0..=rows as u32).map(|r| r * 3).collect(),
            ..AlbedoOperator::default()
        };
        for _ in 0..rows {
            let base = 0.1 + 0.4 * random.unit();
            operator.base.push(base as f32);
            operator.target.push((base + 0.02 * random.normal()).max(0.01) as f32);
            operator.pixels.push(64.0);
            for _ in 0..3 {
                operator.columns.push(random.below(columns) as u32);
                operator.weights.push(0.3 * random.unit() as f32);
            }
        }
        operator.checked().unwrap()
    }

    #[test]
    fn surrogate_touches_the_exact_loss_at_zero_and_bounds_it_near() {
        let operator = made_up_operator(4, 50, 6, 5);
        let group_of: Vec<usize> = (0..6).collect();
        let surrogate = RenderLoss::new(&operator, &group_of, 6).unwrap();
        let zero = vec![0.0; 24];
        let at_zero = surrogate.loss(&zero, 1.0, &mut [0.0; 24]);
        assert!((at_zero - exact_l1(&operator, &zero)).abs() < 1e-6);
        let mut random = Random::new(8);
        for _ in 0..20 {
            let x: Vec<f64> = (0..24).map(|_| 0.005 * random.normal()).collect();
            let (above, exact) = (surrogate.loss(&x, 1.0, &mut [0.0; 24]), exact_l1(&operator, &x));
            assert!(above > exact - 1e-5 && above < exact + 0.01, "{above} {exact}");
        }
    }

    #[test]
    fn the_cell_that_answers_most_answers_no_more_than_is_told() {
        let mut operator = made_up_operator(6, 40, 8, 7);
        operator.frames = vec![0, 2, 4, 6, 8, 10];
        let told = most_levels_per_albedo(&operator, 14).unwrap();
        let levels = |value: f32| 255.0 * f64::from(srgb_from_linear(value.max(0.0)));
        for f in 0..6 {
            let mut most = 0.0f64;
            for (row, offset) in operator.rows_of(f).flat_map(|row| [(row, -0.015f32), (row, 0.015)]) {
                let moved: f32 = operator.row(row).map(|(_, weight)| weight * offset).sum();
                most = most.max((levels(operator.base[row] + moved) - levels(operator.base[row])).abs());
            }
            let bound = 0.015 * told[2 * f];
            assert!(most <= bound * (1.0 + 1e-4) && (f % 2 > 0 || most > 0.5 * bound), "{f}: {most} {bound}");
        }
        assert!(told[1] >= told[0].min(told[2]) && told[13] == told[11], "{told:?}");
        assert!(most_levels_per_albedo(&AlbedoOperator::default(), 3).is_none());
        let mean = levels_per_albedo(&operator).unwrap();
        assert!(told.iter().all(|most| *most >= mean));
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let operator = made_up_operator(3, 20, 5, 6);
        let surrogate = RenderLoss::new(&operator, &[0, 1, 0, 1, 1], 2).unwrap();
        let x = [0.003, -0.002, 0.001, 0.004, -0.004, 0.0];
        let mut gradient = [0.0; 6];
        surrogate.loss(&x, 1.0, &mut gradient);
        for k in 0..6 {
            let (h, mut up, mut down) = (1e-6, x, x);
            up[k] += h;
            down[k] -= h;
            let slope =
                (surrogate.loss(&up, 1.0, &mut [0.0; 6]) - surrogate.loss(&down, 1.0, &mut [0.0; 6])) / (2.0 * h);
            assert!((slope - gradient[k]).abs() < 1e-8);
        }
        assert!(RenderLoss::new(&operator, &[0, 1], 2).is_err());
    }
}
