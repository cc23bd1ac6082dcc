//! RON graphs, typed ports, registry, planner, scheduler and content-addressed cache. Knows no face.
//!
//! A node is a struct whose fields are its parameters ([`params!`]), a [`Node`] impl that names its ports and calls one
//! function of a domain crate, and one [`register!`] line:
//!
//! ```
//! use heartian_graph::{Context, Files, Inputs, Node, NodeError, Outputs, Port, params, register};
//!
//! params! {
//!     /// Writes a greeting as a text file.
//!     pub struct Greeter {
//!         /// Who is greeted.
//!         name: String = "world".to_owned();
//!         /// How often.
//!         times: u32 = 1, range(1.0, 10.0);
//!     }
//! }
//! register!(Greeter);
//!
//! impl Node for Greeter {
//!     const KIND: &'static str = "Greeter";
//!     const REVISION: u32 = 1;
//!     const INPUTS: &'static [Port] = &[Port::many::<Files>("before", "Files to carry along.").optional()];
//!     const OUTPUTS: &'static [Port] = &[Port::one::<Files>("files", "The greeting, and what came before.")];
//!
//!     fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
//!         let mut files = Files::new();
//!         inputs.many::<Files>("before")?.iter().for_each(|before| files.extend(before));
//!         let greeting = format!("Hello {}! ", self.name).repeat(self.times as usize).into_bytes();
//!         Ok(Outputs::new().put("files", files.with("greeting.txt", greeting)?))
//!     }
//! }
//! ```

#[cfg(test)]
extern crate self as heartian_graph;

mod artifacts;
mod cache;
mod context;
mod diagnostic;
mod digest;
mod files;
mod graph;
mod insight;
mod key;
mod node;
mod params;
mod picture;
mod plan;
mod plugin;
mod registry;
mod scheduler;
mod schema;
mod syntax;

pub use artifacts::{AnyArtifact, Inputs, Outputs};
pub use cache::{Cache, CacheEntry, CacheError, GcOptions, GcReport, Output, Record, Usage, VerifyReport};
pub use context::{Cancel, Context, Event, Observer, Progress, Status};
pub use diagnostic::{Place, Problem, Problems, Source};
pub use digest::Digest;
pub use files::Files;
pub use graph::{Graph, GraphError};
pub use insight::{Cause, Change, Entry, Explainer, Explanation, PastNode, Standing, Subject};
pub use insight::{Forecast, History, Sweep, changes, subjects_of_plan, subjects_of_run};
pub use node::{Need, Node, NodeError, ParamError, Port, Resources, SourceFile};
pub use params::{ParamDoc, Params};
pub use picture::{Picture, Tint};
pub use plan::{Plan, PlanInput, PlanNode};
pub use plugin::{
    HostCommand, Plugin, PluginError, PluginLimits, PluginLock, Plugins, TrustedPlugin, plugin_files, serve_plugin,
};
pub use registry::{ErasedNode, NodeKind, Registry};
pub use scheduler::{AuditReport, NodeReport, Preview, Run, RunOptions, Verdict, load};
pub use schema::{kind_schema, schema};
pub use syntax::Span;

#[doc(hidden)]
pub use {inventory, serde};
