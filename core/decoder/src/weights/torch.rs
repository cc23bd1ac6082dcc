//! What a pickle of `torch.save` says about its tensors.
//!
//! The replay is [`heartian_foreign::Pickle`]'s; only the names of [`is_torch`] are known. Nothing is checked against a
//! tensor's storage yet.

use heartian_foreign::{Element, Id, Object, Pickle};

use super::damaged;
use crate::DecoderError;

/// The kinds of storage: floating, or integer of so many bytes (read past, never used).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Numbers with a fraction.
    Floating(Element),
    /// Whole numbers and truth values.
    Integer,
}

/// What the file says about one tensor; nothing is checked against its storage yet.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorRecord {
    /// What is stored.
    pub kind: Kind,
    /// Name of the storage's member in the archive.
    pub storage: String,
    /// Values in the storage.
    pub storage_len: usize,
    /// Index of the first value.
    pub offset: usize,
    /// Sizes.
    pub shape: Vec<usize>,
    /// Step along each axis, values.
    pub strides: Vec<usize>,
}

/// The allow-list.
fn is_torch(module: &str, name: &str) -> bool {
    match module {
        "collections" => name == "OrderedDict",
        "torch._utils" => matches!(name, "_rebuild_tensor_v2" | "_rebuild_parameter"),
        "torch" => storage_kind(name).is_some(),
        _ => false,
    }
}

fn storage_kind(class: &str) -> Option<Kind> {
    Some(match class {
        "FloatStorage" => Kind::Floating(Element::Single),
        "DoubleStorage" => Kind::Floating(Element::Double),
        "HalfStorage" => Kind::Floating(Element::Half),
        "BFloat16Storage" => Kind::Floating(Element::Brain),
        "LongStorage" | "IntStorage" | "ShortStorage" | "CharStorage" | "ByteStorage" | "BoolStorage" => Kind::Integer,
        _ => return None,
    })
}

/// Reads the names and tensors of a state dictionary, also one under `state_dict`, `model_state_dict` or `model`.
pub fn read(bytes: &[u8]) -> Result<Vec<(String, TensorRecord)>, DecoderError> {
    let pickle = Pickle::read(bytes, &is_torch)?;
    let inner = |key: &&str| pickle.entry(pickle.top(), key).filter(|id| pickle.entries(*id).is_some());
    let top = ["state_dict", "model_state_dict", "model"].iter().find_map(inner).unwrap_or(pickle.top());
    let Some(entries) = pickle.entries(top) else {
        return Err(damaged("its pickle holds no dictionary of tensors", "save the network's state_dict()"));
    };
    let mut records = Vec::new();
    for (key, value) in entries {
        // Entries that are no tensors (an epoch number beside them) are passed over.
        let (Some(name), Object::Made { .. }) = (pickle.text(*key), pickle.get(*value)) else { continue };
        let record = tensor(&pickle, *value).ok_or_else(|| {
            damaged(
                &format!("its pickle has under `{name}` a tensor it does not describe"),
                "save the network's state_dict()",
            )
        })?;
        records.push((name.to_owned(), record));
    }
    Ok(records)
}

/// `_rebuild_tensor_v2(storage, offset, sizes, strides, …)`, or a parameter around one.
fn tensor(pickle: &Pickle<'_>, id: Id) -> Option<TensorRecord> {
    let Object::Made { global, arguments, .. } = pickle.get(id) else { return None };
    let arguments = pickle.items(*arguments)?;
    if pickle.is_global(*global, "torch._utils", "_rebuild_parameter") {
        let inner = *arguments.first()?;
        // A parameter of a parameter would be a ring or nonsense.
        return is_tensor(pickle, inner).then(|| tensor(pickle, inner))?;
    }
    if !is_tensor(pickle, id) {
        return None;
    }
    let [storage, offset, shape, strides, ..] = *arguments else { return None };
    let Object::Persistent(storage) = *pickle.get(storage) else { return None };
    // ('storage', storage class, key, device, length)
    let [_, class, key, _, len] = *pickle.items(storage)? else { return None };
    let Object::Global("torch", class) = *pickle.get(class) else { return None };
    let sizes = |id: Id| -> Option<Vec<usize>> {
        pickle.items(id).filter(|items| items.len() <= 8)?.iter().map(|item| pickle.size(*item)).collect()
    };
    let record = TensorRecord {
        kind: storage_kind(class)?,
        storage: pickle.text(key)?.to_owned(),
        storage_len: pickle.size(len)?,
        offset: pickle.size(offset)?,
        shape: sizes(shape)?,
        strides: sizes(strides)?,
    };
    (record.shape.len() == record.strides.len()).then_some(record)
}

fn is_tensor(pickle: &Pickle<'_>, id: Id) -> bool {
    let Object::Made { global, .. } = pickle.get(id) else { return false };
    pickle.is_global(*global, "torch._utils", "_rebuild_tensor_v2")
}
