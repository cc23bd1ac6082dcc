//! SkinSelector: the Gaussians that will carry the pulse, and how their albedo reaches the picture.

use std::path::Path;

use heartian_avatar::{
    Avatar, OperatorOptions, PerfusionMap, RenderOptions, SkinOptions, albedo_operator, blood, perfusion, render_clip,
    select_skin,
};
use heartian_face::Track;
use heartian_graph::{
    Context, Files, Inputs, Node, NodeError, Outputs, ParamError, Port, SourceFile, params, register,
};
use heartian_report::{contact_sheet, decode_png, encode_png};
use heartian_space::{AlbedoOperator, Clip, Metrics, Progress, Skin};
use serde::{Deserialize, Serialize};

/// Which channels pulse.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Blood {
    /// Green alone, as in the paper.
    Green,
    /// Red, green and blue in the proportions of haemoglobin under white light, by each Gaussian's own albedo.
    Haemoglobin,
}

params! {
    /// Selects the facial skin Gaussians: near the head mesh and facing front, without lips, eyes, brows and hair; and
    /// describes the frozen renderer to the pulse as a sparse linear map from their green albedo to pooled pixels.
    pub struct SkinSelector {
        /// Largest distance to the mesh in canonical space (the paper takes 0.006 to 0.02 by data set).
        threshold: f32 = SkinOptions::default().threshold_metres, unit("m"), range(0.0001, 0.1);
        /// Least forward component of the normal: 1 is straight ahead, 0 sideways.
        facing: f32 = SkinOptions::default().least_facing, range(-1.0, 1.0);
        /// Green alone, as in the paper, which decoders read best, or red, green and blue in the proportions of haemoglobin.
        blood: Blood = Blood::Green, choices(&["Green", "Haemoglobin"]);
        /// How strongly and when blood reaches each place: `even`, `facial` (forehead and cheeks strong, nose and chin
        /// weaker, later the farther from the jaw's arteries), or a PNG over the frontal face: red is strength (128 as
        /// everywhere), green is delay (255 the largest).
        perfusion: String = EVEN.to_owned();
        /// Largest difference in the arrival of the pulse over the face; `even` has none.
        delay_ms: f32 = 40.0, unit("ms"), range(0.0, 500.0);
    }
}
register!(SkinSelector);

/// The named perfusion maps.
const EVEN: &str = "even";
const FACIAL: &str = "facial";
const PERFUSION_REMEDY: &str = "give even, facial, or a PNG with strength in red and delay in green";

impl Node for SkinSelector {
    const KIND: &'static str = "SkinSelector";
    const REVISION: u32 = 4;
    const INPUTS: &'static [Port] = &[
        Port::one::<Avatar>("avatar", "The fitted avatar."),
        Port::one::<Track>("track", "The track it was fitted to."),
        Port::one::<Clip>("clip", "The recording it was fitted to."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Skin>("skin", "The skin Gaussians."),
        Port::one::<AlbedoOperator>("operator", "From their green albedo to pooled pixels, for some training frames."),
        Port::one::<Files>("picture", "skin.png: the selection over the avatar, and its perfusion if it is not even."),
        Port::one::<Metrics>("metrics", "skin.gaussians and the share of the avatar."),
    ];

    fn sources(&self) -> Vec<SourceFile> {
        let file = self.is_file().then(|| SourceFile::new("perfusion", &self.perfusion).remedy(PERFUSION_REMEDY));
        file.into_iter().collect()
    }

    fn validate(&self) -> Vec<ParamError> {
        let known = [EVEN, FACIAL].contains(&self.perfusion.as_str()) || self.is_file();
        let message = format!("`{}` is no perfusion map; {PERFUSION_REMEDY}", self.perfusion);
        (!known).then(|| ParamError::new("perfusion", message)).into_iter().collect()
    }

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (avatar, track) = (inputs.get::<Avatar>("avatar")?, inputs.get::<Track>("track")?);
        let clip = inputs.get::<Clip>("clip")?;
        let options =
            SkinOptions { threshold_metres: self.threshold, least_facing: self.facing, ..SkinOptions::default() };
        let mut skin = select_skin(&avatar, &track.baked_head(), &options)
            .map_err(|error| NodeError::from(error).parameter("threshold"))?;
        if self.blood == Blood::Haemoglobin {
            let ratio = |index: &u32| blood::red_blue(avatar.canonical.albedo(*index as usize));
            skin.red_blue = skin.gaussians.iter().map(ratio).collect();
        }
        self.perfuse(&mut skin)?;
        let watch = &mut |p: Progress| context.progress(p.step, p.total, p.metric);
        let operator = albedo_operator(&avatar, &skin, &clip, &OperatorOptions::default(), watch)?;
        let metrics = Metrics::new()
            .with("skin.gaussians", skin.gaussians.len() as f64)
            .with("skin.share_of_avatar", skin.gaussians.len() as f64 / avatar.len() as f64)
            .with("skin.operator_entries", operator.columns.len() as f64);
        let picture = Files::new().with("skin.png", picture(&avatar, &track, &skin)?)?;
        Ok(Outputs::new().put("skin", skin).put("operator", operator).put("picture", picture).put("metrics", metrics))
    }
}

impl SkinSelector {
    fn is_file(&self) -> bool {
        Path::new(&self.perfusion).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
    }

    fn perfuse(&self, skin: &mut Skin) -> Result<(), NodeError> {
        let at_fault = |error: NodeError| error.parameter("perfusion").remedy(PERFUSION_REMEDY);
        let image = if self.is_file() {
            let bytes = std::fs::read(&self.perfusion).map_err(|error| at_fault(error.into()))?;
            Some(decode_png(&bytes).map_err(|error| at_fault(error.into()))?)
        } else {
            None
        };
        let map = match &image {
            Some(image) => PerfusionMap::Picture(image),
            None if self.perfusion == FACIAL => PerfusionMap::Facial,
            None => PerfusionMap::Even,
        };
        let found = perfusion(map, &skin.positions, self.delay_ms / 1000.0);
        skin.perfusion = found.map_err(|error| at_fault(error.into()))?;
        Ok(())
    }
}

/// Frames of the picture.
const COLUMNS: usize = 3;
/// Albedo logits of skin and of everything else: red on blue, as in the paper's figure.
const MARKS: [[f32; 3]; 2] = [[2.2, -2.9, -2.9], [-2.9, -1.7, 0.4]];

/// The avatar as it is, above the same with its skin Gaussians red and all others blue; below, where they are not alike,
/// the strength and the delay of their pulse, from dark to bright.
fn picture(avatar: &Avatar, track: &Track, skin: &Skin) -> Result<Vec<u8>, NodeError> {
    let chosen = (0..COLUMNS).map(|column| (2 * column + 1) * track.frames.len() / (2 * COLUMNS));
    let (frames, times_seconds) = chosen.map(|k| (track.frames[k].clone(), track.times_seconds[k])).unzip();
    let few = Track { frames, times_seconds, ..track.clone() };
    let render = |avatar: &Avatar, label| render_clip(avatar, &few, &RenderOptions { label, ..Default::default() });
    let marked = |mark: &dyn Fn(usize) -> [f32; 3]| {
        let mut marked = avatar.clone();
        let mut marks = vec![MARKS[1]; avatar.len()];
        for (k, &index) in skin.gaussians.iter().enumerate() {
            marks[index as usize] = mark(k);
        }
        marked.canonical.albedo_logits = marks.into_flattened();
        marked
    };
    let mut clips =
        vec![render(avatar, "avatar")?, render(&marked(&|_| MARKS[0]), "skin Gaussians (red) over the others (blue)")?];
    let maps = [
        (&skin.perfusion.strength, "strength of the pulse, dark to bright"),
        (&skin.perfusion.delay_seconds, "delay of the pulse, dark to bright"),
    ];
    for (values, label) in maps.into_iter().filter(|(values, _)| !values.is_empty()) {
        let (low, high) = values.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        let shade = |k: usize| heat((values[k] - low) / (high - low).max(1e-9));
        clips.push(render(&marked(&shade), label)?);
    }
    let clips: Vec<&Clip> = clips.iter().collect();
    Ok(encode_png(&contact_sheet(&clips, COLUMNS)?)?)
}

/// Albedo logits from dark violet over orange to pale yellow, for a value in [0, 1].
fn heat(unit: f32) -> [f32; 3] {
    let albedo = [0.03 + 0.92 * unit.sqrt(), 0.02 + 0.85 * unit * unit, 0.10 + 0.12 * (1.0 - unit)];
    albedo.map(|value| (value / (1.0 - value)).ln())
}
