//! AvatarExporter: the avatar as files that other programs open.

use heartian_artifact::Artifact;
use heartian_avatar::{Avatar, BakedPose, bake};
use heartian_graph::{Context, Files, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_splat::ply_bytes;

params! {
    /// Writes the avatar as files: avatar.ply, one pose with its light baked in, in the standard form of 3D Gaussian
    /// splatting that the common viewers open (binary, SH degree 0, x right, y down); and avatar.safetensors, all of it:
    /// Gaussians with materials, motion, light, poses.
    pub struct AvatarExporter {
        /// The frame of the recording whose pose avatar.ply shows; the head at rest when left out.
        frame: Option<usize> = None;
    }
}
register!(AvatarExporter);

impl Node for AvatarExporter {
    const KIND: &'static str = "AvatarExporter";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[Port::one::<Avatar>("avatar", "What to export.")];
    const OUTPUTS: &'static [Port] = &[Port::one::<Files>("files", "avatar.ply and avatar.safetensors.")];

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let avatar = inputs.get::<Avatar>("avatar")?;
        let pose = self.frame.map_or(BakedPose::Neutral, BakedPose::Frame);
        let ply = ply_bytes(&bake(&avatar, pose, None)?);
        let files =
            Files::new().with("avatar.ply", ply)?.with("avatar.safetensors", avatar.to_bundle()?.to_bytes()?)?;
        Ok(Outputs::new().put("files", files))
    }
}
