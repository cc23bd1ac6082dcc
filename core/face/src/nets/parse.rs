//! From the bytes of a TFLite file to a list of layers.
//!
//! Field numbers are those of TFLite's public schema. Half-float constants are widened and `DEQUANTIZE` / `DENSIFY` of
//! constants are folded here, so that the interpreter sees only `f32` layers.

use super::NetError;
use super::constant::{Constant, decode, element_count};
use super::flatbuffer::Table;
use super::op::{Kind, kind_of};

/// One layer.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    pub kind: Kind,
    /// Tensor numbers; an absent optional input is `None`.
    pub inputs: Vec<Option<usize>>,
    pub output: usize,
}

/// A network ready to run.
#[derive(Clone, Debug)]
pub struct Net {
    pub(super) shapes: Vec<Vec<usize>>,
    pub(super) constants: Vec<Option<Constant>>,
    pub(super) layers: Vec<Layer>,
    pub(super) inputs: Vec<usize>,
    pub(super) outputs: Vec<usize>,
    /// The last layer that reads each tensor; `usize::MAX` keeps it to the end.
    pub(super) last_use: Vec<usize>,
}

impl Net {
    /// Reads a TFLite file.
    ///
    /// # Errors
    /// When the bytes are damaged, or the model uses a layer this interpreter lacks.
    pub fn parse(bytes: &[u8]) -> Result<Self, NetError> {
        if bytes.get(4..8) != Some(b"TFL3") {
            return Err(NetError::Malformed("the file does not carry TFLite's mark"));
        }
        let model = Table::root(bytes)?;
        let codes = model.tables(1)?;
        let buffers = model.tables(4)?;
        let graph = model.tables(2)?.into_iter().next().ok_or(NetError::Malformed("it has no graph"))?;
        let (mut shapes, mut constants) = (Vec::new(), Vec::new());
        for tensor in graph.tables(0)? {
            let shape: Vec<usize> =
                tensor.ints(0)?.into_iter().map(|size| usize::try_from(size).unwrap_or(usize::MAX)).collect();
            element_count(&shape)?;
            let buffer = usize::try_from(tensor.int(2, 0)?).ok().and_then(|i| buffers.get(i));
            let bytes = buffer.ok_or(NetError::Malformed("a tensor has no buffer"))?.bytes(0)?;
            constants.push(if bytes.is_empty() { None } else { decode(tensor.byte(1, 0)?, &shape, bytes, &tensor)? });
            shapes.push(shape);
        }
        let index = |i: i32| usize::try_from(i).ok().filter(|i| *i < shapes.len());
        let listed = |list: Vec<i32>| -> Result<Vec<usize>, NetError> {
            list.into_iter().map(|i| index(i).ok_or(NetError::Malformed("a tensor number is out of range"))).collect()
        };
        let mut layers = Vec::new();
        for operator in graph.tables(3)? {
            let code = usize::try_from(operator.int(0, 0)?).ok().and_then(|i| codes.get(i));
            let kind = kind_of(code.ok_or(NetError::Malformed("a layer has no kind"))?, &operator)?;
            let inputs: Vec<Option<usize>> = operator.ints(1)?.into_iter().map(index).collect();
            let output = *listed(operator.ints(2)?)?.first().ok_or(NetError::Malformed("a layer has no output"))?;
            // Constants were widened and made dense when read: these layers only pass them on.
            if kind == Kind::Pass
                && let Some(Some(constant)) = inputs.first().copied().flatten().and_then(|i| constants.get(i)).cloned()
            {
                constants[output] = Some(constant);
                continue;
            }
            layers.push(Layer { kind, inputs, output });
        }
        let (inputs, outputs) = (listed(graph.ints(1)?)?, listed(graph.ints(2)?)?);
        let mut last_use = vec![0; shapes.len()];
        for (number, layer) in layers.iter().enumerate() {
            layer.inputs.iter().flatten().for_each(|&tensor| last_use[tensor] = number);
        }
        outputs.iter().for_each(|&tensor| last_use[tensor] = usize::MAX);
        Ok(Self { shapes, constants, layers, inputs, outputs, last_use })
    }

    /// Declared shape of the only input.
    ///
    /// # Errors
    /// When the network does not have exactly one.
    pub fn input_shape(&self) -> Result<&[usize], NetError> {
        match self.inputs[..] {
            [input] => Ok(&self.shapes[input]),
            _ => Err(NetError::Malformed("it does not have exactly one input")),
        }
    }
}
