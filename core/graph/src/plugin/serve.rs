//! The child's side: a process that loads one library, describes it and runs its nodes until the pipe closes.
//!
//! What the library prints goes to standard error, what it reads is empty: the pipes to the host are moved out of its way
//! first. Memory is bounded by the system, and the process ends when its host does, whatever the library is doing.

use std::borrow::Cow;
use std::io::{Read, Write};
use std::path::Path;
use std::process::ExitCode;

use crate::digest::Digest;

use super::frame::{FrameError, Message, Trouble, read, write};
use super::load_verified;
use super::native::{Events, Job, JobInput, Native};

/// Serves the library `path` on standard input and output. `digest`: what the file must hold. `memory_bytes`: how much
/// address space the process may use; 0: any.
///
/// For the hidden command of a program that hosts plugins, and nothing else: it takes over the process.
pub fn serve_plugin(path: &Path, digest: &Digest, memory_bytes: u64) -> ExitCode {
    let pipes = system::pipes().map_err(|error| eprintln!("no pipes to the host: {error}"));
    let Ok((mut reader, mut writer)) = pipes else { return ExitCode::FAILURE };
    system::end_with_host();
    let native = system::bound_memory(memory_bytes).and_then(|()| load_verified(path, digest));
    let served = match native {
        // Nobody listens any more: nothing to tell.
        Ok(native) => serve(&mut reader, &mut writer, &native),
        Err(trouble) => write(&mut writer, &Message::Failed(trouble), &[]).map_err(Into::into),
    };
    ExitCode::from(u8::from(served.is_err()))
}

/// What a served library can do; the real one, or a stand-in for tests.
pub(crate) trait Served {
    /// See [`Native::describe`].
    fn describe(&self) -> Result<Vec<u8>, Trouble>;
    /// See [`Native::run`].
    fn run(&self, job: &Job<'_>, events: &mut dyn Events) -> Result<(), Trouble>;
}

impl Served for Native {
    fn describe(&self) -> Result<Vec<u8>, Trouble> {
        Native::describe(self)
    }
    fn run(&self, job: &Job<'_>, events: &mut dyn Events) -> Result<(), Trouble> {
        Native::run(self, job, events)
    }
}

/// Answers until the host closes the pipe. Requests are the host's own, so their length is not bounded here.
pub(crate) fn serve(
    reader: &mut impl Read,
    writer: &mut (impl Write + Send),
    library: &impl Served,
) -> Result<(), FrameError> {
    write(writer, &Message::Ready, &[])?;
    loop {
        let frame = match read(reader, u64::MAX) {
            Ok(frame) => frame,
            Err(FrameError::Closed) => return Ok(()),
            Err(error) => return Err(error),
        };
        let (message, body) = match frame.message {
            Message::Describe => match library.describe() {
                Ok(document) => (Message::Description, document),
                Err(trouble) => (Message::Failed(trouble), Vec::new()),
            },
            Message::Run { kind, params, seed, threads, inputs } => {
                let inputs = (0..inputs).map(|_| input(reader)).collect::<Result<_, _>>()?;
                let job = Job { kind: &kind, params: &params, seed, threads, inputs };
                match library.run(&job, &mut Relay(&mut *writer)) {
                    Ok(()) => (Message::Done, Vec::new()),
                    Err(trouble) => (Message::Failed(trouble), Vec::new()),
                }
            }
            other => return Err(FrameError::Malformed(format!("{other:?} is no request"))),
        };
        write(writer, &message, &body)?;
    }
}

fn input(reader: &mut impl Read) -> Result<JobInput<'static>, FrameError> {
    let frame = read(reader, u64::MAX)?;
    let Message::Input { port, artifact } = frame.message else {
        return Err(FrameError::Malformed(format!("{:?} where an input should be", frame.message)));
    };
    Ok(JobInput { port: port.into(), artifact: artifact.into(), bytes: frame.body.into() })
}

/// Passes on what a node says. A host that is gone is noticed when the next request is read.
struct Relay<'a, W>(&'a mut W);

impl<W: Write + Send> Events for Relay<'_, W> {
    fn output(&mut self, port: &str, artifact: &str, bytes: Cow<'_, [u8]>) -> bool {
        let message = Message::Output { port: port.to_owned(), artifact: artifact.to_owned() };
        write(self.0, &message, &bytes).is_ok()
    }
    fn progress(&mut self, step: u64, total: u64, metric: Option<(&str, f64)>) -> bool {
        let metric = metric.map(|(name, value)| (name.to_owned(), value.to_bits()));
        write(self.0, &Message::Progress { step, total, metric }, &[]).is_ok()
    }
    fn warning(&mut self, text: &str) {
        // A warning that nobody hears is not worth failing for.
        let _ = write(self.0, &Message::Warning { text: text.to_owned() }, &[]);
    }
}

#[cfg(unix)]
mod system {
    //! What only the system can do.

    use std::fs::File;
    use std::io;
    use std::os::unix::process::parent_id;
    use std::time::Duration;

    use rustix::process::{Resource, Rlimit, Signal, getpid, getrlimit, kill_process, setrlimit};

    use super::Trouble;

    /// How often the process looks whether its host is still there.
    const LOOK: Duration = Duration::from_millis(500);

    /// The pipes to the host, out of the library's way: it gets an empty input, and its output goes to standard error.
    pub fn pipes() -> io::Result<(File, File)> {
        let (stdin, stdout) = (rustix::stdio::stdin(), rustix::stdio::stdout());
        let (reader, writer) =
            (rustix::io::fcntl_dupfd_cloexec(stdin, 3)?, rustix::io::fcntl_dupfd_cloexec(stdout, 3)?);
        rustix::stdio::dup2_stdin(File::open("/dev/null")?)?;
        rustix::stdio::dup2_stdout(rustix::stdio::stderr())?;
        Ok((File::from(reader), File::from(writer)))
    }

    /// Ends the process soon after its parent has ended.
    pub fn end_with_host() {
        let host = parent_id();
        std::thread::spawn(move || {
            while parent_id() == host {
                std::thread::sleep(LOOK);
            }
            // At once: no code of the library's may hold it up, and nobody wants a core file.
            let _ = kill_process(getpid(), Signal::KILL);
        });
    }

    /// Lets the system refuse more address space than this.
    pub fn bound_memory(bytes: u64) -> Result<(), Trouble> {
        if bytes == 0 {
            return Ok(());
        }
        let hard = getrlimit(Resource::As).maximum;
        let limit = hard.map_or(bytes, |hard| hard.min(bytes));
        setrlimit(Resource::As, Rlimit { current: Some(limit), maximum: hard })
            .map_err(|error| Trouble::new(format!("its memory cannot be bounded: {error}")))
    }
}

#[cfg(not(unix))]
mod system {
    //! Without a system's help: the library shares the pipes, and rubbish on them is noticed by the frames' magic.

    use std::io::{self, Stdin, Stdout};

    use super::Trouble;

    pub fn pipes() -> io::Result<(Stdin, Stdout)> {
        Ok((io::stdin(), io::stdout()))
    }

    pub fn end_with_host() {}

    pub fn bound_memory(_: u64) -> Result<(), Trouble> {
        Ok(())
    }
}
