//! One frame: its unknowns, its residuals with their exact Jacobian, and the damped Gauss–Newton fit.
//!
//! Unknowns, in order: turn of the head (3, applied on the left of the rotation), translation (3, metres), jaw (3,
//! axis-angle), expression (E), lids (2). The camera sits at the world's origin looking along −z. Residuals are pixels
//! divided by the scale, robustified by Geman–McClure's function of each landmark's distance.

use glam::{DMat3, DVec2, DVec3};

use super::linear::{Design, damped_solve};
use super::points::{Points, Shape, cross_matrix, right_jacobian, rotation};

/// Where rotation, translation, jaw, expression and lids start in the vector of unknowns.
pub const JAW: usize = 6;
/// First expression coefficient.
pub const EXPRESSION: usize = 9;
/// Bounds of the jaw's opening, radians.
const JAW_RANGE: [f64; 2] = [0.0, 0.7];
/// Bound of an expression coefficient.
const EXPRESSION_LIMIT: f64 = 3.0;
/// A residual of this many scales pulls a quarter as hard as a quadratic loss would let it.
const ROBUST: f64 = 8.0;
/// Weight of the squared distance of a lid from how far a blink closes it.
const CLOSURE: f64 = 400.0;

/// Pinhole intrinsics.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Focal length, pixels.
    pub focal: f64,
    /// Principal point, pixels.
    pub centre: DVec2,
}

/// The landmarks of one frame that the head knows.
#[derive(Clone, Default)]
pub struct Seen {
    /// Point number in [`Points`].
    pub points: Vec<usize>,
    /// Where it was seen, pixels.
    pub pixels: Vec<DVec2>,
    /// Confidence.
    pub weights: Vec<f64>,
    /// How far both lids are closed, where the clip shows it better than these landmarks do.
    pub closure: Option<f64>,
}

/// The unknowns of a frame.
#[derive(Clone, Debug)]
pub struct State {
    /// World from head.
    pub rotation: DMat3,
    /// World from head, metres.
    pub translation: DVec3,
    /// Axis-angle.
    pub jaw: DVec3,
    /// Expression coefficients.
    pub expression: Vec<f64>,
    /// Left and right lid.
    pub eyelids: [f64; 2],
}

/// What all frames share while one is fitted.
pub struct Setting<'a> {
    /// The landmark points.
    pub points: &'a Points,
    /// Their positions for this person.
    pub shape: &'a Shape,
    /// The camera.
    pub lens: Lens,
    /// Pixels that count as one.
    pub scale_px: f64,
    /// Weight of each unknown's square.
    pub prior: &'a [f64],
}

impl State {
    /// Facing the camera a metre away.
    pub fn rest(expression_count: usize) -> Self {
        Self {
            rotation: DMat3::IDENTITY,
            translation: DVec3::new(0.0, 0.0, -1.0),
            jaw: DVec3::ZERO,
            expression: vec![0.0; expression_count],
            eyelids: [0.0; 2],
        }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        EXPRESSION + self.expression.len() + 2
    }

    /// The unknowns that have a prior and bounds, as a vector (rotation and translation are 0).
    pub fn local(&self) -> Vec<f64> {
        let mut values = vec![0.0; JAW];
        values.extend(self.jaw.to_array());
        values.extend(&self.expression);
        values.extend(self.eyelids);
        values
    }

    /// The state after a step, clamped to what a head can do.
    pub fn stepped(&self, step: &[f64]) -> Self {
        let turn = DVec3::from_slice(step);
        let mut next = self.clone();
        next.rotation = rotation(turn) * self.rotation;
        next.translation += DVec3::from_slice(&step[3..]);
        next.jaw += DVec3::from_slice(&step[JAW..]);
        next.jaw.x = next.jaw.x.clamp(JAW_RANGE[0], JAW_RANGE[1]);
        for (value, change) in next.expression.iter_mut().zip(&step[EXPRESSION..]) {
            *value = (*value + change).clamp(-EXPRESSION_LIMIT, EXPRESSION_LIMIT);
        }
        let lids = &step[EXPRESSION + self.expression.len()..];
        for (value, change) in next.eyelids.iter_mut().zip(lids) {
            *value = (*value + change).clamp(0.0, 1.0);
        }
        next
    }

    /// Unknowns that sit at a bound and whose gradient pushes them beyond.
    pub fn held(&self, gradient: &[f64]) -> Vec<bool> {
        let values = self.local();
        let lids = EXPRESSION + self.expression.len();
        (0..values.len())
            .map(|k| {
                let [low, high] = match k {
                    JAW => JAW_RANGE,
                    k if k >= lids => [0.0, 1.0],
                    k if k >= EXPRESSION => [-EXPRESSION_LIMIT, EXPRESSION_LIMIT],
                    _ => return false,
                };
                values[k] <= low && gradient[k] > 0.0 || values[k] >= high && gradient[k] < 0.0
            })
            .collect()
    }

    pub fn is_finite(&self) -> bool {
        let fixed = self.rotation.is_finite() && self.translation.is_finite() && self.jaw.is_finite();
        fixed && self.expression.iter().chain(&self.eyelids).all(|value| value.is_finite())
    }

    /// A point of the head after expression, lids and jaw, and what it was before the jaw turned.
    fn point_in_head(&self, points: &Points, shape: &Shape, point: usize, jaw: &DMat3) -> (DVec3, DVec3) {
        let count = points.len();
        let mut rest = shape.rest[point];
        for (mode, coefficient) in self.expression.iter().enumerate() {
            rest += points.expression[mode * count + point] * *coefficient;
        }
        for (mode, coefficient) in self.eyelids.iter().enumerate() {
            rest += points.eyelids[mode * count + point] * *coefficient;
        }
        let arm = rest - shape.jaw;
        (rest + (*jaw * arm - arm) * points.jaw_weights[point], arm)
    }

    /// Pixel of a landmark point; `None` behind the camera.
    pub fn project(&self, setting: &Setting, point: usize, jaw: &DMat3) -> Option<DVec2> {
        let (in_head, _) = self.point_in_head(setting.points, setting.shape, point, jaw);
        let y = self.rotation * in_head + self.translation;
        let Lens { focal, centre } = setting.lens;
        (y.z < -1e-3).then(|| centre + DVec2::new(-focal * y.x / y.z, focal * y.y / y.z))
    }
}

/// Geman–McClure cost of a squared residual, and its derivative.
pub fn robust(squared: f64) -> (f64, f64) {
    let c = ROBUST * ROBUST;
    (c * squared / (c + squared), (c / (c + squared)).powi(2))
}

/// Cost of a frame: robust residuals and priors. Infinite when a point falls behind the camera.
pub fn cost(setting: &Setting, seen: &Seen, state: &State) -> f64 {
    let jaw = rotation(state.jaw);
    let mut residuals = vec![None; setting.points.len()];
    let mut sum = 0.0;
    for (k, &point) in seen.points.iter().enumerate() {
        let Some(pixel) = state.project(setting, point, &jaw) else { return f64::INFINITY };
        let residual = (pixel - seen.pixels[k]) / setting.scale_px;
        let weight = seen.weights[k] * setting.points.importance[point];
        sum += weight * robust(residual.length_squared()).0;
        residuals[point] = Some((residual, weight));
    }
    for [upper, lower] in &setting.points.gaps {
        if let (Some((a, wa)), Some((b, wb))) = (residuals[*upper], residuals[*lower]) {
            sum += wa.min(wb) * robust((a - b).length_squared()).0;
        }
    }
    let local = state.local();
    if let Some(closure) = seen.closure {
        sum += state.eyelids.iter().map(|lid| CLOSURE * (lid - closure).powi(2)).sum::<f64>();
    }
    sum + local.iter().zip(setting.prior).map(|(value, weight)| weight * value * value).sum::<f64>()
}

/// How many unknowns beyond the frame's own a linearisation covers: identity modes, and perhaps the focal length.
#[derive(Clone, Copy, Default)]
pub struct Shared {
    /// Identity modes.
    pub identity: usize,
    /// Whether the logarithm of the focal length is the last unknown.
    pub focal: bool,
}

impl Shared {
    /// Number of shared unknowns.
    pub fn count(self) -> usize {
        self.identity + usize::from(self.focal)
    }
}

/// Weighted rows of a frame's least-squares problem (without priors): the frame's unknowns, then the shared ones.
/// `None` when a point falls behind the camera.
pub fn linearised(setting: &Setting, seen: &Seen, state: &State, shared: Shared) -> Option<Design> {
    let points = setting.points;
    let jaw = JawTurn::new(state.jaw);
    let width = state.unknowns() + shared.count();
    let rows = 2 * (seen.points.len() + points.gaps.len());
    let mut design = Design::new(rows, width);
    let mut rows_of = vec![None; points.len()];
    let mut column = vec![DVec2::ZERO; width];
    for (k, &point) in seen.points.iter().enumerate() {
        let pixel = jacobian(setting, state, (point, &jaw, shared), &mut column)?;
        let residual = (pixel - seen.pixels[k]) / setting.scale_px;
        let weight = seen.weights[k] * points.importance[point];
        let root = (weight * robust(residual.length_squared()).1).sqrt();
        for (entry, derivative) in column.iter().enumerate() {
            let scaled = *derivative * (root / setting.scale_px);
            design.columns[entry * rows + 2 * k] = scaled.x;
            design.columns[entry * rows + 2 * k + 1] = scaled.y;
        }
        design.columns[width * rows + 2 * k] = root * residual.x;
        design.columns[width * rows + 2 * k + 1] = root * residual.y;
        rows_of[point] = Some((k, root, weight));
    }
    for (g, [upper, lower]) in points.gaps.iter().enumerate() {
        if let (Some(a), Some(b)) = (rows_of[*upper], rows_of[*lower]) {
            add_gap(&mut design, seen.points.len() + g, [a, b]);
        }
    }
    Some(design)
}

/// Adds the difference of two landmarks' rows as a row of its own.
fn add_gap(design: &mut Design, at: usize, [a, b]: [(usize, f64, f64); 2]) {
    let rows = design.rows;
    let plain = |values: &[f64], (k, root, _): (usize, f64, f64), axis: usize| values[2 * k + axis] / root.max(1e-12);
    let residual = &design.columns[design.width * rows..];
    let squared: f64 = (0..2).map(|axis| (plain(residual, a, axis) - plain(residual, b, axis)).powi(2)).sum();
    let root = (a.2.min(b.2) * robust(squared).1).sqrt();
    for column in design.columns.chunks_mut(rows) {
        for axis in 0..2 {
            column[2 * at + axis] = root * (plain(column, a, axis) - plain(column, b, axis));
        }
    }
}

/// The jaw's rotation and its derivative's right factor.
pub struct JawTurn {
    matrix: DMat3,
    right: DMat3,
}

impl JawTurn {
    fn new(jaw: DVec3) -> Self {
        Self { matrix: rotation(jaw), right: right_jacobian(jaw) }
    }
}

/// Pixel of a point and its derivatives by all unknowns.
fn jacobian(
    setting: &Setting,
    state: &State,
    (point, jaw, shared): (usize, &JawTurn, Shared),
    column: &mut [DVec2],
) -> Option<DVec2> {
    let (points, count) = (setting.points, setting.points.len());
    let (in_head, arm) = state.point_in_head(points, setting.shape, point, &jaw.matrix);
    let turned = state.rotation * in_head;
    let y = turned + state.translation;
    let Lens { focal, centre } = setting.lens;
    if y.z > -1e-3 {
        return None;
    }
    let inverse = -1.0 / y.z;
    let offset = DVec2::new(focal * y.x * inverse, -focal * y.y * inverse);
    // Rows of d pixel / d world point.
    let by_world =
        [DVec3::new(focal * inverse, 0.0, offset.x * inverse), DVec3::new(0.0, -focal * inverse, offset.y * inverse)];
    let along = |direction: DVec3| DVec2::new(by_world[0].dot(direction), by_world[1].dot(direction));
    let turn = -cross_matrix(turned);
    for axis in 0..3 {
        column[axis] = along(turn.col(axis));
        column[3 + axis] = along(DVec3::AXES[axis]);
    }
    let weight = points.jaw_weights[point];
    let by_jaw = state.rotation * (jaw.matrix * cross_matrix(arm) * jaw.right) * -weight;
    for axis in 0..3 {
        column[JAW + axis] = along(by_jaw.col(axis));
    }
    let blend = (jaw.matrix - DMat3::IDENTITY) * weight;
    let by_rest = (state.rotation * (DMat3::IDENTITY + blend)).transpose();
    let by_hinge = (state.rotation * blend).transpose();
    let rest_rows = [by_rest * by_world[0], by_rest * by_world[1]];
    let hinge_rows = [by_hinge * by_world[0], by_hinge * by_world[1]];
    let by = |rows: &[DVec3; 2], direction: DVec3| DVec2::new(rows[0].dot(direction), rows[1].dot(direction));
    let expressions = state.expression.len();
    for mode in 0..expressions {
        column[EXPRESSION + mode] = by(&rest_rows, points.expression[mode * count + point]);
    }
    for mode in 0..2 {
        column[EXPRESSION + expressions + mode] = by(&rest_rows, points.eyelids[mode * count + point]);
    }
    let first = state.unknowns();
    for mode in 0..shared.identity {
        column[first + mode] =
            by(&rest_rows, points.identity[mode * count + point]) - by(&hinge_rows, points.jaw_identity[mode]);
    }
    if shared.focal {
        column[first + shared.identity] = offset;
    }
    Some(centre + offset)
}

/// Fits one frame from a start. `iterations` bounds the work; the best state found is returned with its cost.
pub fn fit(setting: &Setting, seen: &Seen, start: State, iterations: usize) -> (State, f64) {
    let mut state = start;
    let mut best = cost(setting, seen, &state);
    let mut damping = 1e-3;
    for _ in 0..iterations {
        let Some(design) = linearised(setting, seen, &state, Shared::default()) else { break };
        let (mut matrix, mut gradient) = design.normal();
        add_beliefs(&mut matrix, &mut gradient, setting.prior, (seen, &state));
        let held = state.held(&gradient);
        let mut gain = 0.0;
        for _ in 0..6 {
            let step = damped_solve(&matrix, &gradient, damping, &held);
            let trial = step.map(|step| state.stepped(&step.iter().map(|value| -value).collect::<Vec<f64>>()));
            let trial_cost = trial.as_ref().map_or(f64::INFINITY, |trial| cost(setting, seen, trial));
            if let (Some(trial), true) = (trial, trial_cost < best) {
                gain = (best - trial_cost) / best.max(1e-12);
                (state, best) = (trial, trial_cost);
                damping = (damping * 0.2).max(1e-7);
                break;
            }
            damping *= 8.0;
        }
        if gain < 1e-4 {
            break;
        }
    }
    (state, best)
}

/// Adds to a frame's own normal equations what is believed beside its landmarks: the priors, and a blink's closure.
pub fn add_beliefs(matrix: &mut [f64], gradient: &mut [f64], prior: &[f64], (seen, state): (&Seen, &State)) {
    add_prior(matrix, gradient, prior, &state.local());
    let n = gradient.len();
    if let Some(closure) = seen.closure {
        for (k, lid) in (n - 2..n).zip(state.eyelids) {
            matrix[k * n + k] += CLOSURE;
            gradient[k] += CLOSURE * (lid - closure);
        }
    }
}

/// Adds a diagonal prior to normal equations whose first unknowns it concerns.
pub fn add_prior(matrix: &mut [f64], gradient: &mut [f64], prior: &[f64], values: &[f64]) {
    let n = gradient.len();
    for (k, (weight, value)) in prior.iter().zip(values).enumerate() {
        matrix[k * n + k] += weight;
        gradient[k] += weight * value;
    }
}
