//! Networks with seeded weights of the published sizes, so that their speed can be measured without any file, and the
//! arithmetic each of them is bound by.

use std::time::Instant;

use crate::{Architecture, Batch, DecoderError, Network, Options, Tensor, Weights};

/// What one network took.
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// The network.
    pub architecture: Architecture,
    /// Samples a chunk.
    pub frames: usize,
    /// Height and width of a frame.
    pub side_px: usize,
    /// Wall time of every run, seconds a chunk.
    pub seconds: Vec<f64>,
    /// Multiplications and additions of a chunk's convolutions and products as defined, in 10⁹.
    pub gflop: f64,
}

impl Timing {
    /// The shortest run.
    pub fn best_seconds(&self) -> f64 {
        self.seconds.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// The middle run.
    pub fn median_seconds(&self) -> f64 {
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
    }
}

/// Seeded weights of an architecture at its published size, in memory.
///
/// # Errors
/// Never for the architectures of this crate; the type is that of any weights.
pub fn seeded_weights(architecture: Architecture) -> Result<Weights, DecoderError> {
    let mut state = 1u64;
    let tensors = shapes(architecture).into_iter().map(|(name, shape)| {
        let count: usize = shape.iter().product();
        let fan_in: usize = shape.iter().skip(1).product();
        let (centre, spread) = match name.rsplit('.').next() {
            Some("running_var") => (1.0, 0.0),
            Some("weight") if shape.len() == 1 => (1.0, 0.1),
            Some("weight") => (0.0, (3.0 / fan_in as f32).sqrt()),
            _ => (0.0, 0.05),
        };
        let data = (0..count)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                centre + spread * ((state >> 40) as f32 / 8_388_608.0 - 1.0)
            })
            .collect();
        (name, Tensor { shape, data })
    });
    Weights::from_tensors(tensors.collect::<Vec<_>>())
}

/// Runs a network `runs` times on one seeded chunk of its usual length, after one run that is not counted.
///
/// # Errors
/// When the network refuses its own form of input, which would be a fault of this crate.
pub fn time(network: &Network, runs: usize) -> Result<Timing, DecoderError> {
    let form = network.input().clone();
    let values: Vec<f32> =
        (0..form.chunk_len(form.frames)).map(|i| (i as f32 * 0.37).sin() + (i as f32 * 1e-4).cos()).collect();
    let batch = Batch::one(&values, form.frames);
    network.run(batch)?;
    let mut seconds = Vec::with_capacity(runs);
    for _ in 0..runs {
        let start = Instant::now();
        std::hint::black_box(network.run(batch)?);
        seconds.push(start.elapsed().as_secs_f64());
    }
    let architecture = network.architecture();
    let gflop = gflop(architecture, form.frames, form.side_px);
    Ok(Timing { architecture, frames: form.frames, side_px: form.side_px, seconds, gflop })
}

/// [`time`] for all four networks with seeded weights.
///
/// # Errors
/// As [`time`].
pub fn time_all(runs: usize) -> Result<Vec<Timing>, DecoderError> {
    Architecture::ALL
        .into_iter()
        .map(|architecture| time(&Network::new(&seeded_weights(architecture)?, &Options::default())?, runs))
        .collect()
}

/// 10⁹ operations of a chunk at the published size, from the layers' definitions (two a multiply-add).
fn gflop(architecture: Architecture, frames: usize, side: usize) -> f64 {
    let layer = |pixels: usize, inputs: usize, outputs: usize, taps: usize| (pixels * inputs * outputs * taps) as f64;
    let multiplications = match architecture {
        Architecture::TsCan => {
            let (a, b) = (side - 2, (side - 2) / 2);
            let convolutions = layer(side * side, 3, 32, 9)
                + layer(a * a, 32, 32, 9)
                + layer(b * b, 32, 64, 9)
                + layer((b - 2) * (b - 2), 64, 64, 9);
            frames as f64 * (2.0 * convolutions + layer(((b - 2) / 2).pow(2), 64, 128, 1))
        }
        Architecture::PhysFormer => {
            let tokens = frames * 4;
            let stems = layer(128 * 128, 3, 24, 25) + layer(64 * 64, 24, 48, 27) + layer(32 * 32, 48, 96, 27);
            let block = layer(tokens, 96, 96, 2 * 27 + 2) + layer(tokens, 96, 144, 2) + layer(tokens, tokens, 96, 2);
            frames as f64 * stems + layer(tokens, 96, 96, 64) + 12.0 * block
        }
        Architecture::FactorizePhys => {
            let rows = [(72, 3, 8), (35, 8, 12), (33, 12, 12), (31, 12, 12), (15, 12, 16), (13, 16, 16)];
            let more = [(11, 16, 16), (9, 16, 16), (7, 16, 16), (5, 16, 12), (3, 12, 8), (1, 8, 1)];
            rows.iter().chain(&more).map(|(side, i, o)| layer(frames * side * side, *i, *o, 27)).sum()
        }
        Architecture::PhysNet => {
            let at = |level: usize| (side >> level) * (side >> level);
            layer(frames * at(0), 3, 16, 25)
                + layer(frames * at(1), 16, 32, 27)
                + layer(frames * at(1), 32, 64, 27)
                + layer(frames / 2 * at(2), 64, 64, 2 * 27)
                + layer(frames / 4 * at(3), 64, 64, 2 * 27)
                + layer(frames / 4 * at(4), 64, 64, 2 * 27)
                + layer(3 * frames / 2 * at(4), 64, 64, 2)
        }
    };
    2e-9 * multiplications
}

/// The largest rate of the matrix product on all threads at once, 10⁹ operations a second: a network's [`Timing::gflop`]
/// over it is the time below which no direct evaluation can come (pairing saves up to a third of the multiplications).
///
/// # Errors
/// Never: the sizes agree.
pub fn product_gflops() -> Result<f64, DecoderError> {
    use heartian_ops::{Filter, linear};
    const SIDE: usize = 384;
    const ROUNDS: usize = 8;
    let values: Vec<f32> = (0..SIDE * SIDE).map(|i| (i % 17) as f32).collect();
    let rates = rayon::broadcast(|_| -> Result<f64, DecoderError> {
        let mut out = vec![0.0; SIDE * SIDE];
        let mut best = f64::INFINITY;
        for _ in 0..ROUNDS {
            let start = Instant::now();
            linear(&values, Filter { weights: &values, bias: &[] }, &mut out, [SIDE; 3])?;
            best = best.min(start.elapsed().as_secs_f64());
        }
        std::hint::black_box(out);
        Ok(2e-9 * (SIDE as f64).powi(3) / best)
    });
    rates.into_iter().sum()
}

/// Names and shapes of all tensors at the published size.
fn shapes(architecture: Architecture) -> Vec<(String, Vec<usize>)> {
    let mut list = Shapes(Vec::new());
    match architecture {
        Architecture::TsCan => {
            for (branch, layers) in [("motion", 4), ("apperance", 4)] {
                for (index, (inputs, outputs)) in
                    [(3, 32), (32, 32), (32, 64), (64, 64)].into_iter().enumerate().take(layers)
                {
                    list.affine(&format!("{branch}_conv{}", index + 1), &[outputs, inputs, 3, 3]);
                }
            }
            list.affine("apperance_att_conv1", &[1, 32, 1, 1]);
            list.affine("apperance_att_conv2", &[1, 64, 1, 1]);
            list.affine("final_dense_1", &[128, 16384]);
            list.affine("final_dense_2", &[1, 128]);
        }
        Architecture::PhysFormer => list.physformer(),
        Architecture::FactorizePhys => list.factorizephys(),
        Architecture::PhysNet => {
            let sizes = [(16, 3), (32, 16), (64, 32)].into_iter().chain([(64, 64); 6]);
            for (index, (outputs, inputs)) in sizes.enumerate() {
                let kernel = if index == 0 { [1, 5, 5] } else { [3; 3] };
                list.affine(&format!("ConvBlock{}.0", index + 1), &[outputs, inputs, kernel[0], kernel[1], kernel[2]]);
                list.norm(&format!("ConvBlock{}.1", index + 1), outputs);
            }
            for name in ["upsample", "upsample2"] {
                list.affine(&format!("{name}.0"), &[64, 64, 4, 1, 1]);
                list.norm(&format!("{name}.1"), 64);
            }
            list.affine("ConvBlock10", &[1, 64, 1, 1, 1]);
        }
    }
    list.0
}

struct Shapes(Vec<(String, Vec<usize>)>);

impl Shapes {
    fn weight(&mut self, name: &str, shape: &[usize]) {
        self.0.push((format!("{name}.weight"), shape.to_vec()));
    }

    fn affine(&mut self, name: &str, shape: &[usize]) {
        self.weight(name, shape);
        self.0.push((format!("{name}.bias"), vec![shape[0]]));
    }

    fn norm(&mut self, name: &str, channels: usize) {
        self.0.extend(
            ["weight", "bias", "running_mean", "running_var"].map(|part| (format!("{name}.{part}"), vec![channels])),
        );
    }

    fn physformer(&mut self) {
        for (index, (outputs, inputs, kernel)) in
            [(24, 3, [1, 5, 5]), (48, 24, [3; 3]), (96, 48, [3; 3])].into_iter().enumerate()
        {
            self.affine(&format!("Stem{index}.0"), &[outputs, inputs, kernel[0], kernel[1], kernel[2]]);
            self.norm(&format!("Stem{index}.1"), outputs);
        }
        self.affine("patch_embedding", &[96, 96, 4, 4, 4]);
        for (transformer, block) in (0..12).map(|i| (i / 4 + 1, i % 4)) {
            let name = format!("transformer{transformer}.blocks.{block}");
            for which in ["q", "k"] {
                self.weight(&format!("{name}.attn.proj_{which}.0.conv"), &[96, 96, 3, 3, 3]);
                self.norm(&format!("{name}.attn.proj_{which}.1"), 96);
            }
            self.weight(&format!("{name}.attn.proj_v.0"), &[96, 96, 1, 1, 1]);
            self.affine(&format!("{name}.proj"), &[96, 96]);
            self.affine(&format!("{name}.norm1"), &[96]);
            self.affine(&format!("{name}.norm2"), &[96]);
            for (layer, shape) in [("fc1", [144, 96, 1]), ("STConv", [144, 1, 3]), ("fc2", [96, 144, 1])] {
                self.weight(&format!("{name}.pwff.{layer}.0"), &[shape[0], shape[1], shape[2], shape[2], shape[2]]);
                self.norm(&format!("{name}.pwff.{layer}.1"), shape[0]);
            }
        }
        for (name, outputs) in [("upsample", 96), ("upsample2", 48)] {
            self.affine(&format!("{name}.1"), &[outputs, 96, 3, 1, 1]);
            self.norm(&format!("{name}.2"), outputs);
        }
        self.affine("ConvBlockLast", &[1, 48, 1]);
    }

    fn factorizephys(&mut self) {
        let convolution = |name: &str| format!("{name}.conv_block_3d.0");
        for (index, inputs, outputs) in [(0, 3, 8), (1, 8, 12), (2, 12, 12), (4, 12, 12), (5, 12, 16), (6, 16, 16)] {
            let name = format!("rppg_feature_extractor.FeatureExtractor.{index}");
            self.weight(&convolution(&name), &[outputs, inputs, 3, 3, 3]);
        }
        for index in 0..3 {
            self.weight(&convolution(&format!("rppg_head.conv_block.{index}")), &[16, 16, 3, 3, 3]);
        }
        self.weight(&convolution("rppg_head.final_layer.0"), &[12, 16, 3, 3, 3]);
        self.weight(&convolution("rppg_head.final_layer.1"), &[8, 12, 3, 3, 3]);
        self.weight("rppg_head.final_layer.2", &[1, 8, 3, 3, 3]);
        self.affine("rppg_head.fsam.pre_conv_block.0", &[8, 16, 1, 1, 1]);
        self.weight("rppg_head.fsam.post_conv_block.0.conv", &[8, 8, 1, 1, 1]);
        self.weight("rppg_head.fsam.post_conv_block.1", &[16, 8, 1, 1, 1]);
    }
}
