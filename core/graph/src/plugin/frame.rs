//! Messages between the host and the process that runs a library: length-prefixed frames over pipes.
//!
//! A frame is 16 bytes of prelude (magic, length of the head, length of the body), a JSON head and raw bytes. Reading is
//! bounded: memory grows with the bytes that arrive, never with the length that a frame claims.

use std::io::{self, Read, Write};

use serde::{Deserialize, Serialize};

/// First bytes of every frame, so that rubbish on the pipe is seen at once.
const MAGIC: [u8; 4] = *b"HtP1";
const PRELUDE: usize = 16;
/// Longer heads are refused.
const HEAD_LIMIT: u32 = 16 << 20;
/// At most this much is reserved before any byte of a body has arrived.
const RESERVE_LIMIT: u64 = 16 << 20;

/// What a frame says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum Message {
    /// Host: what are you? The library is loaded.
    Describe,
    /// Host: run a node. As many `Input` frames follow.
    Run { kind: String, params: String, seed: u64, threads: u32, inputs: usize },
    /// Host: one input; its bytes are the body.
    Input { port: String, artifact: String },
    /// Library: loaded, waiting.
    Ready,
    /// Library: the description; the document is the body.
    Description,
    /// Library: one output; its bytes are the body.
    Output { port: String, artifact: String },
    /// Library: how far it is. The value of the metric is in its bits, because JSON has no NaN.
    Progress { step: u64, total: u64, metric: Option<(String, u64)> },
    /// Library: one line to the user.
    Warning { text: String },
    /// Library: the node is done.
    Done,
    /// Library: it cannot be loaded, described or run.
    Failed(Trouble),
}

/// Why a library failed, in its own words or those of the process that runs it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Trouble {
    pub message: String,
    pub remedy: Option<String>,
    pub parameter: Option<String>,
    pub cancelled: bool,
}

impl Trouble {
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), ..Self::default() }
    }

    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = Some(remedy.into());
        self
    }
}

/// A message and the bytes that go with it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    pub message: Message,
    pub body: Vec<u8>,
}

/// Why no frame could be read.
#[derive(Debug)]
pub(crate) enum FrameError {
    /// The pipe is closed or broken.
    Closed,
    /// What came is no frame.
    Malformed(String),
}

impl From<io::Error> for FrameError {
    fn from(_: io::Error) -> Self {
        Self::Closed
    }
}

/// Writes one frame.
///
/// # Errors
/// When the other side is gone.
pub(crate) fn write(writer: &mut impl Write, message: &Message, body: &[u8]) -> io::Result<()> {
    let mut bytes = vec![0; PRELUDE];
    serde_json::to_writer(&mut bytes, message)?;
    let head = u32::try_from(bytes.len() - PRELUDE).ok().filter(|head| *head <= HEAD_LIMIT);
    let head = head.ok_or_else(|| io::Error::other("the head of a frame is too long"))?;
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[4..8].copy_from_slice(&head.to_le_bytes());
    bytes[8..16].copy_from_slice(&(body.len() as u64).to_le_bytes());
    writer.write_all(&bytes)?;
    writer.write_all(body)?;
    writer.flush()
}

/// Reads one frame whose body is no longer than `body_limit`.
///
/// # Errors
/// When the pipe ends, or holds something else.
pub(crate) fn read(reader: &mut impl Read, body_limit: u64) -> Result<Frame, FrameError> {
    let mut prelude = [0; PRELUDE];
    reader.read_exact(&mut prelude)?;
    let [m0, m1, m2, m3, h0, h1, h2, h3, rest @ ..] = prelude;
    if [m0, m1, m2, m3] != MAGIC {
        let start = String::from_utf8_lossy(&prelude).into_owned();
        return Err(FrameError::Malformed(format!("it starts with {start:?}")));
    }
    let (head, body) = (u32::from_le_bytes([h0, h1, h2, h3]), u64::from_le_bytes(rest));
    if head > HEAD_LIMIT {
        return Err(FrameError::Malformed(format!("its head claims {head} bytes")));
    }
    if body > body_limit {
        return Err(FrameError::Malformed(format!("its body claims {body} bytes; the limit is {body_limit}")));
    }
    let head = read_up_to(reader, head.into())?;
    let message = serde_json::from_slice(&head).map_err(|error| FrameError::Malformed(error.to_string()))?;
    Ok(Frame { message, body: read_up_to(reader, body)? })
}

/// Exactly `count` bytes.
fn read_up_to(reader: &mut impl Read, count: u64) -> Result<Vec<u8>, FrameError> {
    let mut bytes = Vec::with_capacity(count.min(RESERVE_LIMIT) as usize);
    reader.take(count).read_to_end(&mut bytes)?;
    if (bytes.len() as u64) < count { Err(FrameError::Closed) } else { Ok(bytes) }
}
