//! Eight lanes by AVX2 and FMA.

use super::{EightLanes, Lanes};
use std::arch::x86_64::*;

/// Eight lanes in one 256-bit register.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(__m256);

macro_rules! elementwise {
    ($($name:ident = $intrinsic:ident;)*) => {$(
        #[inline(always)]
        unsafe fn $name(self, other: Self) -> Self {
            // SAFETY: AVX2 is present by the trait's contract.
            Self(unsafe { $intrinsic(self.0, other.0) })
        }
    )*};
}

// SAFETY: every method's instructions are AVX2/FMA, which the trait's contract asks callers to have.
#[expect(clippy::undocumented_unsafe_blocks, reason = "each block is the method's own contract: AVX2 is present")]
unsafe impl Lanes for Avx2 {
    const N: usize = 8;
    type Mask = __m256;
    type Eight = Self;

    elementwise! { add = _mm256_add_ps; sub = _mm256_sub_ps; mul = _mm256_mul_ps; div = _mm256_div_ps; min = _mm256_min_ps; max = _mm256_max_ps; }

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        Self(unsafe { _mm256_set1_ps(value) })
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        Self(unsafe { _mm256_loadu_ps(from) })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        unsafe { _mm256_storeu_ps(to, self.0) }
    }
    #[inline(always)]
    unsafe fn sqrt(self) -> Self {
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }
    #[inline(always)]
    unsafe fn floor(self) -> Self {
        Self(unsafe { _mm256_floor_ps(self.0) })
    }
    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { _mm256_fmadd_ps(self.0, factor.0, addend.0) })
    }
    #[inline(always)]
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self {
        Self(unsafe { _mm256_fnmadd_ps(self.0, factor.0, addend.0) })
    }
    #[inline(always)]
    unsafe fn ge(self, other: Self) -> Self::Mask {
        unsafe { _mm256_cmp_ps::<_CMP_GE_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    unsafe fn lt(self, other: Self) -> Self::Mask {
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, other.0) }
    }
    #[inline(always)]
    unsafe fn bits(mask: Self::Mask) -> u32 {
        unsafe { _mm256_movemask_ps(mask) as u32 }
    }
    #[inline(always)]
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { _mm256_and_ps(a, b) }
    }
    #[inline(always)]
    unsafe fn select(mask: Self::Mask, a: Self, b: Self) -> Self {
        Self(unsafe { _mm256_blendv_ps(b.0, a.0, mask) })
    }
    #[inline(always)]
    unsafe fn keep(self, mask: Self::Mask) -> Self {
        Self(unsafe { _mm256_and_ps(self.0, mask) })
    }
    #[inline(always)]
    unsafe fn negative(self) -> Self {
        Self(unsafe { _mm256_or_ps(self.0, _mm256_set1_ps(-0.0)) })
    }
    #[inline(always)]
    unsafe fn scale_exponent(self, shifted: Self) -> Self {
        unsafe {
            // The shift drops all bits of 1.5·2²³ and leaves n in the exponent's place.
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(shifted.0));
            Self(_mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(self.0), exponent)))
        }
    }
    #[inline(always)]
    unsafe fn prefetch(from: *const f32) {
        unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) }
    }
    #[inline(always)]
    unsafe fn split_exponent(self) -> (Self, Self) {
        unsafe {
            let bits = _mm256_castps_si256(self.0);
            let mantissa =
                _mm256_or_si256(_mm256_and_si256(bits, _mm256_set1_epi32(0x007F_FFFF)), _mm256_set1_epi32(0x3F80_0000));
            let exponent = _mm256_sub_epi32(_mm256_srli_epi32::<23>(bits), _mm256_set1_epi32(127));
            (Self(_mm256_castsi256_ps(mantissa)), Self(_mm256_cvtepi32_ps(exponent)))
        }
    }
    #[inline(always)]
    unsafe fn sum(self) -> f32 {
        unsafe {
            let half = _mm_add_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
            let pair = _mm_add_ps(half, _mm_movehl_ps(half, half));
            _mm_cvtss_f32(_mm_add_ss(pair, _mm_shuffle_ps::<1>(pair, pair)))
        }
    }
    #[inline(always)]
    unsafe fn sum_eight(v: [Self; 8]) -> [f32; 8] {
        unsafe {
            let ab = _mm256_hadd_ps(v[0].0, v[1].0);
            let cd = _mm256_hadd_ps(v[2].0, v[3].0);
            let ef = _mm256_hadd_ps(v[4].0, v[5].0);
            let gh = _mm256_hadd_ps(v[6].0, v[7].0);
            let abcd = _mm256_hadd_ps(ab, cd);
            let efgh = _mm256_hadd_ps(ef, gh);
            let low = _mm256_permute2f128_ps::<0x20>(abcd, efgh);
            let high = _mm256_permute2f128_ps::<0x31>(abcd, efgh);
            let mut out = [0.0; 8];
            _mm256_storeu_ps(out.as_mut_ptr(), _mm256_add_ps(low, high));
            out
        }
    }
}

// SAFETY: as above.
unsafe impl EightLanes for Avx2 {
    #[inline(always)]
    unsafe fn fours(low: Self, high: Self) -> u64 {
        // SAFETY: AVX2 is present by the trait's contract.
        unsafe {
            // What is beyond the range of i32 becomes its least value, which ends before it starts, or starts at 0.
            let first = _mm256_cvttps_epi32(_mm256_max_ps(_mm256_ceil_ps(low.0), _mm256_setzero_ps()));
            let last = _mm256_cvttps_epi32(_mm256_min_ps(_mm256_floor_ps(high.0), _mm256_set1_ps(31.0)));
            let up_to = _mm256_sllv_epi32(_mm256_set1_epi32(2), _mm256_srai_epi32::<2>(last));
            let before = _mm256_sllv_epi32(_mm256_set1_epi32(1), _mm256_srai_epi32::<2>(first));
            let bits = _mm256_andnot_si256(_mm256_cmpgt_epi32(first, last), _mm256_sub_epi32(up_to, before));
            let words = _mm_packus_epi32(_mm256_castsi256_si128(bits), _mm256_extracti128_si256::<1>(bits));
            _mm_cvtsi128_si64(_mm_packus_epi16(words, words)) as u64
        }
    }
}
