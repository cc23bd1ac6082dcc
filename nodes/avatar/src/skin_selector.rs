//! SkinSelector: the Gaussians that will carry the pulse, and how their albedo reaches the picture.

use heartian_avatar::{Avatar, OperatorOptions, RenderOptions, SkinOptions, albedo_operator, render_clip, select_skin};
use heartian_face::Track;
use heartian_graph::{Context, Files, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_report::{contact_sheet, encode_png};
use heartian_space::{AlbedoOperator, Clip, Metrics, Progress, Skin};

params! {
    /// Selects the facial skin Gaussians: near the head mesh and facing front, without lips, eyes, brows and hair; and
    /// describes the frozen renderer to the pulse as a sparse linear map from their green albedo to pooled pixels.
    pub struct SkinSelector {
        /// Largest distance to the mesh in canonical space (the paper takes 0.006 to 0.02 by data set).
        threshold: f32 = SkinOptions::default().threshold_metres, unit("m"), range(0.0001, 0.1);
        /// Least forward component of the normal: 1 is straight ahead, 0 sideways.
        facing: f32 = SkinOptions::default().least_facing, range(-1.0, 1.0);
    }
}
register!(SkinSelector);

impl Node for SkinSelector {
    const KIND: &'static str = "SkinSelector";
    const REVISION: u32 = 2;
    const INPUTS: &'static [Port] = &[
        Port::one::<Avatar>("avatar", "The fitted avatar."),
        Port::one::<Track>("track", "The track it was fitted to."),
        Port::one::<Clip>("clip", "The recording it was fitted to."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one::<Skin>("skin", "The skin Gaussians."),
        Port::one::<AlbedoOperator>("operator", "From their green albedo to pooled pixels, for some training frames."),
        Port::one::<Files>("picture", "skin.png: the selection over the avatar."),
        Port::one::<Metrics>("metrics", "skin.gaussians and the share of the avatar."),
    ];

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (avatar, track) = (inputs.get::<Avatar>("avatar")?, inputs.get::<Track>("track")?);
        let clip = inputs.get::<Clip>("clip")?;
        let options =
            SkinOptions { threshold_metres: self.threshold, least_facing: self.facing, ..SkinOptions::default() };
        let skin = select_skin(&avatar, &track.baked_head(), &options)
            .map_err(|error| NodeError::from(error).parameter("threshold"))?;
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

/// Frames of the picture.
const COLUMNS: usize = 3;
/// Albedo logits of skin and of everything else: red on blue, as in the paper's figure.
const MARKS: [[f32; 3]; 2] = [[2.2, -2.9, -2.9], [-2.9, -1.7, 0.4]];

/// The avatar as it is, above the same with its skin Gaussians red and all others blue.
fn picture(avatar: &Avatar, track: &Track, skin: &Skin) -> Result<Vec<u8>, NodeError> {
    let mut marked = avatar.clone();
    let mut marks = vec![MARKS[1]; avatar.len()];
    for &index in &skin.gaussians {
        marks[index as usize] = MARKS[0];
    }
    marked.canonical.albedo_logits = marks.into_flattened();
    let chosen = (0..COLUMNS).map(|column| (2 * column + 1) * track.frames.len() / (2 * COLUMNS));
    let (frames, times_seconds) = chosen.map(|k| (track.frames[k].clone(), track.times_seconds[k])).unzip();
    let few = Track { frames, times_seconds, ..track.clone() };
    let render = |avatar, label| render_clip(avatar, &few, &RenderOptions { label, ..RenderOptions::default() });
    let (plain, marked) = (render(avatar, "avatar")?, render(&marked, "skin Gaussians (red) over the others (blue)")?);
    Ok(encode_png(&contact_sheet(&[&plain, &marked], COLUMNS)?)?)
}
