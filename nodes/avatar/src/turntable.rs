//! Turntable: the avatar's head turned from side to side under the light of its recording.

use heartian_avatar::{Avatar, TurntableOptions, turntable};
use heartian_graph::{Context, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_space::Clip;

params! {
    /// Renders the avatar on a turntable: frontal, to one side, through the front to the other and home, one smooth loop
    /// before a still camera under the light of the recording. Shows what a frontal clip hides: floaters, holes behind the
    /// ears, materials that only fit one view. Far sides that the recording never showed are guesses.
    pub struct Turntable {
        /// Farthest turn to either side.
        most_degrees: f64 = TurntableOptions::default().most_degrees, unit("°"), range(0.0, 180.0);
        /// Length of the loop.
        seconds: f64 = TurntableOptions::default().seconds, unit("s"), range(0.1, 100.0);
        /// Frame rate.
        frames_per_second: f64 = TurntableOptions::default().frames_per_second, unit("Hz"), range(1.0, 100.0);
        /// Side of the square picture; as large as the recording when left out.
        size: Option<usize> = None, unit("px"), range(16.0, 4096.0);
        /// The frame of the recording whose expression is shown; the most frontal and calmest one when left out.
        frame: Option<usize> = None;
    }
}
register!(Turntable);

impl Node for Turntable {
    const KIND: &'static str = "Turntable";
    const REVISION: u32 = 2;
    const INPUTS: &'static [Port] = &[Port::one::<Avatar>("avatar", "What to turn.")];
    const OUTPUTS: &'static [Port] = &[Port::one::<Clip>("clip", "The loop, labelled `turntable`.")];

    fn run(&self, inputs: &Inputs, _: &Context) -> Result<Outputs, NodeError> {
        let avatar = inputs.get::<Avatar>("avatar")?;
        let Self { most_degrees, seconds, frames_per_second, size, frame } = *self;
        let options = TurntableOptions { most_degrees, seconds, frames_per_second, size, frame };
        Ok(Outputs::new().put("clip", turntable(&avatar, None, &options)?))
    }
}
