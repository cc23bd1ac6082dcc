//! Portable lanes: eight f32 in an array, masks as bits, no branches, so that any target's compiler can vectorise it.

use super::{EightLanes, Lanes};

/// Eight lanes.
#[derive(Clone, Copy)]
pub(crate) struct Array([f32; 8]);

#[inline(always)]
fn zip(a: [f32; 8], b: [f32; 8], f: impl Fn(f32, f32) -> f32) -> Array {
    let mut out = [0.0; 8];
    for i in 0..8 {
        out[i] = f(a[i], b[i]);
    }
    Array(out)
}

#[inline(always)]
fn bits(condition: bool) -> u32 {
    u32::from(condition).wrapping_neg()
}

// SAFETY: plain Rust; no instruction beyond the build's target is used.
unsafe impl Lanes for Array {
    const N: usize = 8;
    type Mask = [u32; 8];
    type Eight = Self;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self([value; 8])
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller gives eight readable values.
        Self(unsafe { from.cast::<[f32; 8]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller gives eight writable values.
        unsafe { to.cast::<[f32; 8]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        zip(self.0, other.0, |a, b| a + b)
    }
    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        zip(self.0, other.0, |a, b| a - b)
    }
    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        zip(self.0, other.0, |a, b| a * b)
    }
    #[inline(always)]
    unsafe fn div(self, other: Self) -> Self {
        zip(self.0, other.0, |a, b| a / b)
    }
    #[inline(always)]
    unsafe fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }
    #[inline(always)]
    unsafe fn floor(self) -> Self {
        Self(self.0.map(f32::floor))
    }
    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        let mut out = addend.0;
        for i in 0..8 {
            out[i] += self.0[i] * factor.0[i];
        }
        Self(out)
    }
    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        let mut out = addend.0;
        for i in 0..8 {
            out[i] -= self.0[i] * factor.0[i];
        }
        Self(out)
    }
    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        zip(self.0, other.0, |a, b| if a < b { a } else { b })
    }
    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        zip(self.0, other.0, |a, b| if a > b { a } else { b })
    }
    #[inline(always)]
    unsafe fn ge(self, other: Self) -> Self::Mask {
        let mut mask = [0; 8];
        for i in 0..8 {
            mask[i] = bits(self.0[i] >= other.0[i]);
        }
        mask
    }
    #[inline(always)]
    unsafe fn lt(self, other: Self) -> Self::Mask {
        let mut mask = [0; 8];
        for i in 0..8 {
            mask[i] = bits(self.0[i] < other.0[i]);
        }
        mask
    }
    #[inline(always)]
    unsafe fn bits(mask: Self::Mask) -> u32 {
        mask.iter().enumerate().map(|(i, bits)| (bits & 1) << i).sum()
    }
    #[inline(always)]
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        let mut mask = [0; 8];
        for i in 0..8 {
            mask[i] = a[i] & b[i];
        }
        mask
    }
    #[inline(always)]
    unsafe fn select(mask: Self::Mask, a: Self, b: Self) -> Self {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = f32::from_bits((a.0[i].to_bits() & mask[i]) | (b.0[i].to_bits() & !mask[i]));
        }
        Self(out)
    }
    #[inline(always)]
    unsafe fn keep(self, mask: Self::Mask) -> Self {
        let mut out = [0.0; 8];
        for i in 0..8 {
            out[i] = f32::from_bits(self.0[i].to_bits() & mask[i]);
        }
        Self(out)
    }
    #[inline(always)]
    unsafe fn negative(self) -> Self {
        Self(self.0.map(|x| f32::from_bits(x.to_bits() | 0x8000_0000)))
    }
    #[inline(always)]
    unsafe fn scale_exponent(self, shifted: Self) -> Self {
        let mut out = [0.0; 8];
        for i in 0..8 {
            // The shift drops all bits of 1.5·2²³ and leaves n in the exponent's place.
            out[i] = f32::from_bits(self.0[i].to_bits().wrapping_add(shifted.0[i].to_bits() << 23));
        }
        Self(out)
    }
    #[inline(always)]
    unsafe fn split_exponent(self) -> (Self, Self) {
        let (mut mantissa, mut exponent) = ([0.0; 8], [0.0; 8]);
        for i in 0..8 {
            let b = self.0[i].to_bits();
            mantissa[i] = f32::from_bits((b & 0x007F_FFFF) | 0x3F80_0000);
            exponent[i] = ((b >> 23) & 0xFF) as i32 as f32 - 127.0;
        }
        (Self(mantissa), Self(exponent))
    }
    #[inline(always)]
    unsafe fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }
}

// SAFETY: plain Rust.
unsafe impl EightLanes for Array {
    #[inline(always)]
    unsafe fn fours(low: Self, high: Self) -> u64 {
        let mut bits = 0;
        for lane in 0..8 {
            let (first, last) =
                (low.0[lane].ceil().clamp(0.0, 32.0) as i32, high.0[lane].floor().clamp(-1.0, 31.0) as i32);
            if first <= last {
                bits |= ((2u64 << (last >> 2)) - (1u64 << (first >> 2))) << (8 * lane);
            }
        }
        bits
    }
}
