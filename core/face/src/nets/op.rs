//! The layer kinds of the landmark networks and how their options are stored.

use super::NetError;
use super::flatbuffer::Table;

/// What is applied to a layer's result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Activation {
    None,
    Relu,
    ReluPlusMinusOne,
    Relu6,
    Tanh,
}

/// How a window meets the map's border, and how it steps; pairs are (vertical, horizontal).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Steps {
    pub same: bool,
    pub stride: [usize; 2],
    pub dilation: [usize; 2],
}

/// A layer kind with its options.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Conv(Steps, Activation),
    DepthwiseConv(Steps, Activation),
    TransposedConvBias(Steps),
    MaxPool(Steps, [usize; 2], Activation),
    AveragePool(Steps, [usize; 2], Activation),
    FullyConnected(Activation),
    Add(Activation),
    Sub(Activation),
    Mul(Activation),
    Concat(i32, Activation),
    DepthToSpace(usize),
    ResizeBilinear {
        align_corners: bool,
        half_pixel: bool,
    },
    Mean,
    Reshape,
    Pad,
    Prelu,
    Activate(Activation),
    Logistic,
    HardSwish,
    /// `DEQUANTIZE` and `DENSIFY`: the value as it is.
    Pass,
}

impl Kind {
    pub fn name(&self) -> &'static str {
        match self {
            Self::Conv(..) => "CONV_2D",
            Self::DepthwiseConv(..) => "DEPTHWISE_CONV_2D",
            Self::TransposedConvBias(..) => "Convolution2DTransposeBias",
            Self::MaxPool(..) => "MAX_POOL_2D",
            Self::AveragePool(..) => "AVERAGE_POOL_2D",
            Self::FullyConnected(..) => "FULLY_CONNECTED",
            Self::Add(..) => "ADD",
            Self::Sub(..) => "SUB",
            Self::Mul(..) => "MUL",
            Self::Concat(..) => "CONCATENATION",
            Self::DepthToSpace(..) => "DEPTH_TO_SPACE",
            Self::ResizeBilinear { .. } => "RESIZE_BILINEAR",
            Self::Mean => "MEAN",
            Self::Reshape => "RESHAPE",
            Self::Pad => "PAD",
            Self::Prelu => "PRELU",
            Self::Activate(..) => "RELU",
            Self::Logistic => "LOGISTIC",
            Self::HardSwish => "HARD_SWISH",
            Self::Pass => "DEQUANTIZE",
        }
    }
}

/// Reads a layer's kind and options.
pub(super) fn kind_of(code: &Table<'_>, operator: &Table<'_>) -> Result<Kind, NetError> {
    let number = code.int(3, 0)?.max(i32::from(code.byte(0, 0)?));
    let options = Options(operator.table(4)?);
    Ok(match number {
        0 => Kind::Add(options.activation(0)?),
        1 => Kind::AveragePool(options.steps([1, 2], None)?, options.pair([4, 3])?, options.activation(5)?),
        2 => Kind::Concat(options.int(0, 0)?, options.activation(1)?),
        3 => Kind::Conv(options.steps([1, 2], Some([4, 5]))?, options.activation(3)?),
        4 => Kind::DepthwiseConv(options.steps([1, 2], Some([5, 6]))?, options.activation(4)?),
        5 => Kind::DepthToSpace(positive(options.int(0, 0)?)?),
        6 | 124 => Kind::Pass,
        9 => Kind::FullyConnected(options.activation(0)?),
        14 => Kind::Logistic,
        17 => Kind::MaxPool(options.steps([1, 2], None)?, options.pair([4, 3])?, options.activation(5)?),
        18 => Kind::Mul(options.activation(0)?),
        19 => Kind::Activate(Activation::Relu),
        20 => Kind::Activate(Activation::ReluPlusMinusOne),
        21 => Kind::Activate(Activation::Relu6),
        22 => Kind::Reshape,
        23 => Kind::ResizeBilinear { align_corners: options.byte(2)? != 0, half_pixel: options.byte(3)? != 0 },
        28 => Kind::Activate(Activation::Tanh),
        32 => custom(code.text(1)?, operator.bytes(5)?)?,
        34 => Kind::Pad,
        40 => Kind::Mean,
        41 => Kind::Sub(options.activation(0)?),
        54 => Kind::Prelu,
        117 => Kind::HardSwish,
        other => return Err(NetError::Unsupported(format!("layer kind {other}"))),
    })
}

/// MediaPipe's own layers: their options are a C struct.
fn custom(name: &str, options: &[u8]) -> Result<Kind, NetError> {
    if name != "Convolution2DTransposeBias" {
        return Err(NetError::Unsupported(format!("the custom layer `{name}`")));
    }
    let (ints, _) = options.as_chunks::<4>();
    let [padding, stride_x, stride_y, ..] = ints else {
        return Err(NetError::Malformed("a transposed convolution lacks its options"));
    };
    let stride = [positive(i32::from_le_bytes(*stride_y))?, positive(i32::from_le_bytes(*stride_x))?];
    let same = i32::from_le_bytes(*padding) == 1;
    Ok(Kind::TransposedConvBias(Steps { same, stride, dilation: [1, 1] }))
}

fn positive(value: i32) -> Result<usize, NetError> {
    usize::try_from(value)
        .ok()
        .filter(|value| (1..=4096).contains(value))
        .ok_or(NetError::Malformed("a stride, dilation or window is not positive"))
}

/// A layer's option table; absent means all defaults.
struct Options<'a>(Option<Table<'a>>);

impl Options<'_> {
    fn byte(&self, id: usize) -> Result<i8, NetError> {
        self.0.map_or(Ok(0), |table| table.byte(id, 0))
    }

    fn int(&self, id: usize, default: i32) -> Result<i32, NetError> {
        self.0.map_or(Ok(default), |table| table.int(id, default))
    }

    /// (vertical, horizontal) from the numbers of two fields in that order.
    fn pair(&self, [vertical, horizontal]: [usize; 2]) -> Result<[usize; 2], NetError> {
        Ok([positive(self.int(vertical, 0)?)?, positive(self.int(horizontal, 0)?)?])
    }

    /// Padding is field 0; `[width, height]` fields of stride and dilation.
    fn steps(&self, stride: [usize; 2], dilation: Option<[usize; 2]>) -> Result<Steps, NetError> {
        let dilation = match dilation {
            Some([x, y]) => [positive(self.int(y, 1)?)?, positive(self.int(x, 1)?)?],
            None => [1, 1],
        };
        Ok(Steps { same: self.byte(0)? == 0, stride: self.pair([stride[1], stride[0]])?, dilation })
    }

    fn activation(&self, id: usize) -> Result<Activation, NetError> {
        Ok(match self.byte(id)? {
            0 => Activation::None,
            1 => Activation::Relu,
            2 => Activation::ReluPlusMinusOne,
            3 => Activation::Relu6,
            4 => Activation::Tanh,
            other => return Err(NetError::Unsupported(format!("fused activation {other}"))),
        })
    }
}
