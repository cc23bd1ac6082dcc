//! The reader against a writer made here from the format's document, against scipy's files, and against damage.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::io::Write as _;
use std::path::PathBuf;

use super::*;

/// An element: tag, data, padding to eight bytes.
fn element(kind: u32, data: &[u8], big: bool) -> Vec<u8> {
    let word = |value: u32| if big { value.to_be_bytes() } else { value.to_le_bytes() };
    let mut out = [word(kind), word(data.len() as u32)].concat();
    out.extend(data);
    out.resize(out.len().next_multiple_of(8), 0);
    out
}

/// An array of a class, its values stored as a type.
pub(crate) fn array(name: &str, class: u32, sides: &[u32], (kind, data): (u32, &[u8]), big: bool) -> Vec<u8> {
    let word = |value: u32| if big { value.to_be_bytes() } else { value.to_le_bytes() };
    let sides: Vec<u8> = sides.iter().flat_map(|side| word(*side)).collect();
    let parts = [
        element(6, &[word(class), word(0)].concat(), big),
        element(5, &sides, big),
        element(1, name.as_bytes(), big),
        element(kind, data, big),
    ];
    element(MATRIX, &parts.concat(), big)
}

fn zipped(element: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(element).unwrap();
    let data = encoder.finish().unwrap();
    [&COMPRESSED.to_le_bytes()[..], &(data.len() as u32).to_le_bytes(), &data].concat()
}

pub(crate) fn file(elements: &[Vec<u8>], big: bool) -> Vec<u8> {
    let mut out = vec![b' '; 124];
    out.extend(if big { [1, 0, b'M', b'I'] } else { [0, 1, b'I', b'M'] });
    elements.iter().for_each(|element| out.extend(element));
    out
}

/// Text as MATLAB stores it: two bytes a character.
pub(crate) fn text(name: &str, value: &str, big: bool) -> Vec<u8> {
    let data: Vec<u8> =
        value.encode_utf16().flat_map(|c| if big { c.to_be_bytes() } else { c.to_le_bytes() }).collect();
    array(name, 4, &[1, value.len() as u32], (4, &data), big)
}

fn f64s(values: &[f64], big: bool) -> Vec<u8> {
    values.iter().flat_map(|value| if big { value.to_be_bytes() } else { value.to_le_bytes() }).collect()
}

/// Everything a file says, in words.
fn read(bytes: &[u8]) -> Parsed<Vec<String>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mat");
    std::fs::write(&path, bytes).unwrap();
    let mut said = Vec::new();
    each(&path, &mut |array, values| {
        let content = match array.class {
            Class::Text => values.text(array.dimensions[0])?,
            Class::Other => "-".to_owned(),
            _ => format!("{:?}", values.numbers()?),
        };
        said.push(format!("{} {:?} {:?} {content}", array.name, array.class, array.dimensions));
        Ok(())
    })?;
    Ok(said)
}

#[test]
fn every_class_and_either_byte_order_is_read() {
    for big in [false, true] {
        let halves: Vec<u8> =
            [-2i16, 300].iter().flat_map(|v| if big { v.to_be_bytes() } else { v.to_le_bytes() }).collect();
        let elements = vec![
            array("a", 6, &[1, 3], (9, &f64s(&[1.5, -2.0, 1e300], big)), big),
            text("light", "LED-low", big),
            // MATLAB stores doubles that are small whole numbers as bytes.
            array("b", 6, &[2, 2], (2, &[1, 2, 3, 255]), big),
            array("c", 10, &[2, 1], (3, &halves), big),
            array("rows", 4, &[2, 3], (16, b"adbecf"), big),
            array("cell", 1, &[1, 1], (6, &[0; 8]), big),
            array("u", 9, &[1, 1], (2, &[7]), big),
        ];
        let wanted = [
            "a Numbers [1, 3] [1.5, -2.0, 1e300]",
            "light Text [1, 7] LED-low",
            "b Numbers [2, 2] [1.0, 2.0, 3.0, 255.0]",
            "c Numbers [2, 1] [-2.0, 300.0]",
            "rows Text [2, 3] adbecf",
            "cell Other [1, 1] -",
            "u Bytes [1, 1] [7.0]",
        ];
        assert_eq!(read(&file(&elements, big)).unwrap(), wanted);
        if !big {
            let zipped: Vec<Vec<u8>> = elements.iter().map(|element| zipped(element)).collect();
            assert_eq!(read(&file(&zipped, false)).unwrap(), wanted);
        }
    }
    // The short form: up to four bytes within the tag.
    let small = [&[1u8, 0, 1, 0][..], b"x\0\0\0"].concat();
    let parts = [element(6, &[6, 0, 0, 0, 0, 0, 0, 0], false), element(5, &[1, 0, 0, 0, 2, 0, 0, 0], false), small];
    let values = [2u8, 0, 2, 0, 8, 9, 0, 0];
    let whole = element(MATRIX, &[&parts.concat()[..], &values].concat(), false);
    assert_eq!(read(&file(&[whole], false)).unwrap(), ["x Numbers [1, 2] [8.0, 9.0]"]);
}

#[test]
fn claims_are_checked_before_memory_is_taken() {
    let number =
        |sides: &[u32], kind: u32, data: &[u8]| read(&file(&[array("x", 6, sides, (kind, data), false)], false));
    for (message, found) in [
        ("size contradicts", number(&[2, 2], 9, &[0; 8])),
        ("absurdly long", number(&[u32::MAX, u32::MAX, u32::MAX], 9, &[0; 8])),
        ("unknown type", number(&[1, 1], 77, &[0; 8])),
        ("no MATLAB file", read(&[0; 300])),
        ("cut short", read(&[0; 30])),
        ("reaches to byte", read(&file(&[vec![14, 0, 0, 0, 255, 255, 255, 127]], false))),
        ("header has", read(&file(&[element(MATRIX, &[6, 0, 0, 0, 255, 255, 255, 15], false)], false))),
        ("damaged", read(&file(&[[&[15u8, 0, 0, 0, 8, 0, 0, 0][..], &[9; 8]].concat()], false))),
    ] {
        let said = found.unwrap_err();
        assert!(said.contains(message), "{message}: {said}");
    }
}

/// A bomb: a kilobyte that unpacks to a megabyte of zeros claimed as an enormous pulse.
#[test]
fn a_bomb_is_read_in_bounded_memory() {
    let long = array("video", 9, &[1 << 24, 1], (2, &vec![0; 1 << 24]), false);
    let bomb = file(&[zipped(&long), text("light", "x", false)], false);
    assert!(bomb.len() < 1 << 18);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mat");
    std::fs::write(&path, &bomb).unwrap();
    let (mut longest, mut total, mut names) = (0, 0, Vec::new());
    each(&path, &mut |array, values| {
        names.push(array.name.clone());
        if array.class != Class::Bytes {
            return Ok(());
        }
        values.stream(&mut |numbers| {
            longest = longest.max(numbers.len());
            total += numbers.len();
            Ok(())
        })
    })
    .unwrap();
    assert_eq!((longest <= BATCH, total), (true, 1 << 24));
    assert_eq!(names, ["video", "light"]);
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/datasets").join(name)
}

#[test]
fn scipys_files_are_read() {
    let plain = read(&std::fs::read(golden("mmpd_plain.mat")).unwrap()).unwrap();
    let compressed = read(&std::fs::read(golden("mmpd_compressed.mat")).unwrap()).unwrap();
    assert_eq!(plain, compressed);
    assert!(plain.contains(&"motion Text [1, 27] Stationary (after exercise)".to_owned()), "{:?}", &plain[2..]);
    let odd = read(&std::fs::read(golden("mmpd_odd.mat")).unwrap()).unwrap();
    assert!(odd[0].starts_with("video Bytes [12, 6, 8, 3] [0.0, 3.0, 6.0"), "{}", &odd[0][..60]);
    assert!(odd.contains(&"cell Other [1, 3] -".to_owned()) && odd.contains(&"st Other [1, 1] -".to_owned()));
}
