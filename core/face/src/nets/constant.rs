//! Constants of a model: 32-bit floats, half floats widened at load, integers, and sparse tensors made dense.

use super::NetError;
use super::flatbuffer::Table;

/// No tensor of a landmark network comes near this many elements; a larger one is a damaged file.
pub(super) const MOST_ELEMENTS: usize = 1 << 25;

/// A tensor known before the network runs.
#[derive(Clone, Debug)]
pub(super) enum Constant {
    /// Weights, biases, slopes.
    Floats(Vec<f32>),
    /// Shapes, paddings, axes.
    Ints(Vec<i32>),
}

/// Number of elements of a shape, checked.
pub(super) fn element_count(shape: &[usize]) -> Result<usize, NetError> {
    let count = shape.iter().try_fold(1usize, |product, &size| product.checked_mul(size));
    count.filter(|count| *count <= MOST_ELEMENTS).ok_or(NetError::Malformed("a tensor is absurdly large"))
}

/// Widens an IEEE half float.
fn f32_from_f16(bits: u16) -> f32 {
    let (sign, exponent, fraction) = (u32::from(bits >> 15) << 31, u32::from(bits >> 10) & 31, u32::from(bits) & 1023);
    match exponent {
        0 => f32::from_bits(sign | 0x3f80_0000) * fraction as f32 / 16_777_216.0,
        31 => f32::from_bits(sign | 0x7f80_0000 | fraction << 13),
        _ => f32::from_bits(sign | (exponent + 112) << 23 | fraction << 13),
    }
}

/// Reads a constant of TFLite's element type `kind`; `None` for types that carry nothing we use.
pub(super) fn decode(
    kind: i8,
    shape: &[usize],
    bytes: &[u8],
    tensor: &Table<'_>,
) -> Result<Option<Constant>, NetError> {
    let values = match kind {
        0 => Constant::Floats(bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()),
        1 => Constant::Floats(bytes.as_chunks::<2>().0.iter().map(|b| f32_from_f16(u16::from_le_bytes(*b))).collect()),
        2 => Constant::Ints(bytes.as_chunks::<4>().0.iter().map(|b| i32::from_le_bytes(*b)).collect()),
        _ => return Ok(None),
    };
    let count = element_count(shape)?;
    match (tensor.table(6)?, values) {
        (Some(sparsity), Constant::Floats(values)) => Ok(Some(Constant::Floats(densify(&sparsity, shape, &values)?))),
        (None, Constant::Floats(values)) if values.len() == count => Ok(Some(Constant::Floats(values))),
        (None, Constant::Ints(values)) if values.len() == count => Ok(Some(Constant::Ints(values))),
        _ => Err(NetError::Malformed("a constant's size contradicts its shape")),
    }
}

/// One level of a sparse tensor's index tree.
enum Level {
    Dense(usize),
    Csr { segments: Vec<i32>, indices: Vec<i32> },
}

const SPARSE: NetError = NetError::Malformed("a sparse constant's index contradicts its shape");

fn levels(sparsity: &Table<'_>) -> Result<Vec<Level>, NetError> {
    let vector = |table: Option<Table<'_>>, kind: i8| match (table, kind) {
        (Some(table), 1) => table.ints(0),
        (Some(table), 2) => table.shorts(0),
        (Some(table), 3) => Ok(table.bytes(0)?.iter().map(|byte| i32::from(*byte)).collect()),
        _ => Err(SPARSE),
    };
    let level = |dimension: Table<'_>| match dimension.byte(0, 0)? {
        0 => Ok(Level::Dense(usize::try_from(dimension.int(1, 0)?).map_err(|_| SPARSE)?)),
        _ => Ok(Level::Csr {
            segments: vector(dimension.table(3)?, dimension.byte(2, 0)?)?,
            indices: vector(dimension.table(5)?, dimension.byte(4, 0)?)?,
        }),
    };
    sparsity.tables(2)?.into_iter().map(level).collect()
}

/// Expands a sparse constant (traversal order, block map, dense or compressed levels) to its full shape.
fn densify(sparsity: &Table<'_>, shape: &[usize], values: &[f32]) -> Result<Vec<f32>, NetError> {
    let to_index = |list: Vec<i32>| -> Result<Vec<usize>, NetError> {
        list.into_iter().map(|i| usize::try_from(i).map_err(|_| SPARSE)).collect()
    };
    let order = to_index(sparsity.ints(0)?)?;
    let blocks = to_index(sparsity.ints(1)?)?;
    let levels = levels(sparsity)?;
    let rank = shape.len();
    if levels.len() != order.len() || order.len() != rank + blocks.len() || blocks.iter().any(|axis| *axis >= rank) {
        return Err(SPARSE);
    }
    if order.iter().any(|axis| *axis >= order.len()) || order.len() > 8 {
        return Err(SPARSE);
    }
    // The size of each block axis, so that an outer index counts blocks.
    let mut block_size = vec![1usize; rank];
    for (level, &axis) in levels.iter().zip(&order) {
        if let (Level::Dense(size), true) = (level, axis >= rank) {
            block_size[blocks[axis - rank]] = (*size).max(1);
        }
    }
    let mut walk = Walk {
        levels: &levels,
        order: &order,
        blocks: &blocks,
        block_size: &block_size,
        shape,
        values: values.iter(),
        out: vec![0.0; element_count(shape)?],
        budget: 4 * MOST_ELEMENTS,
    };
    walk.descend(0, 0, &mut vec![0; order.len()])?;
    Ok(walk.out)
}

struct Walk<'a> {
    levels: &'a [Level],
    order: &'a [usize],
    blocks: &'a [usize],
    block_size: &'a [usize],
    shape: &'a [usize],
    values: std::slice::Iter<'a, f32>,
    out: Vec<f32>,
    budget: usize,
}

impl Walk<'_> {
    /// Visits one level; `parent` numbers the nodes of the level above, `index` holds the indices chosen so far.
    fn descend(&mut self, level: usize, parent: usize, index: &mut [usize]) -> Result<(), NetError> {
        self.budget = self.budget.checked_sub(1).ok_or(SPARSE)?;
        let Some(current) = self.levels.get(level) else { return self.store(index) };
        match current {
            Level::Dense(size) => {
                for i in 0..*size {
                    index[self.order[level]] = i;
                    self.descend(level + 1, parent.saturating_mul(*size).saturating_add(i), index)?;
                }
            }
            Level::Csr { segments, indices } => {
                let (Some(&from), Some(&to)) = (segments.get(parent), segments.get(parent + 1)) else {
                    return Err(SPARSE);
                };
                for at in from..to {
                    let at = usize::try_from(at).map_err(|_| SPARSE)?;
                    let i = indices.get(at).and_then(|i| usize::try_from(*i).ok()).ok_or(SPARSE)?;
                    index[self.order[level]] = i;
                    self.descend(level + 1, at, index)?;
                }
            }
        }
        Ok(())
    }

    fn store(&mut self, index: &[usize]) -> Result<(), NetError> {
        let rank = self.shape.len();
        let mut flat = 0usize;
        for axis in 0..rank {
            let mut position = index[axis].checked_mul(self.block_size[axis]).ok_or(SPARSE)?;
            if let Some(block) = self.blocks.iter().position(|blocked| *blocked == axis) {
                position = position.checked_add(index[rank + block]).ok_or(SPARSE)?;
            }
            if position >= self.shape[axis] {
                return Err(SPARSE);
            }
            flat = flat * self.shape[axis] + position;
        }
        let value = self.values.next().ok_or(SPARSE)?;
        *self.out.get_mut(flat).ok_or(SPARSE)? = *value;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_widen_exactly() {
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x3555, 0.333_251_95),
            (0x0001, 5.960_464_5e-8),
            (0x8000, -0.0),
            (0x7bff, 65504.0),
        ] {
            assert_eq!(f32_from_f16(bits).to_bits(), f32::to_bits(value), "{bits:#x}");
        }
        assert!(f32_from_f16(0x7c00).is_infinite() && f32_from_f16(0x7e00).is_nan());
    }
}
