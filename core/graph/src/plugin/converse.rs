//! The host's side of the conversation, over any pipe: what is asked, and which answers make sense.
//!
//! Always holds: what the library may send is bounded in number and size, and an answer that makes no sense ends the
//! conversation. Nothing here waits for ever if the pipe does not.

use std::borrow::Cow;
use std::io::{Read, Write};

use super::frame::{FrameError, Message, Trouble, read, write};
use super::native::{DESCRIPTION_LIMIT, Events, Job};

/// A node that warns more often is no longer heard.
const WARNING_LIMIT: usize = 1000;

/// Why a conversation ended without an answer.
#[derive(Debug)]
pub(crate) enum Broken {
    /// The process is gone.
    Gone,
    /// It answers rubbish.
    Rubbish(String),
}

impl From<FrameError> for Broken {
    fn from(error: FrameError) -> Self {
        match error {
            FrameError::Closed => Self::Gone,
            FrameError::Malformed(what) => Self::Rubbish(what),
        }
    }
}

impl From<std::io::Error> for Broken {
    fn from(_: std::io::Error) -> Self {
        Self::Gone
    }
}

fn nonsense<T>(message: &Message) -> Result<T, Broken> {
    let mut shown = format!("{message:?}");
    shown.truncate(shown.char_indices().nth(80).map_or(shown.len(), |(end, _)| end));
    Err(Broken::Rubbish(format!("it answers {shown}")))
}

/// Waits until the library is loaded.
pub(crate) fn greet(reader: &mut impl Read) -> Result<Result<(), Trouble>, Broken> {
    match read(reader, 0)?.message {
        Message::Ready => Ok(Ok(())),
        Message::Failed(trouble) => Ok(Err(trouble)),
        other => nonsense(&other),
    }
}

/// Asks for the description.
pub(crate) fn describe(reader: &mut impl Read, writer: &mut impl Write) -> Result<Result<Vec<u8>, Trouble>, Broken> {
    write(writer, &Message::Describe, &[])?;
    let frame = read(reader, DESCRIPTION_LIMIT as u64)?;
    match frame.message {
        Message::Description => Ok(Ok(frame.body)),
        Message::Failed(trouble) => Ok(Err(trouble)),
        other => nonsense(&other),
    }
}

/// Has a node run. `output_limit`: bytes that all its outputs may have together.
pub(crate) fn run(
    reader: &mut impl Read,
    writer: &mut impl Write,
    job: &Job<'_>,
    (output_limit, events): (u64, &mut dyn Events),
) -> Result<Result<(), Trouble>, Broken> {
    let request = Message::Run {
        kind: job.kind.to_owned(),
        params: job.params.to_owned(),
        seed: job.seed,
        threads: job.threads,
        inputs: job.inputs.len(),
    };
    write(writer, &request, &[])?;
    for input in &job.inputs {
        let message = Message::Input { port: input.port.to_string(), artifact: input.artifact.to_string() };
        write(writer, &message, &input.bytes)?;
    }
    let (mut left, mut warnings) = (output_limit, 0);
    loop {
        let frame = read(reader, left)?;
        left -= frame.body.len() as u64;
        match frame.message {
            // Nodes write few outputs; an empty one counts too, so that their number is bounded.
            Message::Output { port, artifact } => {
                left = left.checked_sub(64).ok_or_else(|| Broken::Rubbish("it writes too many outputs".to_owned()))?;
                if !events.output(&port, &artifact, Cow::Owned(frame.body)) {
                    return Err(Broken::Rubbish(format!("its output `{port}` is refused")));
                }
            }
            Message::Progress { step, total, metric } => {
                let metric = metric.as_ref().map(|(name, bits)| (name.as_str(), f64::from_bits(*bits)));
                events.progress(step, total, metric);
            }
            Message::Warning { text } => {
                warnings += 1;
                if warnings <= WARNING_LIMIT {
                    events.warning(&text);
                }
            }
            Message::Done => return Ok(Ok(())),
            Message::Failed(trouble) => return Ok(Err(trouble)),
            other => return nonsense(&other),
        }
    }
}
