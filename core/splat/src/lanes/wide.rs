//! Arithmetic operators over [`Lanes`], for kernels that are mostly formulas.

use super::Lanes;
use std::ops::{Add, Mul, Neg, Sub};

/// A vector with operators. To be made only inside a function with the features of `V`, as every [`Lanes`] method.
#[derive(Clone, Copy)]
pub(crate) struct Wide<V: Lanes>(pub V);

impl<V: Lanes> Add for Wide<V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.add(other.0) })
    }
}
impl<V: Lanes> Sub for Wide<V> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.sub(other.0) })
    }
}
impl<V: Lanes> Mul for Wide<V> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.mul(other.0) })
    }
}
impl<V: Lanes> Mul<f32> for Wide<V> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f32) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.mul(V::splat(other)) })
    }
}
impl<V: Lanes> Add<f32> for Wide<V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f32) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.add(V::splat(other)) })
    }
}
impl<V: Lanes> Neg for Wide<V> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { V::zero().sub(self.0) })
    }
}

impl<V: Lanes> Wide<V> {
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    pub unsafe fn splat(value: f32) -> Self {
        // SAFETY: the caller's contract.
        Self(unsafe { V::splat(value) })
    }
    /// The first `V::N` of the values.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    pub unsafe fn load(values: &[f32; super::MAX_LANES]) -> Self {
        // SAFETY: MAX_LANES values are readable.
        Self(unsafe { V::load(values.as_ptr()) })
    }
    /// Writes the first `V::N` of the values.
    #[inline(always)]
    pub fn store(self, values: &mut [f32; super::MAX_LANES]) {
        // SAFETY: MAX_LANES values are writable, and a value exists only where V's features are present.
        unsafe { self.0.store(values.as_mut_ptr()) }
    }
    /// `self·factor + addend`.
    #[inline(always)]
    pub fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.mul_add(factor.0, addend.0) })
    }
    /// `self·factor + addend` with one factor for all lanes.
    #[inline(always)]
    pub fn scale_add(self, factor: f32, addend: Self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.mul_add(V::splat(factor), addend.0) })
    }
    #[inline(always)]
    pub fn recip(self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { V::splat(1.0).div(self.0) })
    }
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.sqrt() })
    }
    #[inline(always)]
    pub fn clamp(self, low: f32, high: f32) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.max(V::splat(low)).min(V::splat(high)) })
    }
    /// 1 where `low < self < high`, else 0: the slope of [`Self::clamp`].
    #[inline(always)]
    pub fn inside(self, low: f32, high: f32) -> Self {
        // SAFETY: a value exists only where V's features are present.
        unsafe {
            let mask = V::both(V::splat(low).lt(self.0), self.0.lt(V::splat(high)));
            Self(V::splat(1.0).keep(mask))
        }
    }
    /// 1 where `low ≤ self ≤ high`, else 0.
    #[inline(always)]
    pub fn within(self, low: f32, high: f32) -> Self {
        // SAFETY: a value exists only where V's features are present.
        unsafe {
            let mask = V::both(self.0.ge(V::splat(low)), V::splat(high).ge(self.0));
            Self(V::splat(1.0).keep(mask))
        }
    }
    /// `a` where `choice` is at least ½, else `b`; what is not chosen may be anything.
    #[inline(always)]
    pub fn pick(choice: Self, a: Self, b: Self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        unsafe { Self(V::select(choice.0.ge(V::splat(0.5)), a.0, b.0)) }
    }
    #[inline(always)]
    pub fn abs(self) -> Self {
        self.max(-self)
    }
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.max(other.0) })
    }
    /// Base-2 logarithm of positive normal values.
    #[inline(always)]
    pub fn log2(self) -> Self {
        // SAFETY: a value exists only where V's features are present.
        Self(unsafe { self.0.log2() })
    }
    /// 1 where `self ≥ bound`, else 0.
    #[inline(always)]
    pub fn at_least(self, bound: f32) -> Self {
        // SAFETY: a value exists only where V's features are present.
        unsafe { Self(V::splat(1.0).keep(self.0.ge(V::splat(bound)))) }
    }
}

/// `[f(0), …, f(K − 1)]`. Unlike `array::map` it leaves no call behind: lane code that is not inlined into a function with
/// the level's features calls every instruction as a function, at a tenth of the speed. Closures given to it are marked
/// `#[inline(always)]` for the same reason.
#[inline(always)]
pub(crate) fn each<const K: usize, T: Copy>(f: impl Fn(usize) -> T) -> [T; K] {
    let mut out = [f(0); K];
    for (k, out) in out.iter_mut().enumerate().skip(1) {
        *out = f(k);
    }
    out
}

/// Dot product of two vectors.
#[inline(always)]
pub(crate) fn dot<V: Lanes>(a: [Wide<V>; 3], b: [Wide<V>; 3]) -> Wide<V> {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]))
}
