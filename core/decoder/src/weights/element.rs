//! Stored number forms and their widening to f32; little-endian throughout.

/// A stored form of numbers with a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element {
    /// IEEE half.
    Half,
    /// The upper half of an f32.
    Brain,
    /// IEEE single.
    Single,
    /// IEEE double; rounded to f32.
    Double,
}

impl Element {
    /// Bytes of one number.
    pub fn bytes(self) -> usize {
        match self {
            Self::Half | Self::Brain => 2,
            Self::Single => 4,
            Self::Double => 8,
        }
    }

    /// The form of a safetensors type; `None` for integers and forms no network here uses.
    pub fn of_safetensors(dtype: safetensors::Dtype) -> Option<Self> {
        match dtype {
            safetensors::Dtype::F16 => Some(Self::Half),
            safetensors::Dtype::BF16 => Some(Self::Brain),
            safetensors::Dtype::F32 => Some(Self::Single),
            safetensors::Dtype::F64 => Some(Self::Double),
            _ => None,
        }
    }

    /// All whole numbers in `bytes`.
    pub fn decode(self, bytes: &[u8]) -> Vec<f32> {
        match self {
            Self::Half => bytes.as_chunks().0.iter().map(|b| half(u16::from_le_bytes(*b))).collect(),
            Self::Brain => {
                bytes.as_chunks().0.iter().map(|b| f32::from_bits(u32::from(u16::from_le_bytes(*b)) << 16)).collect()
            }
            Self::Single => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            Self::Double => bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b) as f32).collect(),
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
    }
}
