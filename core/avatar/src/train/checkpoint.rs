//! A fit's state between two steps, as bytes: everything that the steps change, so that a fit resumed from it gives the
//! very bytes of one that was never stopped.
//!
//! What the inputs alone decide (motion model, tracked poses, schedule) is made again and not kept. A state that does not
//! fit the inputs is refused as a whole.

use heartian_artifact::{ArtifactError, Bundle, BundleReader};
use heartian_splat::{Adam, Environment};

use super::Fit;
use super::appearance::Appearance;
use super::schedule::FrameOrder;
use crate::canonical::{Canonical, GROUPS};
use crate::coherent::Neighbours;
use crate::density::Statistics;
use crate::ground::Ground;
use crate::optimiser::{Optimiser, options};

/// Forgetting of the live figure.
const LIVE: f64 = 0.98;

/// Where the loop over the steps is.
#[derive(Clone, Debug)]
pub(super) struct Course {
    /// The next step.
    pub step: u32,
    pub order: FrameOrder,
    /// Forgetting sum of squared errors, and of its weights.
    pub live: [f64; 2],
    /// (step, live training PSNR in decibels).
    pub history: Vec<(u32, f64)>,
}

impl Course {
    /// Takes the mean squared error of a step; every `every` steps becomes a point of the history.
    pub fn note(&mut self, step: u32, squared_error: f64, every: u32) {
        self.live = [LIVE * self.live[0] + (1.0 - LIVE) * squared_error, LIVE * self.live[1] + (1.0 - LIVE)];
        if (step + 1).is_multiple_of(every) {
            self.history.push((step + 1, self.psnr_db().unwrap_or_default()));
        }
    }

    /// The live figure; nothing before the first step was noted.
    pub fn psnr_db(&self) -> Option<f64> {
        (self.live[1] > 0.0).then(|| -10.0 * (self.live[0] / self.live[1]).max(1e-12).log10())
    }
}

/// The state.
pub(super) fn save(fit: &Fit<'_>, course: &Course) -> Result<Vec<u8>, ArtifactError> {
    let steps: Vec<u32> = fit.optimiser.groups().iter().map(Adam::steps).collect();
    let frames: Vec<u32> = course.order.frames().iter().map(|frame| *frame as u32).collect();
    let history: Vec<f64> = course.history.iter().flat_map(|(step, psnr)| [f64::from(*step), *psnr]).collect();
    let light = fit.appearance.state();
    let (offsets, visits) = fit.refiner.state_rows();
    let names: [[String; 3]; GROUPS] =
        std::array::from_fn(|group| ["values", "first", "second"].map(|part| format!("{part}.{group}")));
    let mut bundle = Bundle::new();
    let rests: [String; GROUPS] = std::array::from_fn(|group| format!("rest.{group}"));
    for (name, values) in rests.iter().zip(fit.ground.rest.groups()) {
        bundle = bundle.tensor(name, &[values.len()], values)?;
    }
    for ((names, values), adam) in names.iter().zip(fit.canonical.groups()).zip(fit.optimiser.groups()) {
        for (name, part) in names.iter().zip([values.as_slice(), adam.moments()[0], adam.moments()[1]]) {
            bundle = bundle.tensor(name, &[part.len()], part)?;
        }
    }
    if let Some((environment, adam)) = &light {
        let [first, second] = adam.moments();
        bundle = bundle
            .tensor("light", &[environment.radiance.len(), 3], environment.radiance.as_flattened())?
            .tensor("light.first", &[first.len()], first)?
            .tensor("light.second", &[second.len()], second)?
            .meta("light.steps", &adam.steps())?;
    }
    let statistics = &fit.statistics;
    bundle
        .tensor("steps", &[GROUPS], &steps)?
        .tensor("offsets", &[3, offsets.len() / 3], &offsets)?
        .tensor("visits", &[visits.len()], visits)?
        .tensor("statistics.gradients", &[statistics.gradient_sum.len()], &statistics.gradient_sum)?
        .tensor("statistics.frames", &[statistics.frames.len()], &statistics.frames)?
        .tensor("statistics.pixels", &[statistics.most_pixels.len()], &statistics.most_pixels)?
        .tensor("doubt", &[fit.ground.doubt.len()], &fit.ground.doubt)?
        .tensor("kind", &[fit.ground.kind.len()], &fit.ground.kind)?
        .tensor("neighbours", &[fit.neighbours.rows().len()], fit.neighbours.rows())?
        .tensor("order", &[frames.len()], &frames)?
        .tensor("live", &[2], &course.live)?
        .tensor("history", &[course.history.len(), 2], &history)?
        .meta("order.next", &course.order.next())?
        .meta("order.state", &course.order.state())?
        .meta("step", &course.step)?
        .to_bytes()
}

/// Brings a fit of the same inputs to a state; nothing, and an untouched fit, when the state is not one of theirs.
pub(super) fn restore(fit: &mut Fit<'_>, bytes: &[u8]) -> Option<Course> {
    let reader = BundleReader::new(bytes).ok()?;
    let flat = |name: &str| reader.shaped::<f32>(name, &[None]).ok();
    let mut canonical = Canonical { modes: fit.canonical.modes, ..Canonical::default() };
    let steps = reader.shaped::<u32>("steps", &[Some(GROUPS)]).ok()?;
    let mut adams = Vec::with_capacity(GROUPS);
    for (group, values) in canonical.groups_mut().into_iter().enumerate() {
        *values = flat(&format!("values.{group}"))?;
        let moments = [flat(&format!("first.{group}"))?, flat(&format!("second.{group}"))?];
        adams.push(Adam::from_parts(options(), moments, steps[group]).filter(|adam| adam.len() == values.len())?);
    }
    let count = canonical.len();
    let statistics = Statistics {
        gradient_sum: flat("statistics.gradients")?,
        frames: reader.shaped("statistics.frames", &[Some(count)]).ok()?,
        most_pixels: flat("statistics.pixels")?,
    };
    let appearance = match reader.shaped::<f32>("light", &[None, Some(3)]) {
        Err(_) => Appearance::unshaded(),
        Ok(radiance) => {
            let environment = Environment { radiance: radiance.as_chunks::<3>().0.to_vec() };
            let moments = [flat("light.first")?, flat("light.second")?];
            Appearance::from_state(environment, moments, reader.meta("light.steps").ok()?)?
        }
    };
    let frames: Vec<usize> = reader.shaped::<u32>("order", &[None]).ok()?.into_iter().map(|f| f as usize).collect();
    let order = FrameOrder::from_state(frames, reader.meta("order.next").ok()?, reader.meta("order.state").ok()?);
    let history = reader.shaped::<f64>("history", &[None, Some(2)]).ok()?;
    let course = Course {
        step: reader.meta("step").ok()?,
        order: order.filter(|order| order.is_over(fit.training))?,
        live: reader.shaped::<f64>("live", &[Some(2)]).ok()?.try_into().ok()?,
        history: history.as_chunks::<2>().0.iter().map(|[step, psnr]| (*step as u32, *psnr)).collect(),
    };
    let offsets = reader.shaped::<f64>("offsets", &[Some(3), None]).ok()?;
    let neighbours = Neighbours::from_rows(&reader.shaped::<u32>("neighbours", &[None]).ok()?, count)?;
    let mut rest = Canonical { modes: canonical.modes, ..Canonical::default() };
    for (group, values) in rest.groups_mut().into_iter().enumerate() {
        *values = flat(&format!("rest.{group}"))?;
    }
    let sound = rest.is_consistent() && rest.len() == count && rest.first_not_finite().is_none();
    let doubt: Vec<f32> = reader.shaped("doubt", &[Some(count)]).ok()?;
    let kind: Vec<u8> = reader.shaped("kind", &[Some(count)]).ok()?;
    let ground = Ground { rest, doubt, kind };
    if !sound || !ground.doubt.iter().all(|doubt| (0.0..=1.0).contains(doubt)) {
        return None;
    }
    let visits = reader.shaped::<i32>("visits", &[None]).ok()?;
    let finite = is_finite(&canonical, &adams, &appearance) && offsets.iter().all(|value| value.is_finite());
    let fits = finite
        && canonical.is_consistent()
        && count > 0
        && [statistics.gradient_sum.len(), statistics.most_pixels.len()] == [count; 2];
    if !fits || !fit.refiner.restore(&offsets, &visits) {
        return None;
    }
    fit.optimiser = Optimiser::from_groups(adams.try_into().ok()?);
    (fit.neighbours, fit.ground) = (neighbours, ground);
    fit.gradient = Canonical::zeros(count, canonical.modes);
    (fit.canonical, fit.statistics, fit.appearance) = (canonical, statistics, appearance);
    Some(course)
}

/// Whether parameters, moments and light are all finite: a fit never makes others, a damaged file might.
fn is_finite(canonical: &Canonical, adams: &[Adam], appearance: &Appearance) -> bool {
    let light = appearance.state();
    let moments = adams.iter().chain(light.map(|(_, adam)| adam)).flat_map(Adam::moments).flatten();
    let radiance = light.into_iter().flat_map(|(environment, _)| environment.radiance.iter().flatten());
    canonical.first_not_finite().is_none() && moments.chain(radiance).all(|value| value.is_finite())
}
