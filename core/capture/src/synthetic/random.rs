//! Counter-based random numbers: a value depends on the seed, a stream and a counter alone, never on what was drawn
//! before, so frames can be made in any order on any number of threads.
//!
//! The mixing function is SplitMix64's finaliser (Steele, Lea and Flood 2014).

/// What a random number is for; different streams of one seed are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stream {
    Identity = 1,
    Motion,
    Speech,
    Blinks,
    Beats,
    Respiration,
    Contact,
    Landmarks,
    Dropouts,
    Texture,
    Sensor,
    Matte,
}

/// A seeded stream of random numbers addressed by counters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Random {
    key: u64,
}

impl Random {
    pub(crate) fn new(seed: u64, stream: Stream) -> Self {
        Self { key: mix(seed ^ mix((stream as u64) << 32)) }
    }

    /// A stream within this one, as for one frame or one landmark.
    pub(crate) fn substream(self, number: u64) -> Self {
        Self { key: mix(self.key ^ mix(number.wrapping_add(0x51_7c_c1_b7))) }
    }

    /// 64 random bits.
    pub(crate) fn bits(self, counter: u64) -> u64 {
        mix(self.key.wrapping_add(counter.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
    }

    /// Uniform in [0, 1).
    pub(crate) fn uniform(self, counter: u64) -> f64 {
        (self.bits(counter) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub(crate) fn between(self, counter: u64, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform(counter)
    }

    /// Standard normal (Box and Muller); one in two counters is used for the angle.
    pub(crate) fn normal(self, counter: u64) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform(2 * counter)).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform(2 * counter + 1)).cos()
    }

    /// Nearly normal with mean 0 and variance 1: the sum of four uniform 16-bit numbers. Cheap enough for each pixel;
    /// its tails end at 3.5.
    pub(crate) fn fast_normal(self, counter: u64) -> f32 {
        let bits = self.bits(counter);
        let sum = (bits & 0xffff) + (bits >> 16 & 0xffff) + (bits >> 32 & 0xffff) + (bits >> 48);
        // Four uniforms on [0, 1) have variance 4/12.
        (sum as f32 / 65_536.0 - (2.0 - 2.0 / 65_536.0)) * 1.732_050_8
    }
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Smooth noise in space: random values on an integer lattice, blended by quintic weights. In [−1, 1], period-free.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LatticeNoise {
    key: u32,
}

impl LatticeNoise {
    pub(crate) fn new(random: Random) -> Self {
        Self { key: (random.bits(0) >> 32) as u32 }
    }

    /// The noise at a point; neighbouring lattice points are 1 apart.
    pub(crate) fn at(self, point: glam::Vec3) -> f32 {
        let cell = point.floor();
        let fraction = point - cell;
        let blend = fraction * fraction * fraction * (fraction * (fraction * 6.0 - 15.0) + 10.0);
        let [x, y, z] = cell.to_array().map(|c| c as i32);
        let corner =
            |dx: i32, dy: i32, dz: i32| self.lattice(x.wrapping_add(dx), y.wrapping_add(dy), z.wrapping_add(dz));
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let row = |dy: i32, dz: i32| lerp(corner(0, dy, dz), corner(1, dy, dz), blend.x);
        lerp(lerp(row(0, 0), row(1, 0), blend.y), lerp(row(0, 1), row(1, 1), blend.y), blend.z)
    }

    /// `octaves` of noise, each twice as fine and half as strong, scaled to about [−1, 1].
    pub(crate) fn fractal(self, point: glam::Vec3, octaves: u32) -> f32 {
        let (mut sum, mut weight, mut scale) = (0.0, 0.0, 1.0);
        for octave in 0..octaves {
            sum += self.at(point * scale + glam::Vec3::splat(17.3 * octave as f32)) / scale;
            weight += 1.0 / scale;
            scale *= 2.0;
        }
        sum / weight
    }

    fn lattice(self, x: i32, y: i32, z: i32) -> f32 {
        let mut h = self.key
            ^ (x as u32).wrapping_mul(0x8da6_b343)
            ^ (y as u32).wrapping_mul(0xd816_3841)
            ^ (z as u32).wrapping_mul(0xcb1a_b31f);
        h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
        h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
        (h >> 8) as f32 / 8_388_608.0 - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_asked_for() {
        let random = Random::new(5, Stream::Sensor);
        let check = |draw: &dyn Fn(u64) -> f64| {
            let count = 200_000;
            let (mut mean, mut square, mut lagged, mut before) = (0.0, 0.0, 0.0, 0.0);
            for counter in 0..count {
                let value = draw(counter);
                mean += value / count as f64;
                square += value * value / count as f64;
                lagged += value * before / count as f64;
                before = value;
            }
            assert!(
                mean.abs() < 0.01 && (square - 1.0).abs() < 0.02 && lagged.abs() < 0.01,
                "{mean} {square} {lagged}"
            );
        };
        check(&|counter| random.normal(counter));
        check(&|counter| f64::from(random.fast_normal(counter)));
        check(&|counter| random.substream(counter).normal(0));
    }

    #[test]
    fn lattice_noise_is_continuous_and_bounded() {
        let noise = LatticeNoise::new(Random::new(1, Stream::Texture));
        let walk: Vec<f32> =
            (-4000..4000).map(|i| noise.fractal(glam::Vec3::new(i as f32 * 1e-3, 0.3, -0.7), 3)).collect();
        assert!(walk.iter().all(|v| v.abs() <= 1.0) && walk.iter().any(|v| v.abs() > 0.2));
        assert!(walk.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.02));
    }
}
