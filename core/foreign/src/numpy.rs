//! Arrays of numbers, and how numpy keeps them inside a pickle.

use crate::{Element, ForeignError, Id, Object, Pickle};

/// Most axes of an array.
const MOST_AXES: usize = 8;

/// An array in row-major order, whatever the file's; integers beyond 2⁵³ are rounded.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Array {
    /// Sizes, slowest axis first; empty for a single number.
    pub shape: Vec<usize>,
    /// As many values as the sizes multiply to.
    pub values: Vec<f64>,
}

impl Array {
    /// Decodes `bytes`, which must be exactly the array's.
    ///
    /// # Errors
    /// More than `most` values or eight axes, or bytes that do not fit the shape.
    pub(crate) fn decode(shape: Vec<usize>, form: Form, bytes: &[u8], most: usize) -> Result<Self, ForeignError> {
        let count = count(&shape, most)?;
        if bytes.len() != count * form.element.bytes() {
            let what = format!(
                "an array of shape {shape:?} holds {} bytes instead of {}",
                bytes.len(),
                count * form.element.bytes()
            );
            return Err(ForeignError::damaged(what));
        }
        let values = form.element.decode_wide(bytes, form.big_endian);
        let values = if form.column_major { row_major(&shape, &values) } else { values };
        Ok(Self { shape, values })
    }
}

/// How an array's numbers lie in the file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Form {
    pub element: Element,
    pub big_endian: bool,
    pub column_major: bool,
}

/// Number of values, at most `most`.
pub(crate) fn count(shape: &[usize], most: usize) -> Result<usize, ForeignError> {
    let count = shape.iter().try_fold(1usize, |n, size| n.checked_mul(*size)).filter(|count| *count <= most);
    match count {
        Some(count) if shape.len() <= MOST_AXES => Ok(count),
        _ => Err(ForeignError::too_large(format!(
            "an array of shape {shape:?} is larger than the {most} values allowed"
        ))),
    }
}

fn row_major(shape: &[usize], values: &[f64]) -> Vec<f64> {
    let mut strides = vec![1usize; shape.len()];
    (1..shape.len()).for_each(|axis| strides[axis] = strides[axis - 1] * shape[axis - 1]);
    let mut index = vec![0usize; shape.len()];
    let mut out = Vec::with_capacity(values.len());
    for _ in 0..values.len() {
        out.push(values[index.iter().zip(&strides).map(|(i, stride)| i * stride).sum::<usize>()]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            if index[axis] < shape[axis] {
                break;
            }
            index[axis] = 0;
        }
    }
    out
}

/// The names numpy's own pickles use: for a caller's allow-list.
pub fn is_numpy(module: &str, name: &str) -> bool {
    let core = matches!(module, "numpy.core.multiarray" | "numpy._core.multiarray");
    (core && matches!(name, "_reconstruct" | "scalar"))
        || (module == "numpy" && matches!(name, "ndarray" | "dtype"))
        || (module, name) == ("_codecs", "encode")
}

/// What a pickled array says of itself.
struct Parts<'p> {
    shape: &'p [Id],
    dtype: Id,
    column_major: bool,
    data: Id,
}

fn parts<'p>(pickle: &'p Pickle<'_>, id: Id) -> Option<Parts<'p>> {
    let Object::Made { global, state: Some(state), .. } = pickle.get(id) else { return None };
    let Object::Global(module, "_reconstruct") = pickle.get(*global) else { return None };
    if !is_numpy(module, "_reconstruct") {
        return None;
    }
    // (version, shape, dtype, column-major, data); the version was not always there.
    let [.., shape, dtype, order, data] = *pickle.items(*state)? else { return None };
    Some(Parts { shape: pickle.items(shape)?, dtype, column_major: pickle.integer(order)? != 0, data })
}

/// An array of numbers; `None` when the object is no numpy array.
///
/// # Errors
/// An array of objects or texts, sizes that do not fit, or more than `most` values.
pub fn array(pickle: &Pickle<'_>, id: Id, most: usize) -> Result<Option<Array>, ForeignError> {
    let Some(parts) = parts(pickle, id) else { return Ok(None) };
    let (element, big_endian) = dtype(pickle, parts.dtype)
        .ok_or_else(|| ForeignError::refused("its pickle has an array of something else than numbers"))?;
    let shape: Option<Vec<usize>> = parts.shape.iter().map(|size| pickle.size(*size)).collect();
    let shape = shape.ok_or_else(|| ForeignError::damaged("its pickle has an array with a shape of no numbers"))?;
    count(&shape, most)?;
    let bytes = pickle.bytes(parts.data);
    let bytes = bytes.ok_or_else(|| ForeignError::damaged("its pickle has an array without its bytes"))?;
    Array::decode(shape, Form { element, big_endian, column_major: parts.column_major }, &bytes, most).map(Some)
}

/// The items of an array of objects, in the file's order; `None` when it is none.
pub fn objects<'p>(pickle: &'p Pickle<'_>, id: Id) -> Option<&'p [Id]> {
    let parts = parts(pickle, id)?;
    match pickle.get(parts.data) {
        Object::List(items) => Some(items),
        _ => None,
    }
}

/// `dtype('f8', …)` with the state `(3, '<', …)`.
fn dtype(pickle: &Pickle<'_>, id: Id) -> Option<(Element, bool)> {
    let Object::Made { global, arguments, state } = pickle.get(id) else { return None };
    if !pickle.is_global(*global, "numpy", "dtype") {
        return None;
    }
    let code = pickle.text(*pickle.items(*arguments)?.first()?)?;
    let order = state.and_then(|state| pickle.items(state)?.get(1).and_then(|order| pickle.text(*order)));
    Some((Element::of_numpy(code.trim_start_matches(['<', '>', '|', '=']))?, order == Some(">")))
}
