//! TS-CAN (Liu, Fromm, Patel, McDuff 2020): a motion branch with channels shifted in time, gated by an appearance branch.
//!
//! A shifted channel is simply read from the neighbouring frame, so the shift costs nothing. Segments of `segment_frames`
//! do not see each other.

use heartian_ops::activation::{logistic, tanh};
use heartian_ops::{Extent, Filter, FrameMut, PairScratch, PairedConvolution, Strip, Volume, Windows, linear};
use rayon::prelude::*;

use super::Trace;
use crate::parts::{Affine, Parts};
use crate::{Architecture, Batch, DecoderError, InputForm, Options, SegmentEdge};

/// Frames run together: enough to share among threads, few enough to stay in cache.
const GROUP_FRAMES: usize = 40;
/// Hidden units of the last layers.
const HIDDEN: usize = 128;

/// Two convolutions of each branch and the gate.
#[derive(Debug)]
struct Stage {
    motion: [PairedConvolution; 2],
    appearance: [PairedConvolution; 2],
    gate: Affine,
}

/// The network.
#[derive(Debug)]
pub struct TsCan {
    stages: [Stage; 2],
    hidden: Affine,
    last: Affine,
    segment: usize,
    edge: SegmentEdge,
}

impl Stage {
    fn new(parts: &Parts<'_>, index: usize, inputs: usize, width: usize) -> Result<Self, DecoderError> {
        let pair = |branch: &str| -> Result<[PairedConvolution; 2], DecoderError> {
            let layer = |place: usize, inputs: usize| {
                let affine =
                    parts.affine(&format!("{branch}_conv{}", 2 * index + place), &[width, inputs, 3, 3], true)?;
                affine.paired_rows(inputs)
            };
            Ok([layer(1, inputs)?, layer(2, width)?])
        };
        let gate = format!("apperance_att_conv{}", index + 1);
        Ok(Self {
            motion: pair("motion")?,
            appearance: pair("apperance")?,
            gate: parts.affine(&gate, &[1, width, 1, 1], true)?,
        })
    }
}

impl TsCan {
    /// Takes the weights apart; the frame size follows from the first dense layer.
    pub fn new(parts: Parts<'_>, options: &Options) -> Result<(Self, InputForm), DecoderError> {
        const SIDES: [usize; 4] = [36, 72, 96, 128];
        let stages = [Stage::new(&parts, 0, 3, 32)?, Stage::new(&parts, 1, 32, 64)?];
        let name = "final_dense_1.weight";
        let features = *parts.shape(name)?.get(1).unwrap_or(&0);
        let side_px = SIDES.into_iter().find(|side| 64 * last_side(*side).pow(2) == features).ok_or_else(|| {
            let expected = "[128, 3136], [128, 16384], [128, 30976] or [128, 57600] (frames of 36, 72, 96, 128 pixels)";
            parts.misshapen(name, expected, "give weights trained on one of these sizes")
        })?;
        let hidden = parts.affine("final_dense_1", &[HIDDEN, features], true)?;
        let last = parts.affine("final_dense_2", &[1, HIDDEN], true)?;
        parts.finish(|_| false)?;
        let segment = options.segment_frames;
        if !(1..=1000).contains(&segment) {
            let reason = "a segment has 1 to 1000 frames (10 in rPPG-Toolbox)".to_owned();
            return Err(DecoderError::Option { option: "segment_frames", value: segment.to_string(), reason });
        }
        let usual = Architecture::TsCan.usual_input();
        let frames = usual.frames.next_multiple_of(segment);
        let input = InputForm { side_px, frame_multiple: segment, frames, ..usual };
        Ok((Self { stages, hidden, last, segment, edge: options.segment_edge }, input))
    }

    /// All chunks of a checked batch.
    pub fn run(&self, batch: &Batch<'_>, form: &InputForm, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        let group = (GROUP_FRAMES / self.segment).max(1) * self.segment;
        let mut out = Vec::with_capacity(batch.chunks * batch.frames);
        for chunk in 0..batch.chunks {
            let mut first = 0;
            while first < batch.frames {
                let frames = group.min(batch.frames - first);
                let [motion, appearance] =
                    [0, 1].map(|branch| branch_volume(batch, form, [chunk, branch], first, frames));
                out.extend(self.group(motion?, appearance?, trace)?);
                first += frames;
            }
        }
        Ok(out)
    }

    fn group(&self, mut motion: Volume, mut appearance: Volume, trace: &mut Trace) -> Result<Vec<f32>, DecoderError> {
        for (index, stage) in self.stages.iter().enumerate() {
            let gated;
            (gated, appearance, motion) = self.stage(stage, &motion, &appearance)?;
            trace.note(|| format!("tap_g{}", index + 1), || gated);
            if index == 0 {
                trace.note(|| "tap_d3".to_owned(), || frames_first(&motion));
            }
        }
        let features = frames_first(&motion);
        let rows = motion.extent().frames;
        let depth = features.len() / rows;
        let mut hidden = vec![0.0; rows * HIDDEN];
        let filter = Filter { weights: &self.hidden.weights, bias: &self.hidden.bias };
        hidden
            .par_chunks_mut(HIDDEN * 20)
            .zip(features.par_chunks(depth * 20))
            .try_for_each(|(out, rows)| linear(rows, filter, out, [rows.len() / depth, HIDDEN, depth]))?;
        tanh(&mut hidden);
        let mut out = vec![0.0; rows];
        let filter = Filter { weights: &self.last.weights, bias: &self.last.bias };
        linear(&hidden, filter, &mut out, [rows, 1, HIDDEN])?;
        Ok(out)
    }

    /// The frame that channel `c` of `channels` is read from: one third from the next frame, one third from the last.
    fn shifted(&self, t: usize, c: usize, channels: usize) -> Option<usize> {
        let (fold, place) = (channels / 3, t % self.segment);
        let edge = (self.edge == SegmentEdge::Replicate).then_some(t);
        match c / fold {
            0 if place + 1 == self.segment => edge,
            0 => Some(t + 1),
            1 if place == 0 => edge,
            1 => Some(t - 1),
            _ => Some(t),
        }
    }

    /// Gates, pooled appearance, pooled and gated motion.
    fn stage(
        &self,
        stage: &Stage,
        motion: &Volume,
        appearance: &Volume,
    ) -> Result<(Vec<f32>, Volume, Volume), DecoderError> {
        let extent = motion.extent();
        let (channels, width) = (extent.channels, stage.gate.weights.len());
        let wide = Extent { channels: width, ..extent };
        let side = extent.height - 2;
        let pooled = Extent { height: side / 2, width: side / 2, ..wide };

        let whole = Sides { before: [1, 1], output: [extent.height; 2] };
        let inside = Sides { before: [0, 0], output: [side; 2] };

        let mut inner = Volume::zeros(wide, 0);
        let frames = inner.par_frames_mut();
        convolve(
            &stage.appearance[0],
            appearance,
            whole,
            |t, _| Some(t),
            frames,
            |strip, out| copy_rows(strip, width, out),
        )?;
        let mut gates = vec![0.0f32; extent.frames * side * side];
        let mut seen = Volume::zeros(pooled, 1);
        let frames = seen.par_frames_mut().zip(gates.par_chunks_mut(side * side));
        convolve(
            &stage.appearance[1],
            &inner,
            inside,
            |t, _| Some(t),
            frames,
            |strip, (out, gate)| {
                gate_rows(strip, &stage.gate, &mut gate[strip_rows(strip, side)]);
                average_rows(strip, width, None, out);
            },
        )?;
        gates.par_chunks_mut(side * side).for_each(normalise_gate);

        let frames = inner.par_frames_mut();
        let source = |t, c| self.shifted(t, c, channels);
        convolve(&stage.motion[0], motion, whole, source, frames, |strip, out| copy_rows(strip, width, out))?;
        let mut moved = Volume::zeros(pooled, 1);
        let frames = moved.par_frames_mut().zip(gates.par_chunks(side * side));
        let source = |t, c| self.shifted(t, c, width);
        convolve(&stage.motion[1], &inner, inside, source, frames, |strip, (out, gate)| {
            average_rows(strip, width, Some(&gate[strip_rows(strip, side)]), out);
        })?;
        Ok((gates, seen, moved))
    }
}

/// Padding and size of a layer's output.
#[derive(Clone, Copy)]
struct Sides {
    before: [usize; 2],
    output: [usize; 2],
}

/// Convolves and applies tanh, frame by frame in parallel; channel `c` of frame `t` is read from frame `source(t, c)`.
fn convolve<T: Send>(
    convolution: &PairedConvolution,
    input: &Volume,
    Sides { before, output }: Sides,
    source: impl Fn(usize, usize) -> Option<usize> + Sync,
    outputs: impl IndexedParallelIterator<Item = T>,
    finish: impl Fn(&mut Strip<'_>, &mut T) + Sync,
) -> Result<(), DecoderError> {
    outputs.enumerate().try_for_each_init(PairScratch::default, |scratch, (t, mut out)| {
        let windows = Windows { before, output, source: |c, _| source(t, c) };
        convolution.frame(input, &windows, scratch, |strip| {
            strip.each(tanh);
            finish(strip, &mut out);
        })
    })?;
    Ok(())
}

fn copy_rows(strip: &mut Strip<'_>, channels: usize, out: &mut FrameMut<'_>) {
    for c in 0..channels {
        for r in 0..strip.rows {
            out.row_mut(c, strip.first_row + r).copy_from_slice(strip.row(c, r));
        }
    }
}

/// Side of the last feature map for frames of `side`.
fn last_side(side: usize) -> usize {
    ((side - 2) / 2 - 2) / 2
}

/// Frames `first..first + frames` of one chunk's branch: channels 0–2 move, 3–5 show.
fn branch_volume(
    batch: &Batch<'_>,
    form: &InputForm,
    [chunk, branch]: [usize; 2],
    first: usize,
    frames: usize,
) -> Result<Volume, DecoderError> {
    let area = form.side_px * form.side_px;
    let mut dense = Vec::with_capacity(3 * frames * area);
    for c in 0..3 {
        let start = ((chunk * 6 + 3 * branch + c) * batch.frames + first) * area;
        dense.extend_from_slice(&batch.data[start..start + frames * area]);
    }
    let extent = Extent { frames, channels: 3, height: form.side_px, width: form.side_px };
    Ok(Volume::from_dense(extent, 1, &dense, false)?)
}

/// The strip's part of a dense `side × side` plane.
fn strip_rows(strip: &Strip<'_>, side: usize) -> std::ops::Range<usize> {
    strip.first_row * side..(strip.first_row + strip.rows) * side
}

/// σ(bias + Σ weight·channel) for each pixel of a strip.
fn gate_rows(strip: &mut Strip<'_>, gate: &Affine, out: &mut [f32]) {
    out.fill(gate.bias[0]);
    let width = strip.width;
    for (c, weight) in gate.weights.iter().enumerate() {
        for (r, out) in out.chunks_exact_mut(width).enumerate() {
            out.iter_mut().zip(&*strip.row(c, r)).for_each(|(out, value)| *out += weight * value);
        }
    }
    logistic(out);
}

/// Scales a frame's gates to a mean of one half.
fn normalise_gate(gate: &mut [f32]) {
    let sum: f64 = gate.iter().map(|v| f64::from(*v)).sum();
    let scale = (0.5 * gate.len() as f64 / sum) as f32;
    gate.iter_mut().for_each(|v| *v *= scale);
}

/// Means of 2 × 2 pixels, gated or not, into the output frame; an odd last row or column is dropped.
fn average_rows(strip: &mut Strip<'_>, channels: usize, gate: Option<&[f32]>, out: &mut FrameMut<'_>) {
    let (width, rows, first_row) = (strip.width, strip.rows, strip.first_row);
    for c in 0..channels {
        if let Some(gate) = gate {
            for (r, gate) in gate.chunks_exact(width).enumerate() {
                strip.row(c, r).iter_mut().zip(gate).for_each(|(value, gate)| *value *= gate);
            }
        }
        for r in 0..rows / 2 {
            let (upper, lower) = strip.two_rows(c, 2 * r);
            let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
            for (out, (a, b)) in out.row_mut(c, first_row / 2 + r).iter_mut().zip(pairs) {
                *out = 0.25 * ((a[0] + a[1]) + (b[0] + b[1]));
            }
        }
    }
}

/// The pixels of all frames, `frames × channels × height × width`.
fn frames_first(volume: &Volume) -> Vec<f32> {
    let Extent { frames, channels, height, .. } = volume.extent();
    let mut dense = Vec::with_capacity(volume.extent().values());
    for t in 0..frames {
        for c in 0..channels {
            (0..height).for_each(|y| dense.extend_from_slice(volume.row(t, c, y)));
        }
    }
    dense
}
