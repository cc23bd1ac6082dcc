//! Vectors of f32 by name of instruction, for the inner tiles that the compiler does not keep in registers by itself.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{
    __m128, __m256, __m512, _mm_add_ps, _mm_loadu_ps, _mm_mul_ps, _mm_set1_ps, _mm_storeu_ps, _mm256_fmadd_ps,
    _mm256_loadu_ps, _mm256_set1_ps, _mm256_storeu_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_set1_ps,
    _mm512_storeu_ps,
};

/// A register of `LANES` numbers.
///
/// # Safety
/// Every function must be called only where the processor has the instruction set (inside a `dispatch!` kernel of that
/// level); loads and stores touch `LANES` values from the pointer on, which must be valid.
pub trait Lanes: Copy {
    /// Numbers a register holds.
    const LANES: usize;
    /// All lanes `value`.
    unsafe fn splat(value: f32) -> Self;
    /// From memory of any alignment.
    unsafe fn load(from: *const f32) -> Self;
    /// To memory of any alignment.
    unsafe fn store(self, to: *mut f32);
    /// `self · factor + sum`, fused where the hardware does.
    unsafe fn mul_add(self, factor: Self, sum: Self) -> Self;
}

macro_rules! lanes {
    ($register:ty, $lanes:literal, $splat:ident, $load:ident, $store:ident, |$a:ident, $b:ident, $c:ident| $fma:expr) => {
        #[cfg(target_arch = "x86_64")]
        impl Lanes for $register {
            const LANES: usize = $lanes;
            #[inline(always)]
            unsafe fn splat(value: f32) -> Self {
                // SAFETY: the caller is a kernel of this instruction set.
                unsafe { $splat(value) }
            }
            #[inline(always)]
            unsafe fn load(from: *const f32) -> Self {
                // SAFETY: as above, and the pointer is valid for all lanes.
                unsafe { $load(from) }
            }
            #[inline(always)]
            unsafe fn store(self, to: *mut f32) {
                // SAFETY: as above.
                unsafe { $store(to, self) }
            }
            #[inline(always)]
            unsafe fn mul_add(self, factor: Self, sum: Self) -> Self {
                let ($a, $b, $c) = (self, factor, sum);
                // SAFETY: the caller is a kernel of this instruction set.
                unsafe { $fma }
            }
        }
    };
}

lanes!(__m128, 4, _mm_set1_ps, _mm_loadu_ps, _mm_storeu_ps, |a, b, c| _mm_add_ps(_mm_mul_ps(a, b), c));
lanes!(__m256, 8, _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, |a, b, c| _mm256_fmadd_ps(a, b, c));
lanes!(__m512, 16, _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, |a, b, c| _mm512_fmadd_ps(a, b, c));

#[cfg(not(target_arch = "x86_64"))]
impl Lanes for [f32; 4] {
    const LANES: usize = 4;
    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        [value; 4]
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller says that four values are there.
        unsafe { from.cast::<Self>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as above.
        unsafe { to.cast::<Self>().write_unaligned(self) }
    }
    #[inline(always)]
    unsafe fn mul_add(self, factor: Self, sum: Self) -> Self {
        std::array::from_fn(|lane| {
            crate::simd::mul_add::<{ cfg!(target_arch = "aarch64") }>(self[lane], factor[lane], sum[lane])
        })
    }
}
