//! Named parameters of one checkpoint file, in module order.

use std::collections::BTreeMap;

use dimode_autodiff::{Scalar, Shape, Tensor};

/// What a stored tensor is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Changed by the optimiser.
    Parameter,
    /// A parameter that no optimiser touches: a feature extractor that keeps the weights it came with.
    Frozen,
    /// Stored and used, but not trained: running statistics.
    Buffer,
}

/// One named tensor.
#[derive(Clone, Debug)]
pub struct Entry<T: Scalar> {
    dims: Vec<usize>,
    kind: Kind,
    tensor: Tensor<T>,
}

impl<T: Scalar> Entry<T> {
    /// Puts a tensor under its stored dimensions.
    ///
    /// # Panics
    /// When the tensor does not have the shape that `shape_of` gives for `dims`.
    #[track_caller]
    pub fn new(dims: Vec<usize>, kind: Kind, tensor: Tensor<T>) -> Self {
        assert_eq!(tensor.shape(), shape_of(&dims), "entry: tensor shape does not fit the stored dimensions {dims:?}");
        Self { dims, kind, tensor }
    }

    /// Dimensions as in the checkpoint file, rank kept: `[c]`, `[out, in]`, `[out, in, kh, kw]`.
    pub fn dims(&self) -> &[usize] {
        &self.dims
    }

    /// What the tensor is for.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The values, shaped by `shape_of`.
    pub fn tensor(&self) -> &Tensor<T> {
        &self.tensor
    }

    /// The values, to be changed in place; copied first while a tape or another handle shares them.
    pub fn data_mut(&mut self) -> &mut [T] {
        self.tensor.make_mut()
    }

    /// Replaces the values.
    ///
    /// # Panics
    /// When the shape differs.
    #[track_caller]
    pub fn set(&mut self, tensor: Tensor<T>) {
        assert_eq!(tensor.shape(), self.tensor.shape(), "entry: new values must keep the shape");
        self.tensor = tensor;
    }
}

/// The four-dimensional shape of a stored tensor: vectors become (1, C, 1, 1), matrices
/// (1, 1, out, in), rank 3 (1, a, b, c); convolution weights stay as they are.
///
/// # Panics
/// When the rank is above four.
#[track_caller]
pub fn shape_of(dims: &[usize]) -> Shape {
    match *dims {
        [] => Shape::new(1, 1, 1, 1),
        [c] => Shape::new(1, c, 1, 1),
        [rows, columns] => Shape::new(1, 1, rows, columns),
        [a, b, c] => Shape::new(1, a, b, c),
        [n, c, h, w] => Shape::new(n, c, h, w),
        _ => panic!("stored tensors have at most four axes, not {dims:?}"),
    }
}

/// Ordered map from name to tensor: the content of one checkpoint file.
#[derive(Clone, Debug, Default)]
pub struct Params<T: Scalar> {
    names: Vec<String>,
    entries: Vec<Entry<T>>,
    index: BTreeMap<String, usize>,
}

impl<T: Scalar> Params<T> {
    /// An empty map.
    pub fn new() -> Self {
        Self { names: Vec::new(), entries: Vec::new(), index: BTreeMap::new() }
    }

    /// Adds an entry at the end.
    ///
    /// # Panics
    /// When the name is taken.
    #[track_caller]
    pub fn insert(&mut self, name: &str, entry: Entry<T>) {
        let position = self.entries.len();
        let before = self.index.insert(name.to_owned(), position);
        assert!(before.is_none(), "params: '{name}' is there already");
        self.names.push(name.to_owned());
        self.entries.push(entry);
    }

    /// The entry called `name`.
    pub fn get(&self, name: &str) -> Option<&Entry<T>> {
        self.index.get(name).map(|&i| &self.entries[i])
    }

    /// The entry called `name`, to be changed.
    pub fn get_mut(&mut self, name: &str) -> Option<&mut Entry<T>> {
        self.index.get(name).map(|&i| &mut self.entries[i])
    }

    /// Names in order of insertion.
    pub fn names(&self) -> impl ExactSizeIterator<Item = &str> {
        self.names.iter().map(String::as_str)
    }

    /// Names and entries in order of insertion.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &Entry<T>)> {
        self.names.iter().map(String::as_str).zip(&self.entries)
    }

    /// Names and entries in order of insertion, to be changed.
    pub fn iter_mut(&mut self) -> impl ExactSizeIterator<Item = (&str, &mut Entry<T>)> {
        self.names.iter().map(String::as_str).zip(&mut self.entries)
    }

    /// Number of tensors.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// True when there are no tensors.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Number of scalars in parameters, trained and frozen.
    pub fn parameter_count(&self) -> usize {
        self.entries.iter().filter(|e| e.kind != Kind::Buffer).map(|e| e.tensor.shape().len()).sum()
    }

    /// The same values in another scalar type.
    pub fn cast<U: Scalar>(&self) -> Params<U> {
        let mut out = Params::new();
        for (name, e) in self.iter() {
            out.insert(name, Entry::new(e.dims.clone(), e.kind, e.tensor.cast()));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vector(values: &[f64]) -> Entry<f64> {
        let tensor = Tensor::from_vec(Shape::new(1, values.len(), 1, 1), values.to_vec());
        Entry::new(vec![values.len()], Kind::Parameter, tensor)
    }

    #[test]
    fn order_is_that_of_insertion() {
        let mut params = Params::new();
        params.insert("z", vector(&[1.0]));
        params.insert("a", vector(&[2.0, 3.0]));
        assert_eq!(params.names().collect::<Vec<_>>(), ["z", "a"]);
        assert_eq!(params.len(), 2);
        assert_eq!(params.parameter_count(), 3);
        assert_eq!(params.get("a").unwrap().tensor().data(), &[2.0, 3.0]);
        assert!(params.get("b").is_none());
    }

    #[test]
    #[should_panic(expected = "keep the shape")]
    fn new_values_keep_the_shape() {
        vector(&[1.0, 2.0]).set(Tensor::zeros(Shape::new(1, 3, 1, 1)));
    }

    #[test]
    fn ranks_map_to_four_axes() {
        assert_eq!(shape_of(&[]), Shape::new(1, 1, 1, 1));
        assert_eq!(shape_of(&[5]), Shape::new(1, 5, 1, 1));
        assert_eq!(shape_of(&[2, 3]), Shape::new(1, 1, 2, 3));
        assert_eq!(shape_of(&[8, 1, 1]), Shape::new(1, 8, 1, 1));
        assert_eq!(shape_of(&[4, 3, 2, 1]), Shape::new(4, 3, 2, 1));
    }
}
