//! Radiance RGBE pictures: three mantissas and a shared exponent, plain, or run-length coded by component.
//! After Ward's "Real Pixels" (Graphics Gems II) and the format's reference text.

use super::{LightImage, checked_size};

/// Reads a picture; the header's `EXPOSURE`s are divided out, so values are those of the scene.
pub(super) fn parse(bytes: &[u8]) -> Result<LightImage, String> {
    let mut reader = Reader { bytes, at: 0 };
    let mut exposure = 1.0f32;
    loop {
        let line = reader.line()?;
        if line.is_empty() {
            break;
        }
        if let Some(format) = line.strip_prefix("FORMAT=") {
            if format.trim() != "32-bit_rle_rgbe" {
                return Err(format!("its pixel format is {format}; 32-bit_rle_rgbe is expected"));
            }
        } else if let Some(value) = line.strip_prefix("EXPOSURE=") {
            exposure *= value.trim().parse::<f32>().ok().filter(|e| e.is_finite() && *e > 0.0).unwrap_or(1.0);
        }
    }
    let size = reader.line()?;
    let words: Vec<&str> = size.split_whitespace().collect();
    let ["-Y", height, "+X", width] = words.as_slice() else {
        return Err(format!("its orientation {size:?} is not read; write it as -Y height +X width"));
    };
    let number = |word: &str| word.parse::<usize>().map_err(|_| format!("{word:?} is not a size"));
    let [width, height] = checked_size(number(width)?, number(height)?)?;
    let mut image = LightImage { width, height, data: Vec::new() };
    let mut row = vec![[0u8; 4]; width];
    for y in 0..height {
        reader.row(&mut row).map_err(|reason| format!("row {y}: {reason}"))?;
        for [r, g, b, e] in &row {
            // Exponents are biased by 128, mantissas by 8 bits; exponent 0 is black.
            let scale = if *e == 0 { 0.0 } else { (f32::from(*e) - 136.0).exp2() / exposure };
            image.data.extend([r, g, b].map(|m| f32::from(*m) * scale));
        }
    }
    Ok(image)
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn line(&mut self) -> Result<String, String> {
        let rest = &self.bytes[self.at..];
        let end = rest.iter().take(4096).position(|b| *b == b'\n').ok_or("its header does not end")?;
        self.at += end + 1;
        Ok(String::from_utf8_lossy(&rest[..end]).trim_end_matches('\r').to_string())
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let got = self.bytes.get(self.at..self.at + N).and_then(|b| b.try_into().ok()).ok_or("the file ends here")?;
        self.at += N;
        Ok(got)
    }

    fn row(&mut self, row: &mut [[u8; 4]]) -> Result<(), String> {
        let first: [u8; 4] = self.take()?;
        let coded = first[0] == 2 && first[1] == 2 && usize::from(first[2]) << 8 | usize::from(first[3]) == row.len();
        if coded && (8..32_768).contains(&row.len()) { self.coded_row(row) } else { self.plain_row(first, row) }
    }

    /// Components one after another, in runs.
    fn coded_row(&mut self, row: &mut [[u8; 4]]) -> Result<(), String> {
        for component in 0..4 {
            let mut x = 0;
            while x < row.len() {
                let [count] = self.take()?;
                let (length, repeated) =
                    if count > 128 { (usize::from(count - 128), true) } else { (usize::from(count), false) };
                if length == 0 || x + length > row.len() {
                    return Err("a run leaves the row".into());
                }
                let mut value = if repeated { self.take::<1>()?[0] } else { 0 };
                for pixel in &mut row[x..x + length] {
                    if !repeated {
                        [value] = self.take()?;
                    }
                    pixel[component] = value;
                }
                x += length;
            }
        }
        Ok(())
    }

    /// Whole pixels; (1, 1, 1, n) repeats the one before n times, shifted by 8 bits for each such pixel in a row.
    fn plain_row(&mut self, first: [u8; 4], row: &mut [[u8; 4]]) -> Result<(), String> {
        let (mut x, mut shift, mut pixel) = (0, 0, first);
        loop {
            if pixel[..3] == [1, 1, 1] {
                let length = usize::from(pixel[3]) << shift;
                if x == 0 || shift > 16 || x + length > row.len() {
                    return Err("a run leaves the row".into());
                }
                let before = row[x - 1];
                row[x..x + length].fill(before);
                x += length;
                shift += 8;
            } else {
                row[x] = pixel;
                x += 1;
                shift = 0;
            }
            if x >= row.len() {
                return Ok(());
            }
            pixel = self.take()?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(width: usize, height: usize) -> Vec<u8> {
        format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n-Y {height} +X {width}\n").into_bytes()
    }

    #[test]
    fn all_three_codings_give_the_same_pixels() -> Result<(), String> {
        let row: Vec<[u8; 4]> = (0..12u8).map(|x| [if x < 9 { 7 } else { x }, 2 * x, 200, 129]).collect();
        let mut plain = header(12, 1);
        plain.extend(row.as_flattened());
        let mut coded = header(12, 1);
        coded.extend([2, 2, 0, 12]);
        for component in 0..4 {
            match component {
                0 => coded.extend([128 + 9, 7, 3, 9, 10, 11]),
                1 => {
                    coded.push(12);
                    coded.extend((0..12u8).map(|x| 2 * x));
                }
                _ => coded.extend([128 + 12, row[0][component]]),
            }
        }
        let (a, b) = (parse(&plain)?, parse(&coded)?);
        assert_eq!(a, b);
        assert_eq!(a.data[..3], [7.0 / 256.0, 0.0, 200.0 / 256.0]);
        let mut old = header(12, 1);
        old.extend([5, 5, 5, 128, 1, 1, 1, 11]);
        assert!(parse(&old)?.data.iter().all(|v| *v == 5.0 / 512.0));
        Ok(())
    }

    #[test]
    fn damage_is_named_and_bounded() {
        let mut cut = header(8, 2);
        cut.extend([9; 40]);
        assert!(parse(&cut).is_err_and(|e| e.contains("row 1")));
        assert!(parse(&header(1 << 40, 1)).is_err_and(|e| e.contains("size")));
        assert!(parse(b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n").is_err());
        assert!(parse(b"#?RADIANCE").is_err());
        assert!(parse(b"#?RADIANCE\n\n+X 3 +Y 3\n").is_err());
        for run in [[2, 2, 0, 12, 255, 1, 255, 1], [1, 1, 1, 3, 0, 0, 0, 0]] {
            let mut wild = header(12, 1);
            wild.extend(run);
            assert!(parse(&wild).is_err());
        }
    }
}
