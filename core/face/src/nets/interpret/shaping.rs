//! The layers that move numbers about or resample them: concatenation, reshaping, padding, resizing, means.

use heartian_ops::{Sampling, resize_bilinear};

use super::{Problem, Run, Tensor, activated, blank, map_mut, wrong};
use crate::nets::constant::{MOST_ELEMENTS, element_count};
use crate::nets::op::Activation;
use crate::nets::parse::Layer;

impl Run<'_> {
    pub(super) fn concat(&self, layer: &Layer, axis: i32, then: Activation) -> Result<Tensor, Problem> {
        let mut shape = self.view(layer, 0)?.0.to_vec();
        let rank = shape.len();
        let axis = if axis < 0 { rank.wrapping_sub(axis.unsigned_abs() as usize) } else { axis as usize };
        if axis >= rank {
            return wrong("the axis is out of range");
        }
        let parts = (0..layer.inputs.len()).map(|i| self.view(layer, i)).collect::<Result<Vec<_>, _>>()?;
        shape[axis] = 0;
        for (part, _) in &parts {
            if part.len() != rank || (0..rank).any(|i| i != axis && part[i] != shape[i]) {
                return wrong("the parts' shapes differ beside the axis");
            }
            shape[axis] = shape[axis].saturating_add(part[axis]);
        }
        let mut data = Vec::with_capacity(element_count(&shape)?);
        let (outer, inner) = (element_count(&shape[..axis])?, element_count(&shape[axis + 1..])?);
        for i in 0..outer {
            for (part, values) in &parts {
                let run = part[axis] * inner;
                data.extend_from_slice(&values[i * run..(i + 1) * run]);
            }
        }
        Ok(activated(Tensor { shape, data }, then))
    }

    pub(super) fn depth_to_space(&self, layer: &Layer, block: usize) -> Result<Tensor, Problem> {
        let input = self.map(layer, 0)?;
        let channels = input.channels / (block * block);
        if channels * block * block != input.channels {
            return wrong("the channels do not divide into blocks");
        }
        let mut output = blank([input.height * block, input.width * block, channels])?;
        let width = input.width * block;
        for (i, pixel) in output.data.chunks_exact_mut(channels.max(1)).enumerate() {
            let (y, x) = (i / width, i % width);
            let from =
                ((y / block) * input.width + x / block) * input.channels + (y % block * block + x % block) * channels;
            pixel.copy_from_slice(&input.data[from..from + channels]);
        }
        Ok(output)
    }

    pub(super) fn resize(&self, layer: &Layer, align_corners: bool, half_pixel: bool) -> Result<Tensor, Problem> {
        let input = self.map(layer, 0)?;
        let &[height, width] = self.ints(layer, 1)? else { return wrong("the size is not two numbers") };
        let size = [height, width].map(|side| usize::try_from(side).unwrap_or(usize::MAX));
        let mut output = blank([size[0], size[1], input.channels])?;
        let sampling = match (align_corners, half_pixel) {
            (true, _) => Sampling::AlignedCorners,
            (_, true) => Sampling::HalfPixel,
            _ => Sampling::Corner,
        };
        resize_bilinear(input, sampling, map_mut(&mut output, size, input.channels))?;
        Ok(output)
    }

    /// Mean over the two image axes: the only form these networks use.
    pub(super) fn mean(&self, layer: &Layer) -> Result<Tensor, Problem> {
        let input = self.map(layer, 0)?;
        if self.ints(layer, 1)? != [1, 2] || input.data.is_empty() {
            return wrong("only a mean over height and width is implemented");
        }
        let mut sums = vec![0.0f64; input.channels];
        for pixel in input.data.chunks_exact(input.channels) {
            sums.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += f64::from(*value));
        }
        let count = (input.height * input.width) as f64;
        let data = sums.into_iter().map(|sum| (sum / count) as f32).collect();
        Ok(Tensor { shape: vec![1, 1, 1, input.channels], data })
    }

    pub(super) fn reshape(&mut self, number: usize, layer: &Layer) -> Result<Tensor, Problem> {
        let shape = self.net.shapes[layer.output].clone();
        let mut value = self.take(number, layer, 0)?;
        if element_count(&shape)? != value.data.len() {
            return wrong("the new shape has another number of elements");
        }
        value.shape = shape;
        Ok(value)
    }

    pub(super) fn pad(&self, layer: &Layer) -> Result<Tensor, Problem> {
        let input = self.map(layer, 0)?;
        let pads = self.ints(layer, 1)?;
        let pads: Vec<usize> = pads.iter().map(|pad| usize::try_from(*pad).unwrap_or(MOST_ELEMENTS)).collect();
        let &[0, 0, top, bottom, left, right, front, back] = pads.as_slice() else {
            return wrong("the padding is not four pairs with none on the batch");
        };
        let size = [input.height, input.width, input.channels];
        let padded = [size[0] + top + bottom, size[1] + left + right, size[2] + front + back];
        let mut output = blank(padded)?;
        if !input.data.is_empty() {
            for (i, pixel) in input.data.chunks_exact(input.channels).enumerate() {
                let (y, x) = (i / input.width + top, i % input.width + left);
                let at = (y * padded[1] + x) * padded[2] + front;
                output.data[at..at + input.channels].copy_from_slice(pixel);
            }
        }
        Ok(output)
    }
}
