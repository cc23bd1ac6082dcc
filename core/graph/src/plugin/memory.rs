//! Remembers what each library said of itself, so that a library is started only when it is new or has work to do.
//!
//! One file a library path: the file's stamp and digest, and the description or the reason why there is none. A stamp that
//! differs costs a new digest; a digest that differs costs a new description. A folder that cannot be written costs time
//! and nothing else.

use std::io::{self, Write};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::digest::Digest;

use super::frame::Trouble;

/// A file changed this recently may change again within its time stamp's resolution, so its stamp proves nothing.
const RACY: Duration = Duration::from_secs(2);
/// Descriptions of another host are not used: what it refused we may take.
const HOST: &str = concat!(env!("CARGO_PKG_VERSION"), "/abi-1.0");

/// What is known of a library file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Known {
    host: String,
    stamp: Option<Stamp>,
    pub digest: Digest,
    /// The description, or why there is none.
    pub said: Result<Value, Trouble>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    size: u64,
    modified_nanoseconds: u64,
    inode: u64,
}

impl Stamp {
    fn of(path: &Path) -> io::Result<Option<Self>> {
        let metadata = std::fs::metadata(path)?;
        #[cfg(unix)]
        let inode = std::os::unix::fs::MetadataExt::ino(&metadata);
        #[cfg(not(unix))]
        let inode = 0;
        let modified = metadata.modified()?;
        let settled = SystemTime::now().duration_since(modified).is_ok_and(|age| age > RACY);
        let since = modified.duration_since(UNIX_EPOCH).unwrap_or_default();
        let modified_nanoseconds = u64::try_from(since.as_nanos()).unwrap_or(u64::MAX);
        Ok(settled.then_some(Self { size: metadata.len(), modified_nanoseconds, inode }))
    }
}

/// What is known of the library `path`, which is canonical. `ask` is called with its digest when it is new, or when
/// `afresh`.
///
/// # Errors
/// When the file cannot be read.
pub(crate) fn recall(
    folder: Option<&Path>,
    path: &Path,
    afresh: bool,
    ask: impl FnOnce(&Digest) -> Result<Value, Trouble>,
) -> io::Result<Known> {
    let name = Digest::of(path.as_os_str().as_encoded_bytes()).to_string();
    let memo = folder.map(|folder| folder.join(format!("{name}.json")));
    let known = memo.as_deref().and_then(read).filter(|known| known.host == HOST && !afresh);
    let stamp = Stamp::of(path)?;
    if let Some(known) = &known
        && stamp.is_some()
        && known.stamp == stamp
    {
        return Ok(known.clone());
    }
    let digest = Digest::of(&std::fs::read(path)?);
    let said = known.filter(|known| known.digest == digest).map(|known| known.said);
    let known = Known { host: HOST.to_owned(), stamp, digest, said: said.unwrap_or_else(|| ask(&digest)) };
    if let Some(memo) = memo {
        // Only a memo: without it the library is asked again.
        let _ = write(&memo, &known);
    }
    Ok(known)
}

fn read(memo: &Path) -> Option<Known> {
    serde_json::from_slice(&std::fs::read(memo).ok()?).ok()
}

fn write(memo: &Path, known: &Known) -> io::Result<()> {
    let folder = memo.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder)?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(&serde_json::to_vec(known)?)?;
    file.persist(memo)?;
    Ok(())
}
