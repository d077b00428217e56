//! What a pickle makes.

use super::super::ElementType;
use super::names::Global;

/// Number of a value.
pub(super) type Id = usize;

/// A value that a pickle has made.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    None,
    Bool(bool),
    Int(i64),
    /// A whole number beyond 64 bits; no weights need one.
    Large,
    Float(f64),
    Text(String),
    Bytes,
    List(Vec<Id>),
    Tuple(Vec<Id>),
    Set,
    /// Pairs in the order in which they were put; a later one replaces an earlier one of the same key.
    Dict(Vec<(Id, Id)>),
    Settings,
    Global(Global),
    Storage(StorageRef),
    Tensor(TensorRef),
}

/// A storage: an entry of the archive with numbers of one type.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StorageRef {
    pub(super) element: ElementType,
    pub(super) key: String,
    pub(super) count: usize,
}

/// A view into a storage.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TensorRef {
    pub(super) storage: Id,
    pub(super) offset: usize,
    pub(super) dims: Vec<usize>,
    pub(super) strides: Vec<usize>,
}

/// All values of a pickle, and the one that it describes.
#[derive(Debug)]
pub(super) struct Pickled {
    values: Vec<Value>,
    top: Id,
}

impl Pickled {
    /// The values in order, and the number of the one that is described.
    pub(super) fn new(values: Vec<Value>, top: Id) -> Self {
        Self { values, top }
    }

    /// The value that the pickle describes.
    pub(super) fn top(&self) -> &Value {
        self.get(self.top)
    }

    /// The value of a number.
    pub(super) fn get(&self, id: Id) -> &Value {
        &self.values[id]
    }
}
