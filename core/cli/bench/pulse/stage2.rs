//! Stage 2 timed on the default recording, through the linear map and by rasterising at every step.
//!
//! The paper's stage renders one frame an iteration. Here the same iterations are fitted through the linear map, in full
//! and three times; a rasterised iteration (deform, rasterise, shade, compare, pull back) is timed on the same avatar and
//! frames, some dozens of times, and multiplied by the number of iterations. `speed.rs` fits both ways to the end.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use heartian_artifact::Artifact;
use heartian_avatar::{Avatar, FrozenRender};
use heartian_face::Track;
use heartian_graph::{Graph, NodeReport, Plan, load};
use heartian_pulse::reference::{WeakPhase, weak_phase};
use heartian_pulse::{PhaseOptions, Pulse, PulseError, Reference, ResidualOptions, Scene, fit_phase, fit_residual};
use heartian_signal::methods::PosWindow;
use heartian_signal::trace::{Weighting, mean_rgb};
use heartian_space::{AlbedoOperator, Clip, Modulation, Progress, Series, Skin};
use miette::{IntoDiagnostic, Result, miette};
use serde_json::{Map, Value, json};

use super::cohort::execute;
use crate::plugins;
use crate::session::Session;

/// The default recording and its avatar.
const FULL: &str = include_str!("../../../../graphs/full.ron");
/// Rasterised iterations timed.
const TIMED_STEPS: usize = 40;
/// Repetitions of the fit; the least counts.
const REPEATS: usize = 3;

/// What stage 2 works on.
pub struct Subject {
    pub clip: Arc<Clip>,
    pub track: Arc<Track>,
    pub avatar: Arc<Avatar>,
    pub skin: Arc<Skin>,
    pub operator: Arc<AlbedoOperator>,
    pub reference: Reference,
    pub weak: Option<WeakPhase>,
}

impl Subject {
    /// From the cache, after the plan of `reports` ran as far as the skin.
    pub fn fetch(session: &Session, plan: &Plan) -> Result<Self> {
        let reports = execute(session, plan)?;
        let clip: Arc<Clip> = artifact(session, &reports, "frames", "clip")?;
        let ppg: Arc<Series> = artifact(session, &reports, "frames", "ppg")?;
        let reference = Reference::from_ppg(&ppg, &clip.times_seconds).into_diagnostic()?;
        let colors = mean_rgb(&clip, Weighting::Alpha).into_diagnostic()?;
        Ok(Self {
            weak: weak_phase(&colors, &reference, PosWindow::Global).into_diagnostic()?,
            track: artifact(session, &reports, "track", "track")?,
            avatar: artifact(session, &reports, "avatar", "avatar")?,
            skin: artifact(session, &reports, "skin", "skin")?,
            operator: artifact(session, &reports, "skin", "operator")?,
            reference,
            clip,
        })
    }

    /// What the phase fit sees.
    pub fn scene(&self) -> Scene<'_> {
        let albedo = &self.skin.green_albedo;
        let mean_green_albedo = albedo.iter().map(|&green| f64::from(green)).sum::<f64>() / albedo.len() as f64;
        Scene { weak_phase: self.weak.as_ref(), renderer: Some(&*self.operator), mean_green_albedo }
    }

    /// Stage 2 whole.
    pub fn fit(
        &self,
        scene: &Scene<'_>,
        phase: &PhaseOptions,
        residual: Option<&ResidualOptions>,
    ) -> Result<(Pulse, Modulation), PulseError> {
        let onwards = &mut |_: Progress| ControlFlow::Continue(());
        let (pulse, _) = fit_phase(&self.reference, scene, phase, onwards)?;
        match residual {
            Some(options) => fit_residual(&pulse, &self.skin, scene.renderer, options, onwards),
            None => {
                let (modulation, _) = heartian_pulse::modulation_from_fundamental(&pulse, &self.skin)?;
                Ok((pulse, modulation))
            }
        }
    }
}

fn artifact<T: Artifact>(session: &Session, reports: &[NodeReport], id: &str, port: &str) -> Result<Arc<T>> {
    let digest = reports.iter().find(|report| &*report.id == id).and_then(|report| report.outputs.get(port));
    let found = digest.map(|digest| load::<T>(&session.cache, digest)).transpose()?.flatten();
    found.ok_or_else(|| miette!(help = "run it again", "the cache does not hold `{id}.{port}`"))
}

/// Times of stage 2 on the default recording.
pub struct Timed {
    pub seconds: Vec<f64>,
    pub step_seconds: Vec<f64>,
    pub iterations: u64,
}

/// Fits through the linear map, and times rasterised iterations.
pub fn measure(session: &Session) -> Result<Timed> {
    eprintln!("  stage 2 on the default recording");
    let subject = Subject::fetch(session, &default_plan()?)?;
    let (phase, residual) = (PhaseOptions::paper(), ResidualOptions::default());
    let mut seconds = Vec::new();
    for _ in 0..REPEATS {
        let start = Instant::now();
        subject.fit(&subject.scene(), &phase, Some(&residual)).into_diagnostic()?;
        seconds.push(start.elapsed().as_secs_f64());
    }
    let frozen = FrozenRender::new(&subject.avatar, &subject.skin, &subject.clip).into_diagnostic()?;
    let count = subject.skin.gaussians.len();
    let mut step_seconds = Vec::new();
    for step in 0..TIMED_STEPS {
        let frame = step * subject.avatar.training_frames.max(1) / TIMED_STEPS;
        let start = Instant::now();
        frozen.loss(frame, &vec![0.001; count], &mut vec![0.0; count]).into_diagnostic()?;
        step_seconds.push(start.elapsed().as_secs_f64());
    }
    let iterations = u64::from(phase.steps_for(subject.reference.len())) + u64::from(residual.steps);
    Ok(Timed { seconds, step_seconds, iterations })
}

fn default_plan() -> Result<Plan> {
    let graph = Graph::parse("full.ron", FULL)?;
    Ok(graph.plan(plugins::registry()?, &["skin".to_owned()])?)
}

fn least_and_median(values: &[f64]) -> (f64, f64) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    (sorted.first().copied().unwrap_or(f64::NAN), sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN))
}

impl Timed {
    fn rasterised_seconds(&self) -> f64 {
        least_and_median(&self.step_seconds).0 * self.iterations as f64 + least_and_median(&self.seconds).0
    }

    pub fn text(&self) -> String {
        let ((least, median), step) = (least_and_median(&self.seconds), least_and_median(&self.step_seconds));
        let rasterised = self.rasterised_seconds();
        format!(
            "stage 2 on the default recording, {} iterations\n  through the linear map   {least:.2} s (median {median:.2}, {} runs)\n  \
             rasterising each step    {rasterised:.0} s = iterations × {:.2} ms (median {:.2}, {} steps timed) + the rest of the step\n  \
             {:.0} times less\n\n",
            self.iterations,
            self.seconds.len(),
            1e3 * step.0,
            1e3 * step.1,
            self.step_seconds.len(),
            rasterised / least,
        )
    }

    pub fn json(&self) -> Map<String, Value> {
        let least = least_and_median(&self.seconds).0;
        [
            ("stage2.seconds", least),
            ("stage2.rasterised_step_seconds", least_and_median(&self.step_seconds).0),
            ("stage2.iterations", self.iterations as f64),
            ("stage2.speedup_vs_rasterised", self.rasterised_seconds() / least),
        ]
        .into_iter()
        .map(|(key, value)| (key.to_owned(), json!(value)))
        .collect()
    }
}
