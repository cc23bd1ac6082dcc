//! Fits a head model to the landmarks of a clip: one person and camera, a pose and expression per frame.
//!
//! Stages: scaled-orthographic start on key frames → pose → identity, pose and expression jointly on the key frames →
//! a smooth personal offset of the rest shape → every frame, warm-started from the one before → the whole clip with
//! temporal terms → identity again, clip again → gaze. All by damped Gauss–Newton with exact Jacobians and a robust
//! loss, in f64. The result does not depend on the number of threads: chunks are fixed and sums ordered.

mod blink;
mod clip;
mod frame;
mod gaze;
mod linear;
mod measure;
mod personal;
mod points;
mod shared;
mod spread;
mod start;
#[cfg(test)]
mod tests;

use std::ops::ControlFlow;

use glam::{DQuat, DVec2, DVec3};
use heartian_space::{Camera, Progress};
use rayon::prelude::*;

use crate::FaceError;
use crate::model::HeadModel;
use crate::observations::Observations;
use crate::track::{FramePose, Track, TrackSigma};
use frame::{EXPRESSION, JAW, Lens, Seen, Setting, State};
use points::{Points, Shape};
use shared::{Joint, Person};

/// A frame with fewer known landmarks counts as one without a face.
const LEAST_LANDMARKS: usize = 12;
/// Frames fitted one after the other from a common start; chunks run in parallel.
const CHUNK: usize = 24;
/// Share of the distance between the eye corners that counts as one in the residuals, and its floor in pixels.
const SCALE: f64 = 0.01;
const LEAST_SCALE_PX: f64 = 0.35;
/// Weight of an identity coefficient's square for each key frame: what the landmarks get wrong, they get wrong alike in
/// every frame, so more frames must not outvote what is known of heads.
const IDENTITY_PRIOR: f64 = 0.6;
/// The same of the personal offset's coefficients.
const OFFSET_PRIOR: f64 = 0.15;
/// A frame whose landmarks lie this many times farther off than in the clip's median frame shows something else.
const MISFIT_MEDIANS: f64 = 4.0;
/// What is known of a focal length beforehand: the standard deviation of its logarithm.
const FOCAL_DEVIATION: f64 = 0.25;
/// Distance between the outer eye corners of an adult, metres; only to set the residuals' scale.
const EYE_CORNERS: f64 = 0.09;

/// How to track.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackOptions {
    /// Focal length, pixels; `None` takes 1.2 times the longer side.
    pub focal_px: Option<f64>,
    /// Whether to refine the focal length if the clip determines it, as where the head turns or comes nearer a good deal: if
    /// what it leaves open is less than half of what is known beforehand, a quarter of `focal_px`.
    pub refine_focal: bool,
    /// Key frames for the identity, at least 1.
    pub key_frames: usize,
    /// Whether to fit a smooth offset of the rest shape on top of the identity modes.
    pub personal_offset: bool,
    /// Strength of the temporal terms; 1 is ordinary, 0 leaves frames independent.
    pub smoothness: f64,
    /// How often identity and clip are fitted in turn after the first pass.
    pub rounds: usize,
    /// Whether to say how sure each frame is; without, the focal length is not refined either.
    pub sigma: bool,
}

impl Default for TrackOptions {
    fn default() -> Self {
        Self {
            focal_px: None,
            refine_focal: true,
            key_frames: 24,
            personal_offset: true,
            smoothness: 1.0,
            rounds: 1,
            sigma: true,
        }
    }
}

/// Fits `head` to `observations`.
///
/// # Errors
/// No frame shows a face, or none has enough landmarks the head knows; an observation or option out of range; the
/// landmarks are no face at all; or `progress` asked to stop.
pub fn track(
    head: &HeadModel,
    observations: &Observations,
    options: &TrackOptions,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Track, FaceError> {
    head.validate()?;
    observations.validate()?;
    let mut job = Job::new(head, observations, options)?;
    let chunks = observations.len().div_ceil(CHUNK) as u64;
    let mut meter = Meter { step: 0, total: 4 + chunks + 2 * options.rounds as u64, report: progress };
    meter.tick(None)?;
    let (mut person, mut key_states) = job.start()?;
    job.fit_person(&mut person, &mut key_states, (5, 3.0));
    job.fit_person(&mut person, &mut key_states, (8, 1.0));
    meter.tick(None)?;
    let mut offsets = None;
    if options.personal_offset {
        let found = personal::Offsets::new(&job.points.rest, 112);
        job.points = found.extended(&job.points);
        person.identity.resize(job.points.identity_count(), 0.0);
        job.fit_person(&mut person, &mut key_states, (5, 1.0));
        offsets = Some(found);
    }
    meter.tick(None)?;
    let mut states = job.each_frame(&person, &mut meter)?;
    job.drop_misfits(&person, &mut states);
    job.fit_clip(&person, &mut states, 6);
    meter.tick(Some(job.errors(&person, &states).rms_px))?;
    for _ in 0..options.rounds {
        let mut key_states = job.key_states(&states);
        job.fit_person(&mut person, &mut key_states, (3, 1.0));
        meter.tick(None)?;
        job.fit_clip(&person, &mut states, 4);
        meter.tick(Some(job.errors(&person, &states).rms_px))?;
    }
    let sigma = if options.sigma { job.settle_focal(&mut person, &mut states) } else { TrackSigma::default() };
    if let Some(frame) = states.iter().position(|state| !state.is_finite()) {
        return Err(FaceError::Diverged { stage: "whole clip", frame });
    }
    Ok(job.finished(&person, &states, (offsets.as_ref(), sigma)))
}

/// Counts steps for the caller.
struct Meter<'a> {
    step: u64,
    total: u64,
    report: &'a mut dyn FnMut(Progress) -> ControlFlow<()>,
}

impl Meter<'_> {
    fn tick(&mut self, rms_px: Option<f64>) -> Result<(), FaceError> {
        let metric = rms_px.map(|rms| ("landmark_rms_px", rms));
        let progress = Progress { step: self.step, total: self.total, metric };
        self.step += 1;
        match (self.report)(progress) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(FaceError::Cancelled),
        }
    }
}

/// Everything that stays while the stages run.
struct Job<'a> {
    head: &'a HeadModel,
    observations: &'a Observations,
    options: &'a TrackOptions,
    points: Points,
    modes: usize,
    frames: Vec<Seen>,
    keys: Vec<usize>,
    lens: Lens,
    scale_px: f64,
    prior: Vec<f64>,
    focal_prior: Option<f64>,
}

impl<'a> Job<'a> {
    fn new(head: &'a HeadModel, observations: &'a Observations, options: &'a TrackOptions) -> Result<Self, FaceError> {
        let (width, height) = (observations.width as f64, observations.height as f64);
        let focal = options.focal_px.unwrap_or(1.2 * width.max(height));
        let checks = [
            ("focal_px", focal, focal.is_finite() && focal > 0.0, "a positive number of pixels"),
            ("smoothness", options.smoothness, (0.0..=1e4).contains(&options.smoothness), "between 0 and 10000"),
            ("key_frames", options.key_frames as f64, options.key_frames >= 1, "at least 1"),
        ];
        for (name, value, fine, range) in checks {
            if !fine {
                return Err(FaceError::Option { name, value, range });
            }
        }
        let points = Points::new(head);
        let mut frames: Vec<Seen> = (0..observations.len()).map(|t| seen(&points, observations, t)).collect();
        let most = frames.iter().map(|seen| seen.points.len()).max().unwrap_or(0);
        if (0..observations.len()).all(|t| !observations.has_face(t)) {
            return Err(FaceError::NoFace { frames: observations.len() });
        }
        if most < LEAST_LANDMARKS {
            return Err(FaceError::TooFewLandmarks { name: head.name.clone(), found: most, needed: LEAST_LANDMARKS });
        }
        frames.iter_mut().filter(|seen| seen.points.len() < LEAST_LANDMARKS).for_each(|seen| *seen = Seen::default());
        let closures = blink::closures(&points, &frames, &observations.times_seconds);
        frames.iter_mut().zip(closures).for_each(|(seen, closure)| seen.closure = closure);
        let usable: Vec<usize> = (0..frames.len()).filter(|&t| !frames[t].points.is_empty()).collect();
        Ok(Self {
            head,
            observations,
            options,
            modes: points.identity_count(),
            prior: frame_prior(points.expression_count()),
            keys: start::key_frames(&frames, &usable, options.key_frames),
            points,
            frames,
            lens: Lens { focal, centre: DVec2::new(width / 2.0, height / 2.0) },
            scale_px: LEAST_SCALE_PX,
            focal_prior: None,
        })
    }

    /// Poses of the key frames with a neutral face of no one in particular, and the residuals' scale from them.
    fn start(&mut self) -> Result<(Person, Vec<State>), FaceError> {
        let person = Person { identity: vec![0.0; self.modes], lens: self.lens };
        let shape = self.points.shape(&person.identity);
        let mut starts = Vec::with_capacity(self.keys.len());
        for &key in &self.keys {
            let state = start::weak_perspective(&self.points, &shape, self.lens, &self.frames[key]);
            starts.push(state.ok_or(FaceError::Diverged { stage: "start", frame: key })?);
        }
        let mut depths: Vec<f64> = starts.iter().map(|state| -state.translation.z).collect();
        depths.sort_by(f64::total_cmp);
        let interocular = self.lens.focal * EYE_CORNERS / depths[depths.len() / 2];
        self.scale_px = (SCALE * interocular).max(LEAST_SCALE_PX);
        let states = starts
            .into_par_iter()
            .zip(&self.keys)
            .map(|(state, &key)| self.posed(&person, &shape, &self.frames[key], state))
            .collect();
        Ok((person, states))
    }

    /// Fits the pose alone, then everything, each with a wide scale.
    fn posed(&self, person: &Person, shape: &Shape, seen: &Seen, state: State) -> State {
        let mut rigid = vec![1e7; state.unknowns()];
        rigid[..JAW].fill(0.0);
        let scale_px = 4.0 * self.scale_px;
        let setting = Setting { points: &self.points, shape, lens: person.lens, scale_px, prior: &rigid };
        frame::fit(&setting, seen, state, 12).0
    }

    /// Identity and key frames jointly, with the residuals' scale widened by a factor.
    fn fit_person(&self, person: &mut Person, states: &mut Vec<State>, (iterations, widening): (usize, f64)) {
        self.joint(person, widening, self.focal_prior).fit(person, states, iterations);
    }

    fn joint(&self, person: &Person, widening: f64, focal_prior: Option<f64>) -> Joint<'_> {
        Joint {
            points: &self.points,
            frames: self.keys.iter().map(|&key| &self.frames[key]).collect(),
            scale_px: self.scale_px * widening,
            frame_prior: &self.prior,
            identity_prior: (0..person.identity.len())
                .map(|mode| self.keys.len() as f64 * if mode < self.modes { IDENTITY_PRIOR } else { OFFSET_PRIOR })
                .collect(),
            focal_prior,
            focal_centre: self.lens.focal,
        }
    }

    fn key_states(&self, states: &[State]) -> Vec<State> {
        self.keys.iter().map(|&frame| states[frame].clone()).collect()
    }

    fn setting<'b>(&'b self, person: &Person, shape: &'b Shape) -> Setting<'b> {
        Setting { points: &self.points, shape, lens: person.lens, scale_px: self.scale_px, prior: &self.prior }
    }

    /// Every frame on its own, warm-started within fixed chunks.
    fn each_frame(&self, person: &Person, meter: &mut Meter) -> Result<Vec<State>, FaceError> {
        let shape = self.points.shape(&person.identity);
        let ranges: Vec<usize> = (0..self.frames.len()).step_by(CHUNK).collect();
        let mut states = Vec::with_capacity(self.frames.len());
        for group in ranges.chunks(8) {
            let parts: Vec<Vec<State>> = group
                .par_iter()
                .map(|&from| self.chunk(person, &shape, from..(from + CHUNK).min(self.frames.len())))
                .collect();
            states.extend(parts.into_iter().flatten());
            for _ in group {
                meter.tick(None)?;
            }
        }
        clip::interpolate_missing(&mut states, &self.frames, &self.observations.times_seconds);
        Ok(states)
    }

    fn chunk(&self, person: &Person, shape: &Shape, range: std::ops::Range<usize>) -> Vec<State> {
        let setting = self.setting(person, shape);
        let mut before: Option<State> = None;
        range
            .map(|t| {
                let seen = &self.frames[t];
                if seen.points.is_empty() {
                    before = None;
                    return State::rest(self.points.expression_count());
                }
                let fresh = || {
                    let start = start::weak_perspective(&self.points, shape, person.lens, seen)
                        .unwrap_or_else(|| State::rest(self.points.expression_count()));
                    frame::fit(&setting, seen, self.posed(person, shape, seen, start), 15)
                };
                // A fit that explains its landmarks badly may be stuck: try again from scratch.
                let acceptable = 3.0 * seen.points.len() as f64;
                let found = match before.take() {
                    Some(state) => {
                        let warm = frame::fit(&setting, seen, state, 8);
                        if warm.1 < acceptable { warm } else { better(warm, fresh()) }
                    }
                    None => fresh(),
                };
                before = Some(found.0.clone());
                found.0
            })
            .collect()
    }

    /// Forgets the landmarks of frames that no pose of this head explains: a hand, another face, a profile that the network
    /// guessed at. They are marked as not fitted and interpolated like frames without a face.
    fn drop_misfits(&mut self, person: &Person, states: &mut [State]) {
        let shape = self.points.shape(&person.identity);
        let setting = self.setting(person, &shape);
        let errors: Vec<Option<f64>> =
            self.frames.iter().zip(&*states).map(|(seen, state)| measure::rms_px(&setting, seen, state)).collect();
        let mut known: Vec<f64> = errors.iter().flatten().copied().collect();
        known.sort_by(f64::total_cmp);
        let Some(median) = known.get(known.len() / 2) else { return };
        let limit = MISFIT_MEDIANS * median.max(self.scale_px);
        for (seen, _) in self.frames.iter_mut().zip(&errors).filter(|(_, error)| error.is_some_and(|e| e > limit)) {
            *seen = Seen::default();
        }
        clip::interpolate_missing(states, &self.frames, &self.observations.times_seconds);
    }

    fn whole<'b>(&'b self, person: &Person, shape: &'b Shape) -> clip::Whole<'b> {
        let unknowns = EXPRESSION + self.points.expression_count() + 2;
        let times = &self.observations.times_seconds;
        let link = |pair: &[f64]| clip::Link::new(unknowns, pair[1] - pair[0], self.options.smoothness);
        let links = times.windows(2).map(link).collect();
        clip::Whole { setting: self.setting(person, shape), frames: &self.frames, links, trust: 1.0 }
    }

    fn fit_clip(&self, person: &Person, states: &mut Vec<State>, iterations: usize) {
        self.whole(person, &self.points.shape(&person.identity)).fit(states, iterations);
    }

    fn errors(&self, person: &Person, states: &[State]) -> measure::Errors {
        let shape = self.points.shape(&person.identity);
        measure::errors(&self.setting(person, &shape), &self.frames, states)
    }

    /// Refines the focal length where the clip determines it: where what it leaves open is less than half of what was known
    /// beforehand. Returns how sure all is in the end.
    fn settle_focal(&mut self, person: &mut Person, states: &mut Vec<State>) -> TrackSigma {
        let (sigma, trust) = self.sigmas(person, states);
        let known = sigma.focal_percent.is_some_and(|percent| f64::from(percent) < 50.0 * FOCAL_DEVIATION);
        if !(self.options.refine_focal && known) {
            return sigma;
        }
        // In a fit a squared residual counts 1, not `trust`.
        self.focal_prior = Some(FOCAL_DEVIATION.powi(-2) / trust);
        let mut key_states = self.key_states(states);
        self.fit_person(person, &mut key_states, (12, 1.0));
        self.fit_clip(person, states, 6);
        self.sigmas(person, states).0
    }

    /// How sure all is, and how much a squared residual counts in that.
    fn sigmas(&self, person: &Person, states: &[State]) -> (TrackSigma, f64) {
        let openness = |trust: f64| {
            let joint = self.joint(person, 1.0, Some(FOCAL_DEVIATION.powi(-2)));
            joint.openness(person, &self.key_states(states), trust)
        };
        spread::sigmas(self.whole(person, &self.points.shape(&person.identity)), states, (self.keys.len(), &openness))
    }

    fn finished(
        &self,
        person: &Person,
        states: &[State],
        (offsets, sigma): (Option<&personal::Offsets>, TrackSigma),
    ) -> Track {
        let mut identity: Vec<f32> = person.identity[..self.modes].iter().map(|value| *value as f32).collect();
        let offset = offsets.map(|offsets| (offsets, &person.identity[self.modes..]));
        let head = personal::personalised(self.head, &identity, offset);
        identity.push(1.0);
        let errors = self.errors(person, states);
        let eyeballs = head.with_identity(&identity).eyeballs();
        let gaze = gaze::turns(&eyeballs, self.observations, (person.lens, self.scale_px), states);
        let frames = states
            .iter()
            .enumerate()
            .map(|(t, state)| frame_pose(state, gaze[t], !self.frames[t].points.is_empty()))
            .collect();
        Track {
            identity,
            camera: Camera::at_origin(self.observations.width, self.observations.height, person.lens.focal as f32),
            frames,
            times_seconds: self.observations.times_seconds.clone(),
            sigma,
            landmark_rms_px: errors.rms_px,
            interocular_px: errors.interocular_px,
            head,
        }
    }
}

fn better(a: (State, f64), b: (State, f64)) -> (State, f64) {
    if b.1 < a.1 { b } else { a }
}

/// The landmarks of a frame that the head knows and that count.
fn seen(points: &Points, observations: &Observations, frame: usize) -> Seen {
    let mut seen = Seen::default();
    for landmark in observations.frame(frame).filter(|landmark| landmark.weight > 0.0) {
        if let Ok(point) = points.indices.binary_search(&landmark.index) {
            seen.points.push(point);
            seen.pixels.push(landmark.position_px.map(f64::from).into());
            seen.weights.push(f64::from(landmark.weight));
        }
    }
    seen
}

/// Weights of the squares of jaw, expression and lids.
fn frame_prior(expressions: usize) -> Vec<f64> {
    let mut prior = vec![0.0; JAW];
    prior.extend([1.0 / 0.3_f64.powi(2), 1.0 / 0.03_f64.powi(2), 1.0 / 0.02_f64.powi(2)]);
    prior.extend(vec![1.5; expressions]);
    prior.extend([0.3; 2]);
    prior
}

fn frame_pose(state: &State, eyes: [DVec3; 2], fitted: bool) -> FramePose {
    let vector = |v: DVec3| v.as_vec3().to_array();
    FramePose {
        rotation: vector(DQuat::from_mat3(&state.rotation).normalize().to_scaled_axis()),
        translation: vector(state.translation),
        neck: [0.0; 3],
        jaw: vector(state.jaw),
        eyes: eyes.map(vector),
        expression: state.expression.iter().map(|value| *value as f32).collect(),
        eyelids: state.eyelids.map(|value| value as f32),
        fitted,
    }
}
