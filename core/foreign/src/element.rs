//! Stored number forms and their widening to f64 or f32; little-endian unless said otherwise.

/// A stored form of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element {
    /// IEEE half.
    Half,
    /// The upper half of an f32.
    Brain,
    /// IEEE single.
    Single,
    /// IEEE double.
    Double,
    /// Whole numbers of so many bytes (1, 2, 4 or 8) with a sign.
    Signed(u8),
    /// Whole numbers of so many bytes (1, 2, 4 or 8) without a sign.
    Unsigned(u8),
}

impl Element {
    /// Bytes of one number.
    pub fn bytes(self) -> usize {
        match self {
            Self::Half | Self::Brain => 2,
            Self::Single => 4,
            Self::Double => 8,
            Self::Signed(bytes) | Self::Unsigned(bytes) => usize::from(bytes),
        }
    }

    /// The form behind numpy's kind and width, as `f8` or `i4`; `None` for texts, objects, complex numbers, records.
    pub fn of_numpy(code: &str) -> Option<Self> {
        Some(match code {
            "f2" => Self::Half,
            "f4" => Self::Single,
            "f8" => Self::Double,
            "i1" => Self::Signed(1),
            "i2" => Self::Signed(2),
            "i4" => Self::Signed(4),
            "i8" => Self::Signed(8),
            "u1" | "b1" => Self::Unsigned(1),
            "u2" => Self::Unsigned(2),
            "u4" => Self::Unsigned(4),
            "u8" => Self::Unsigned(8),
            _ => return None,
        })
    }

    /// All whole numbers in `bytes` as f64; integers beyond 2⁵³ are rounded.
    pub fn decode_wide(self, bytes: &[u8], big_endian: bool) -> Vec<f64> {
        let size = self.bytes();
        bytes
            .chunks_exact(size)
            .map(|chunk| {
                let mut raw = [0u8; 8];
                raw[..size].copy_from_slice(chunk);
                if big_endian {
                    raw[..size].reverse();
                }
                self.widen(raw)
            })
            .collect()
    }

    /// All whole numbers in `bytes`, little-endian, rounded to f32.
    pub fn decode(self, bytes: &[u8]) -> Vec<f32> {
        match self {
            Self::Single => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            _ => self.decode_wide(bytes, false).into_iter().map(|value| value as f32).collect(),
        }
    }

    /// One number, its bytes first in `raw`.
    fn widen(self, raw: [u8; 8]) -> f64 {
        let word = u64::from_le_bytes(raw);
        match self {
            Self::Half => f64::from(half(word as u16)),
            Self::Brain => f64::from(f32::from_bits((word as u32) << 16)),
            Self::Single => f64::from(f32::from_bits(word as u32)),
            Self::Double => f64::from_bits(word),
            Self::Unsigned(_) => word as f64,
            Self::Signed(bytes) => {
                let shift = 64 - 8 * u32::from(bytes);
                ((word << shift) as i64 >> shift) as f64
            }
        }
    }
}

/// Widens an IEEE half exactly.
fn half(bits: u16) -> f32 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from((bits >> 10) & 31), f32::from(bits & 1023));
    match exponent {
        0 => sign * fraction * 2f32.powi(-24),
        31 if fraction == 0.0 => sign * f32::INFINITY,
        31 => f32::NAN,
        _ => sign * (1024.0 + fraction) * 2f32.powi(exponent - 25),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_widens_exactly() {
        let halves = [(0x3c00, 1.0), (0xc000, -2.0), (0x0001, 2f32.powi(-24)), (0x7bff, 65504.0), (0x8000, -0.0)];
        for (bits, value) in halves {
            assert_eq!(half(bits), value, "{bits:#x}");
        }
        assert!(half(0x7e00).is_nan() && half(0xfc00) == f32::NEG_INFINITY);
        assert_eq!(Element::Brain.decode(&[0x80, 0x3f, 0x00]), [1.0]);
        assert_eq!(Element::Double.decode(&0.1f64.to_le_bytes()), [0.1f32]);
        assert_eq!(Element::Single.decode(&(-1.5f32).to_le_bytes()), [-1.5]);
        assert_eq!(Element::Signed(2).decode_wide(&[0xff, 0xfe], true), [-2.0]);
        assert_eq!(Element::Signed(4).decode_wide(&(-7i32).to_le_bytes(), false), [-7.0]);
        assert_eq!(Element::Signed(8).decode_wide(&i64::MIN.to_le_bytes(), false), [i64::MIN as f64]);
        assert_eq!(Element::Unsigned(1).decode_wide(&[200], false), [200.0]);
        assert_eq!(Element::Single.decode_wide(&1.5f32.to_be_bytes(), true), [1.5]);
    }
}
