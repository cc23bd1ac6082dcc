//! Lane code: one small trait over a vector of f32, instantiated for the instruction sets that are chosen at run time.
//!
//! What always holds: every operation is element-wise IEEE f32 (fused only where the instruction set says `FUSED`), so
//! a kernel gives the same bits on every thread of one machine. Comparisons with NaN are false. The environment
//! variable `HEARTIAN_SIMD=baseline|avx2|avx512` forces a level (never one that the machine lacks).

use std::sync::OnceLock;

mod array;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
pub(crate) mod wide;

pub(crate) use array::Array;
#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;
#[cfg(target_arch = "x86_64")]
pub(crate) use avx512::Avx512;

/// Longest vector of any level; tiles are padded by this many columns.
pub(crate) const MAX_LANES: usize = 16;

/// Instruction set that the kernels run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum SimdLevel {
    /// Portable lane code, whatever the build's target guarantees.
    Baseline,
    /// AVX2 with FMA, eight lanes.
    Avx2,
    /// AVX-512 F/BW/DQ/VL, sixteen lanes.
    Avx512,
}

impl SimdLevel {
    /// Values that one vector holds.
    pub const fn lanes(self) -> usize {
        match self {
            Self::Baseline | Self::Avx2 => 8,
            Self::Avx512 => 16,
        }
    }
}

/// The level in use: the best this machine has, or what `HEARTIAN_SIMD` asks for. Chosen once.
pub fn simd_level() -> SimdLevel {
    #[cfg(test)]
    if let Some(level) = FORCED.get() {
        return level;
    }
    static LEVEL: OnceLock<SimdLevel> = OnceLock::new();
    *LEVEL.get_or_init(|| {
        let best = best_level();
        match std::env::var("HEARTIAN_SIMD").as_deref() {
            Ok("baseline") => SimdLevel::Baseline,
            Ok("avx2") => best.min(SimdLevel::Avx2),
            _ => best,
        }
    })
}

#[cfg(test)]
thread_local! {
    /// A level that a test asks for on its thread; one that the machine has.
    pub(crate) static FORCED: std::cell::Cell<Option<SimdLevel>> = const { std::cell::Cell::new(None) };
}

#[cfg(target_arch = "x86_64")]
fn best_level() -> SimdLevel {
    let avx512 = is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512vl");
    match is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        true if avx512 => SimdLevel::Avx512,
        true => SimdLevel::Avx2,
        false => SimdLevel::Baseline,
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn best_level() -> SimdLevel {
    SimdLevel::Baseline
}

/// What [`Lanes::exp2`] computes with: its least argument, 1.5·2²³, and the Chebyshev interpolation of 2^f on [−½, ½] from
/// the fifth power down, relative error 1.0e-7 before rounding.
pub(crate) const EXP2: [f32; 8] =
    [-126.0, 12_582_912.0, 1.339_086_3e-3, 9.676_032e-3, 5.550_357e-2, 2.402_210_7e-1, 6.931_472e-1, 1.000_000_1];

/// [`EXP2`], each constant in all lanes.
#[derive(Clone, Copy)]
pub(crate) struct Exp2<V: Lanes>([V; 8]);

impl<V: Lanes> Exp2<V> {
    /// From [`EXP2`]; a loop that lacks registers hides the constants from the compiler (`black_box`), which then keeps
    /// vectors on the stack instead of filling a register with each anew.
    ///
    /// # Safety
    /// Inside a function with the features of `V`.
    #[inline(always)]
    pub unsafe fn new(constants: [f32; 8]) -> Self {
        let [a, b, c, d, e, f, g, h] = constants;
        // SAFETY: the caller's contract.
        unsafe {
            let (a, b, c, d) = (V::splat(a), V::splat(b), V::splat(c), V::splat(d));
            Self([a, b, c, d, V::splat(e), V::splat(f), V::splat(g), V::splat(h)])
        }
    }
}

/// A vector of `N` f32 values.
///
/// # Safety
/// Every method may use instructions of the level it is written for: call only from a function that carries that
/// level's `target_feature`, reached after [`simd_level`] reported it.
pub(crate) unsafe trait Lanes: Copy {
    /// Number of lanes.
    const N: usize;
    /// Result of a comparison.
    type Mask: Copy;
    /// Eight lanes of the level.
    type Eight: EightLanes;
    unsafe fn splat(value: f32) -> Self;
    /// Reads `N` values; the pointer need not be aligned.
    unsafe fn load(from: *const f32) -> Self;
    /// Writes `N` values; the pointer need not be aligned.
    unsafe fn store(self, to: *mut f32);
    unsafe fn add(self, other: Self) -> Self;
    unsafe fn sub(self, other: Self) -> Self;
    unsafe fn mul(self, other: Self) -> Self;
    unsafe fn div(self, other: Self) -> Self;
    unsafe fn sqrt(self) -> Self;
    unsafe fn floor(self) -> Self;
    /// `self·factor + addend`.
    unsafe fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// `addend − self·factor`.
    unsafe fn neg_mul_add(self, factor: Self, addend: Self) -> Self;
    unsafe fn min(self, other: Self) -> Self;
    unsafe fn max(self, other: Self) -> Self;
    /// Lane-wise `self ≥ other`.
    unsafe fn ge(self, other: Self) -> Self::Mask;
    /// Lane-wise `self < other`.
    unsafe fn lt(self, other: Self) -> Self::Mask;
    /// A bit for each lane, the first lane lowest.
    unsafe fn bits(mask: Self::Mask) -> u32;
    unsafe fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// `mask ? a : b`.
    unsafe fn select(mask: Self::Mask, a: Self, b: Self) -> Self;
    /// `mask ? self : 0`.
    unsafe fn keep(self, mask: Self::Mask) -> Self;
    /// `−|self|`.
    unsafe fn negative(self) -> Self;
    /// `self·2^n`, `self` near 1, where `shifted = n + 1.5·2²³` holds the integer `n` in its low mantissa bits.
    unsafe fn scale_exponent(self, shifted: Self) -> Self;
    /// Asks for a cache line that is read soon.
    unsafe fn prefetch(_from: *const f32) {}
    /// Splits a positive normal value into mantissa in [1, 2) and exponent.
    unsafe fn split_exponent(self) -> (Self, Self);
    /// Sum over lanes, always in the same order.
    unsafe fn sum(self) -> f32;
    /// Sums over lanes of eight vectors at once.
    #[inline(always)]
    unsafe fn sum_eight(vectors: [Self; 8]) -> [f32; 8] {
        // SAFETY: the caller's contract is this method's.
        unsafe { vectors.map(|vector| vector.sum()) }
    }

    #[inline(always)]
    unsafe fn zero() -> Self {
        // SAFETY: the caller's contract is this method's.
        unsafe { Self::splat(0.0) }
    }

    /// `2^self` for `self ≤ 127`, relative error below 2.4e-7 from −126 on; smaller values give about `2^−126`.
    #[inline(always)]
    unsafe fn exp2(self) -> Self {
        // SAFETY: the caller's contract is this method's.
        unsafe { self.exp2_by(&Exp2::new(EXP2)) }
    }

    /// [`Lanes::exp2`] with its constants held in vectors.
    #[inline(always)]
    unsafe fn exp2_by(self, by: &Exp2<Self>) -> Self {
        // SAFETY: the caller's contract is this method's.
        unsafe {
            let [least, magic, p5, p4, p3, p2, p1, p0] = by.0;
            let x = self.max(least);
            // Adding 1.5·2²³ leaves the nearest integer in the low mantissa bits.
            let shifted = x.add(magic);
            let f = x.sub(shifted.sub(magic));
            let p = p5.mul_add(f, p4).mul_add(f, p3).mul_add(f, p2).mul_add(f, p1).mul_add(f, p0);
            p.scale_exponent(shifted)
        }
    }

    /// `log2` of a positive normal value, absolute error below 3e-7 near 1 and relative below 3e-7 elsewhere.
    #[inline(always)]
    unsafe fn log2(self) -> Self {
        // SAFETY: the caller's contract is this method's.
        unsafe {
            let (mut m, mut e) = self.split_exponent();
            // Mantissa to [√½, √2) so that the series argument stays below 0.1716.
            let large = m.ge(Self::splat(std::f32::consts::SQRT_2));
            m = Self::select(large, m.mul(Self::splat(0.5)), m);
            e = e.add(Self::splat(1.0).keep(large));
            let one = Self::splat(1.0);
            let t = m.sub(one).div(m.add(one));
            let t2 = t.mul(t);
            // log2(m) = 2/ln2 · (t + t³/3 + t⁵/5 + …)
            let mut p = Self::splat(2.0 / 9.0 * std::f32::consts::LOG2_E);
            p = p.mul_add(t2, Self::splat(2.0 / 7.0 * std::f32::consts::LOG2_E));
            p = p.mul_add(t2, Self::splat(2.0 / 5.0 * std::f32::consts::LOG2_E));
            p = p.mul_add(t2, Self::splat(2.0 / 3.0 * std::f32::consts::LOG2_E));
            p = p.mul_add(t2, Self::splat(2.0 * std::f32::consts::LOG2_E));
            p.mul_add(t, e)
        }
    }
}

/// What needs exactly eight lanes.
///
/// # Safety
/// As [`Lanes`].
pub(crate) unsafe trait EightLanes: Lanes {
    /// For each lane a byte, the first lane's lowest, whose bit `k` says that some of the whole numbers `4k‥4k + 3` lie from
    /// `low` to `high`.
    unsafe fn fours(low: Self, high: Self) -> u64;
}

/// Runs a lane-generic function at the machine's level: `dispatch!(kernel, (C = 3), arguments…)` is written out by
/// each kernel module with this macro, which makes one `target_feature` wrapper a level.
macro_rules! dispatched {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident $([$(const $c:ident : usize),+])? ($($arg:ident : $ty:ty),* $(,)?) $(-> $ret:ty)? = $kernel:ident;) => {
        $(#[$doc])*
        $visibility fn $name $(<$(const $c: usize),+>)? ($($arg: $ty),*) $(-> $ret)? {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            unsafe fn avx2 $(<$(const $c: usize),+>)? ($($arg: $ty),*) $(-> $ret)? {
                // SAFETY: reached only where AVX2 and FMA were detected.
                unsafe { $kernel::<crate::lanes::Avx2 $($(, $c)+)?>($($arg),*) }
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma,avx512f,avx512bw,avx512dq,avx512vl")]
            unsafe fn avx512 $(<$(const $c: usize),+>)? ($($arg: $ty),*) $(-> $ret)? {
                // SAFETY: reached only where AVX-512 was detected.
                unsafe { $kernel::<crate::lanes::Avx512 $($(, $c)+)?>($($arg),*) }
            }
            match crate::lanes::simd_level() {
                // SAFETY: the level was detected on this machine.
                #[cfg(target_arch = "x86_64")]
                crate::lanes::SimdLevel::Avx2 => unsafe { avx2 $(::<$($c),+>)? ($($arg),*) },
                // SAFETY: the level was detected on this machine.
                #[cfg(target_arch = "x86_64")]
                crate::lanes::SimdLevel::Avx512 => unsafe { avx512 $(::<$($c),+>)? ($($arg),*) },
                // SAFETY: the portable lanes need nothing.
                _ => unsafe { $kernel::<crate::lanes::Array $($(, $c)+)?>($($arg),*) },
            }
        }
    };
}
pub(crate) use dispatched;

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    unsafe fn exp2_and_log2<V: Lanes>(x: &mut [f32], out: &mut [f32]) {
        for (x, out) in x.chunks_exact(V::N).zip(out.chunks_exact_mut(V::N)) {
            // SAFETY: both chunks hold N values.
            unsafe { V::load(x.as_ptr()).exp2().store(out.as_mut_ptr()) };
        }
        for (x, out) in x.chunks_exact_mut(V::N).zip(out.chunks_exact(V::N)) {
            // SAFETY: both chunks hold N values.
            unsafe { V::load(out.as_ptr()).log2().store(x.as_mut_ptr()) };
        }
    }
    dispatched! { fn both_ways(x: &mut [f32], out: &mut [f32]) = exp2_and_log2; }

    #[test]
    fn exponential_and_logarithm_hold_their_stated_error() {
        let exact: Vec<f32> = (0..4096).map(|i| -20.0 + 24.0 * i as f32 / 4096.0).collect();
        for portable in [false, true] {
            let (mut x, mut out) = (exact.clone(), vec![0.0; 4096]);
            if portable {
                // SAFETY: the portable lanes need nothing.
                unsafe { exp2_and_log2::<Array>(&mut x, &mut out) };
            } else {
                both_ways(&mut x, &mut out);
            }
            for ((e, o), back) in exact.iter().zip(&out).zip(&x) {
                let want = f64::from(*e).exp2();
                assert!((f64::from(*o) - want).abs() <= 2.4e-7 * want, "{e}: {o} {want}");
                assert!((back - e).abs() <= 3e-7 * e.abs().max(2.0), "{e}: {back}");
            }
        }
    }
}
