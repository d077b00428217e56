//! What a pickle of weights may name. Python would import and call it; here each name stands for one piece of plain code.

use super::super::ElementType;

/// A name of the allow-list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Global {
    /// An empty dictionary.
    OrderedDict,
    /// A tensor from storage, place, dimensions and strides.
    RebuildTensor,
    /// The tensor that it is given.
    RebuildParameter,
    /// The tuple that it is given.
    Size,
    /// Settings of a program that many checkpoints carry; they are read over.
    Namespace,
    /// The type of a storage.
    Storage(ElementType),
}

const ALLOWED: [(&str, &str, Global); 15] = [
    ("collections", "OrderedDict", Global::OrderedDict),
    ("torch._utils", "_rebuild_tensor_v2", Global::RebuildTensor),
    ("torch._utils", "_rebuild_parameter", Global::RebuildParameter),
    ("torch", "Size", Global::Size),
    ("argparse", "Namespace", Global::Namespace),
    ("torch", "DoubleStorage", Global::Storage(ElementType::F64)),
    ("torch", "FloatStorage", Global::Storage(ElementType::F32)),
    ("torch", "HalfStorage", Global::Storage(ElementType::F16)),
    ("torch", "BFloat16Storage", Global::Storage(ElementType::BF16)),
    ("torch", "LongStorage", Global::Storage(ElementType::I64)),
    ("torch", "IntStorage", Global::Storage(ElementType::I32)),
    ("torch", "ShortStorage", Global::Storage(ElementType::I16)),
    ("torch", "CharStorage", Global::Storage(ElementType::I8)),
    ("torch", "ByteStorage", Global::Storage(ElementType::U8)),
    ("torch", "BoolStorage", Global::Storage(ElementType::Bool)),
];

/// The name, if it is allowed.
pub(super) fn allowed(module: &str, name: &str) -> Option<Global> {
    ALLOWED.iter().find(|row| (row.0, row.1) == (module, name)).map(|row| row.2)
}
