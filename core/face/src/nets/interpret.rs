//! Runs a network, layer by layer, on one thread.
//!
//! Shapes are derived from the actual inputs and checked before a layer runs. A tensor is dropped after its last
//! reader; element-wise layers write in place where they are that reader.

mod shaping;

use heartian_ops::{
    Filter, Map, MapMut, ShapeError, Window, activation, average_pool, conv2d, depthwise_conv2d, max_pool,
    transposed_conv2d,
};

use super::NetError;
use super::constant::{Constant, element_count};
use super::op::{Activation, Kind, Steps};
use super::parse::{Layer, Net};

/// A value travelling between layers: as many numbers as the product of its sizes.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Sizes, slowest first; images are `1 × height × width × channels`.
    pub shape: Vec<usize>,
    /// Values.
    pub data: Vec<f32>,
}

impl Net {
    /// Runs the network on its only input (`data` in the declared shape) and returns all outputs.
    ///
    /// # Errors
    /// When the input's length or a layer's shapes contradict each other.
    pub fn run(&self, data: Vec<f32>) -> Result<Vec<Tensor>, NetError> {
        let shape = self.input_shape()?.to_vec();
        let expected = element_count(&shape)?;
        if data.len() != expected {
            let reason = format!("{} values where {expected} were expected", data.len());
            return Err(NetError::Shape { layer: 0, kind: "input", reason });
        }
        let mut run = Run { net: self, values: vec![None; self.shapes.len()], scratch: Vec::new() };
        run.values[self.inputs[0]] = Some(Tensor { shape, data });
        for (number, layer) in self.layers.iter().enumerate() {
            let output = run.layer(number, layer).map_err(|problem| match problem {
                Problem::Shape(reason) => NetError::Shape { layer: number, kind: layer.kind.name(), reason },
                Problem::Net(error) => error,
            })?;
            run.values[layer.output] = Some(output);
            for tensor in layer.inputs.iter().flatten() {
                if self.last_use[*tensor] == number {
                    run.values[*tensor] = None;
                }
            }
        }
        let missing = || NetError::Malformed("an output is never computed");
        self.outputs.iter().map(|&tensor| run.values[tensor].take().ok_or_else(missing)).collect()
    }
}

/// Why a layer cannot run.
enum Problem {
    Shape(String),
    Net(NetError),
}

impl From<NetError> for Problem {
    fn from(error: NetError) -> Self {
        Self::Net(error)
    }
}

impl From<ShapeError> for Problem {
    fn from(error: ShapeError) -> Self {
        Self::Shape(error.to_string())
    }
}

fn wrong<T>(reason: &str) -> Result<T, Problem> {
    Err(Problem::Shape(reason.to_owned()))
}

struct Run<'a> {
    net: &'a Net,
    values: Vec<Option<Tensor>>,
    scratch: Vec<f32>,
}

impl Run<'_> {
    fn layer(&mut self, number: usize, layer: &Layer) -> Result<Tensor, Problem> {
        match layer.kind {
            Kind::Conv(steps, then) => self.conv(layer, steps, then),
            Kind::DepthwiseConv(steps, then) => self.depthwise(layer, steps, then),
            Kind::TransposedConvBias(steps) => self.transposed(layer, steps),
            Kind::MaxPool(steps, kernel, then) => self.pool(layer, steps, kernel, then, max_pool),
            Kind::AveragePool(steps, kernel, then) => self.pool(layer, steps, kernel, then, average_pool),
            Kind::FullyConnected(then) => self.fully_connected(layer, then),
            Kind::Add(then) => self.binary(number, layer, then, |a, b| a + b),
            Kind::Sub(then) => self.binary(number, layer, then, |a, b| a - b),
            Kind::Mul(then) => self.binary(number, layer, then, |a, b| a * b),
            Kind::Concat(axis, then) => self.concat(layer, axis, then),
            Kind::DepthToSpace(block) => self.depth_to_space(layer, block),
            Kind::ResizeBilinear { align_corners, half_pixel } => self.resize(layer, align_corners, half_pixel),
            Kind::Mean => self.mean(layer),
            Kind::Reshape => self.reshape(number, layer),
            Kind::Pad => self.pad(layer),
            Kind::Prelu => self.prelu(number, layer),
            Kind::Activate(then) => Ok(activated(self.take(number, layer, 0)?, then)),
            Kind::Logistic => self.in_place(number, layer, activation::logistic),
            Kind::HardSwish => self.in_place(number, layer, activation::hard_swish),
            Kind::Pass => self.take(number, layer, 0),
        }
    }

    fn number(layer: &Layer, input: usize) -> Result<usize, Problem> {
        layer.inputs.get(input).copied().flatten().map_or_else(|| wrong("an input is missing"), Ok)
    }

    /// An input's shape and values, computed or constant.
    fn view(&self, layer: &Layer, input: usize) -> Result<(&[usize], &[f32]), Problem> {
        let tensor = Self::number(layer, input)?;
        if let Some(value) = &self.values[tensor] {
            return Ok((&value.shape, &value.data));
        }
        match &self.net.constants[tensor] {
            Some(Constant::Floats(values)) => Ok((&self.net.shapes[tensor], values)),
            _ => wrong("an input is neither computed nor a float constant"),
        }
    }

    /// An input as a value of its own; moved, not copied, when this layer is its last reader.
    fn take(&mut self, number: usize, layer: &Layer, input: usize) -> Result<Tensor, Problem> {
        let tensor = Self::number(layer, input)?;
        let reads = layer.inputs.iter().filter(|other| **other == Some(tensor)).count();
        if self.net.last_use[tensor] == number
            && reads == 1
            && let Some(value) = self.values[tensor].take()
        {
            return Ok(value);
        }
        let (shape, data) = self.view(layer, input)?;
        Ok(Tensor { shape: shape.to_vec(), data: data.to_vec() })
    }

    fn ints(&self, layer: &Layer, input: usize) -> Result<&[i32], Problem> {
        match &self.net.constants[Self::number(layer, input)?] {
            Some(Constant::Ints(values)) => Ok(values),
            _ => wrong("an input is not an integer constant"),
        }
    }

    fn map(&self, layer: &Layer, input: usize) -> Result<Map<'_>, Problem> {
        match self.view(layer, input)? {
            (&[1, height, width, channels], data) => Ok(Map { height, width, channels, data }),
            (shape, _) => wrong(&format!("shape {shape:?} is not one image")),
        }
    }

    /// The bias at an input position; empty when absent.
    fn bias<'b>(&'b self, layer: &Layer, input: usize) -> Result<&'b [f32], Problem> {
        if layer.inputs.get(input).copied().flatten().is_none() { Ok(&[]) } else { Ok(self.view(layer, input)?.1) }
    }

    fn in_place(&mut self, number: usize, layer: &Layer, f: impl Fn(&mut [f32])) -> Result<Tensor, Problem> {
        let mut value = self.take(number, layer, 0)?;
        f(&mut value.data);
        Ok(value)
    }

    fn conv(&mut self, layer: &Layer, steps: Steps, then: Activation) -> Result<Tensor, Problem> {
        let mut scratch = std::mem::take(&mut self.scratch);
        let input = self.map(layer, 0)?;
        let (&[channels, kh, kw, depth], weights) = self.view(layer, 1)? else { return wrong("the filter is not 4-D") };
        if depth != input.channels {
            return wrong("the filter's depth is not the input's channels");
        }
        let (window, size) = place(steps, [kh, kw], &input)?;
        limit_work(&[size[0], size[1], channels, kh, kw, depth])?;
        let mut output = blank([size[0], size[1], channels])?;
        let filter = Filter { weights, bias: self.bias(layer, 2)? };
        conv2d(input, filter, window, map_mut(&mut output, size, channels), &mut scratch)?;
        self.scratch = scratch;
        Ok(activated(output, then))
    }

    fn depthwise(&self, layer: &Layer, steps: Steps, then: Activation) -> Result<Tensor, Problem> {
        let input = self.map(layer, 0)?;
        let (&[1, kh, kw, channels], weights) = self.view(layer, 1)? else {
            return wrong("the filter is not 1×h×w×c");
        };
        if channels != input.channels {
            return wrong("only a depth multiplier of 1 is supported");
        }
        let (window, size) = place(steps, [kh, kw], &input)?;
        limit_work(&[size[0], size[1], channels, kh, kw])?;
        let mut output = blank([size[0], size[1], channels])?;
        let filter = Filter { weights, bias: self.bias(layer, 2)? };
        depthwise_conv2d(input, filter, window, map_mut(&mut output, size, channels))?;
        Ok(activated(output, then))
    }

    fn transposed(&self, layer: &Layer, steps: Steps) -> Result<Tensor, Problem> {
        let input = self.map(layer, 0)?;
        let (&[channels, kh, kw, depth], weights) = self.view(layer, 1)? else { return wrong("the filter is not 4-D") };
        if depth != input.channels || input.data.is_empty() {
            return wrong("the filter's depth is not the input's channels");
        }
        let kernel = [kh, kw];
        let inside = [input.height, input.width];
        let mut before = [0; 2];
        let mut size = [0; 2];
        for axis in 0..2 {
            let (stride, kernel) = (steps.stride[axis], kernel[axis]);
            let total = if steps.same { kernel.saturating_sub((inside[axis] - 1) % stride + 1) } else { 0 };
            before[axis] = total / 2;
            size[axis] = (stride.saturating_mul(inside[axis] - 1)).saturating_add(kernel) - total;
        }
        limit_work(&[inside[0], inside[1], channels, kh, kw, depth])?;
        let mut output = blank([size[0], size[1], channels])?;
        let filter = Filter { weights, bias: self.bias(layer, 2)? };
        let window = Window { kernel, stride: steps.stride, dilation: [1, 1], before };
        transposed_conv2d(input, filter, window, map_mut(&mut output, size, channels))?;
        Ok(output)
    }

    fn pool(
        &self,
        layer: &Layer,
        steps: Steps,
        kernel: [usize; 2],
        then: Activation,
        pool: impl Fn(Map<'_>, Window, MapMut<'_>) -> Result<(), ShapeError>,
    ) -> Result<Tensor, Problem> {
        let input = self.map(layer, 0)?;
        let (window, size) = place(steps, kernel, &input)?;
        limit_work(&[size[0], size[1], input.channels, kernel[0], kernel[1]])?;
        let mut output = blank([size[0], size[1], input.channels])?;
        pool(input, window, map_mut(&mut output, size, input.channels))?;
        Ok(activated(output, then))
    }

    fn fully_connected(&mut self, layer: &Layer, then: Activation) -> Result<Tensor, Problem> {
        let mut scratch = std::mem::take(&mut self.scratch);
        let (_, data) = self.view(layer, 0)?;
        let (&[channels, depth], weights) = self.view(layer, 1)? else { return wrong("the weights are not 2-D") };
        if depth == 0 || !data.len().is_multiple_of(depth) {
            return wrong("the input does not divide into rows of the weights' depth");
        }
        let rows = data.len() / depth;
        limit_work(&[rows, channels, depth])?;
        let mut output = Tensor { shape: vec![rows, channels], data: vec![0.0; element_count(&[rows, channels])?] };
        let filter = Filter { weights, bias: self.bias(layer, 2)? };
        let input = Map { height: rows, width: 1, channels: depth, data };
        let window = Window::valid([1, 1], [1, 1], [1, 1]);
        conv2d(input, filter, window, map_mut(&mut output, [rows, 1], channels), &mut scratch)?;
        self.scratch = scratch;
        Ok(activated(output, then))
    }

    /// Element-wise; the right side may be a scalar, one value a channel, or of equal shape (and so may the left).
    fn binary(
        &mut self,
        number: usize,
        layer: &Layer,
        then: Activation,
        f: impl Fn(f32, f32) -> f32,
    ) -> Result<Tensor, Problem> {
        let (left, right) = (self.view(layer, 0)?.1.len(), self.view(layer, 1)?.1.len());
        let swap = left < right;
        let mut value = self.take(number, layer, usize::from(swap))?;
        let (shape, other) = self.view(layer, usize::from(!swap))?;
        let repeats = other.len() == value.data.len()
            || other.len() == 1
            || (value.shape.last() == Some(&other.len()) && shape.last() == Some(&other.len()));
        if !repeats || other.is_empty() {
            return wrong("this broadcast is not supported");
        }
        for chunk in value.data.chunks_exact_mut(other.len()) {
            if swap {
                chunk.iter_mut().zip(other).for_each(|(a, b)| *a = f(*b, *a));
            } else {
                chunk.iter_mut().zip(other).for_each(|(a, b)| *a = f(*a, *b));
            }
        }
        Ok(activated(value, then))
    }

    fn prelu(&mut self, number: usize, layer: &Layer) -> Result<Tensor, Problem> {
        let mut value = self.take(number, layer, 0)?;
        let (_, slopes) = self.view(layer, 1)?;
        if value.shape.last() != Some(&slopes.len()) {
            return wrong("the slopes are not one a channel");
        }
        activation::prelu(&mut value.data, slopes);
        Ok(value)
    }
}

/// The window over an input and the output's height and width.
fn place(steps: Steps, kernel: [usize; 2], input: &Map<'_>) -> Result<(Window, [usize; 2]), Problem> {
    let inside = [input.height, input.width];
    if kernel.contains(&0) {
        return wrong("the window is empty");
    }
    Ok(if steps.same {
        let size = [0, 1].map(|axis| inside[axis].div_ceil(steps.stride[axis]));
        (Window::same(kernel, steps.stride, steps.dilation, inside), size)
    } else {
        let window = Window::valid(kernel, steps.stride, steps.dilation);
        (window, window.valid_output(inside))
    })
}

/// Refuses a layer that would compute for minutes: no landmark network has one.
fn limit_work(sizes: &[usize]) -> Result<(), Problem> {
    let work = sizes.iter().try_fold(1usize, |product, &size| product.checked_mul(size));
    if work.is_some_and(|work| work <= 1 << 33) { Ok(()) } else { wrong("the layer is absurdly large") }
}

fn blank([height, width, channels]: [usize; 3]) -> Result<Tensor, Problem> {
    let shape = vec![1, height, width, channels];
    let count = element_count(&shape)?;
    Ok(Tensor { shape, data: vec![0.0; count] })
}

fn map_mut(tensor: &mut Tensor, [height, width]: [usize; 2], channels: usize) -> MapMut<'_> {
    MapMut { height, width, channels, data: &mut tensor.data }
}

fn activated(mut tensor: Tensor, then: Activation) -> Tensor {
    match then {
        Activation::None => {}
        Activation::Relu => activation::clamp(&mut tensor.data, 0.0, f32::INFINITY),
        Activation::ReluPlusMinusOne => activation::clamp(&mut tensor.data, -1.0, 1.0),
        Activation::Relu6 => activation::clamp(&mut tensor.data, 0.0, 6.0),
        Activation::Tanh => tensor.data.iter_mut().for_each(|value| *value = value.tanh()),
    }
    tensor
}
