//! A node of your own in a program of your own: one file, one registration line, and graphs can use it beside the
//! built-in ones, with its manual, its checks and the cache.
//!
//!     cargo run --release --example custom_node

use std::error::Error;

use heartian_graph::{
    Cache, Context, Graph, Inputs, Node, NodeError, Outputs, Port, Registry, Run, RunOptions, load, params, register,
};
use heartian_nodes_capture as _;
use heartian_space::{Clip, Metrics};

params! {
    /// Counts the pixels of a clip's matte.
    pub struct MatteArea {
        /// Alpha from which a pixel counts.
        least_alpha: u8 = 128;
    }
}
register!(MatteArea);

impl Node for MatteArea {
    const KIND: &'static str = "MatteArea";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[Port::one::<Clip>("clip", "The clip to look at.")];
    const OUTPUTS: &'static [Port] = &[Port::one::<Metrics>("metrics", "matte.share: covered pixels, 0 to 1.")];

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let clip = inputs.get::<Clip>("clip")?;
        let covered = clip.alpha.iter().filter(|&&alpha| alpha >= self.least_alpha).count();
        let share = covered as f64 / clip.alpha.len() as f64;
        Ok(Outputs::new().put("metrics", Metrics::new().with("matte.share", share)))
    }
}

const GRAPH: &str = r#"Graph(
    name: "matte",
    doc: "How much of the picture the head fills.",
    nodes: {
        "frames": (kind: "FrameLoader", params: (seconds: 1.0, size: 64)),
        "area": (kind: "MatteArea", inputs: {"clip": "frames.clip"}),
    },
)"#;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let cache = Cache::open(folder.path())?;
    let plan = Graph::parse("matte.ron", GRAPH)?.plan(&Registry::compiled_in(), &[])?;
    for turn in ["first", "second"] {
        for report in Run::prepare(&plan, &cache).execute(&RunOptions::default()) {
            println!("{turn} run: {:<7} {:<4} {:.3} s", report.id, report.status.word(), report.seconds);
            if let Some(digest) = report.outputs.get("metrics") {
                let metrics = load::<Metrics>(&cache, digest)?.ok_or("the cache lost what it just stored")?;
                println!("  matte.share = {:.3}", metrics.get("matte.share").unwrap_or(f64::NAN));
            }
            if let Some(error) = report.error {
                return Err(error.message.into());
            }
        }
    }
    Ok(())
}
