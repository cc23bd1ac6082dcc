//! What an H.264 sequence parameter set says of colour and format (ITU-T H.264, 7.3.2.1.1 and annex E).

/// Colour and sampling of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Format {
    /// 1 is 4:2:0.
    pub chroma_format: u32,
    /// Bits of a luma sample.
    pub bit_depth: u32,
    /// Whether 0 is black and 255 white, rather than 16 and 235.
    pub full_range: bool,
    /// Matrix coefficients (ITU-T H.273); 2 is unspecified.
    pub matrix: u8,
}

/// Reads the bits of a payload from which emulation prevention bytes were removed; past the end it gives `None`.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn bit(&mut self) -> Option<u32> {
        let byte = *self.bytes.get(self.at / 8)?;
        let bit = (byte >> (7 - self.at % 8)) & 1;
        self.at += 1;
        Some(u32::from(bit))
    }

    fn bits(&mut self, count: u32) -> Option<u32> {
        (0..count).try_fold(0, |value, _| Some(value << 1 | self.bit()?))
    }

    /// Exponential-Golomb, unsigned.
    fn golomb(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.bit()? == 0 {
            zeros += 1;
            if zeros > 31 {
                return None;
            }
        }
        Some((1u32 << zeros) - 1 + self.bits(zeros)?)
    }

    /// Exponential-Golomb, signed.
    fn signed_golomb(&mut self) -> Option<i32> {
        let code = self.golomb()? as i32;
        Some(if code % 2 == 1 { code / 2 + 1 } else { -(code / 2) })
    }
}

/// Removes emulation prevention bytes (00 00 03 → 00 00).
fn unescape(nal: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(nal.len());
    let mut zeros = 0;
    for &byte in nal {
        if zeros >= 2 && byte == 3 {
            zeros = 0;
            continue;
        }
        zeros = if byte == 0 { zeros + 1 } else { 0 };
        out.push(byte);
    }
    out
}

/// The format of a stream from its sequence parameter set NAL unit; `None` when that is damaged.
pub(super) fn format(sps: &[u8]) -> Option<Format> {
    let payload = unescape(sps.get(1..)?);
    let mut bits = Bits { bytes: &payload, at: 0 };
    let profile = bits.bits(8)?;
    bits.bits(16)?;
    bits.golomb()?;
    let mut format = Format { chroma_format: 1, bit_depth: 8, full_range: false, matrix: 2 };
    if [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135].contains(&profile) {
        format.chroma_format = bits.golomb()?;
        if format.chroma_format == 3 {
            bits.bit()?;
        }
        format.bit_depth = 8 + bits.golomb()?;
        bits.golomb()?;
        bits.bit()?;
        if bits.bit()? == 1 {
            let lists = if format.chroma_format == 3 { 12 } else { 8 };
            for list in 0..lists {
                if bits.bit()? == 1 {
                    skip_scaling_list(&mut bits, if list < 6 { 16 } else { 64 })?;
                }
            }
        }
    }
    skip_to_vui(&mut bits)?;
    if bits.bit()? == 1 {
        // Without the rest of the VUI the defaults stand.
        let _ = read_colour(&mut bits, &mut format);
    }
    Some(format)
}

fn skip_scaling_list(bits: &mut Bits<'_>, size: usize) -> Option<()> {
    let (mut last, mut next) = (8i32, 8i32);
    for _ in 0..size {
        if next != 0 {
            next = (last + bits.signed_golomb()?).rem_euclid(256);
        }
        if next != 0 {
            last = next;
        }
    }
    Some(())
}

fn skip_to_vui(bits: &mut Bits<'_>) -> Option<()> {
    bits.golomb()?;
    match bits.golomb()? {
        0 => {
            bits.golomb()?;
        }
        1 => {
            bits.bit()?;
            bits.signed_golomb()?;
            bits.signed_golomb()?;
            for _ in 0..bits.golomb()?.min(255) {
                bits.signed_golomb()?;
            }
        }
        _ => {}
    }
    bits.golomb()?;
    bits.bit()?;
    bits.golomb()?;
    bits.golomb()?;
    if bits.bit()? == 0 {
        bits.bit()?;
    }
    bits.bit()?;
    if bits.bit()? == 1 {
        for _ in 0..4 {
            bits.golomb()?;
        }
    }
    Some(())
}

fn read_colour(bits: &mut Bits<'_>, format: &mut Format) -> Option<()> {
    if bits.bit()? == 1 && bits.bits(8)? == 255 {
        bits.bits(32)?;
    }
    if bits.bit()? == 1 {
        bits.bit()?;
    }
    if bits.bit()? == 1 {
        bits.bits(3)?;
        format.full_range = bits.bit()? == 1;
        if bits.bit()? == 1 {
            bits.bits(16)?;
            format.matrix = bits.bits(8)? as u8;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golomb_codes_follow_the_standard() {
        let bytes = [0b1010_0110, 0b0100_0010, 0b1000_0000];
        let mut bits = Bits { bytes: &bytes, at: 0 };
        assert_eq!(
            [bits.golomb(), bits.golomb(), bits.golomb(), bits.golomb(), bits.golomb()],
            [0, 1, 2, 3, 4].map(Some)
        );
        let mut bits = Bits { bytes: &bytes, at: 1 };
        assert_eq!([bits.signed_golomb(), bits.signed_golomb()], [Some(1), Some(-1)]);
        assert_eq!(Bits { bytes: &[0; 9], at: 0 }.golomb(), None);
    }

    #[test]
    fn any_bytes_are_survived() {
        for seed in 0..2000u64 {
            let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let bytes: Vec<u8> = (0..24)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    (state >> 56) as u8
                })
                .collect();
            let _ = format(&bytes);
        }
    }
}
