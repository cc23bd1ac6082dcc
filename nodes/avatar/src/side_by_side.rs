//! SideBySide: clips beside each other in one picture.

use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_space::Clip;

params! {
    /// Puts clips of the same length beside each other, left to right as they are wired, each over black: the recording,
    /// the avatar, the avatar with its pulse, relit.
    pub struct SideBySide {
    }
}
register!(SideBySide);

impl Node for SideBySide {
    const KIND: &'static str = "SideBySide";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[Port::many::<Clip>("clips", "Clips of one length, left to right.")];
    const OUTPUTS: &'static [Port] =
        &[Port::one::<Clip>("clip", "All of them, labelled `side_by_side`, at the times of the first.")];

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let clips = inputs.many::<Clip>("clips")?;
        let clips: Vec<&Clip> = clips.iter().map(AsRef::as_ref).collect();
        Ok(Outputs::new().put("clip", Clip::beside("side_by_side", &clips)?))
    }
}
