//! Immutable tensors over shared, pooled buffers.

use std::fmt;
use std::sync::Arc;

use crate::{Pool, Scalar, Shape};

/// A buffer that goes back to its pool when dropped.
struct Buffer<T: Scalar> {
    data: Vec<T>,
    pool: Option<Arc<Pool<T>>>,
}

impl<T: Scalar> Drop for Buffer<T> {
    fn drop(&mut self) {
        if let Some(pool) = self.pool.take() {
            pool.give(std::mem::take(&mut self.data));
        }
    }
}

/// An immutable array `[n, c, h, w]`, row-major and contiguous; cloning shares the buffer.
///
/// Seen as a column-major matrix it has `h * w` rows and `n * c` columns: one plane is one column.
#[derive(Clone)]
pub struct Tensor<T: Scalar> {
    shape: Shape,
    buffer: Arc<Buffer<T>>,
}

impl<T: Scalar> Tensor<T> {
    /// A tensor over the given elements.
    ///
    /// # Panics
    /// When a size is zero or the number of elements is not that of the shape.
    #[track_caller]
    pub fn from_vec(shape: Shape, data: Vec<T>) -> Self {
        Self::build(shape, data, None)
    }

    /// A tensor whose buffer returns to `pool` in the end.
    ///
    /// # Panics
    /// As [`Tensor::from_vec`].
    #[track_caller]
    pub fn pooled(shape: Shape, data: Vec<T>, pool: &Arc<Pool<T>>) -> Self {
        Self::build(shape, data, Some(pool.clone()))
    }

    /// A tensor that `write` fills, whatever it finds there, in a buffer of this tensor's pool; from the heap where it has none.
    #[track_caller]
    pub fn beside(&self, shape: Shape, write: impl FnOnce(&mut [T])) -> Self {
        let pool = self.buffer.pool.as_ref();
        let mut data = pool.map_or_else(|| vec![T::ZERO; shape.len()], |pool| pool.take(shape.len()));
        write(&mut data);
        Self::build(shape, data, pool.cloned())
    }

    #[track_caller]
    fn build(shape: Shape, data: Vec<T>, pool: Option<Arc<Pool<T>>>) -> Self {
        assert!(!shape.is_empty(), "tensor: every size must be at least 1, got shape {shape}");
        assert!(shape.len() == data.len(), "tensor: shape {shape} needs {} elements, got {}", shape.len(), data.len());
        Tensor { shape, buffer: Arc::new(Buffer { data, pool }) }
    }

    /// A tensor with one value everywhere.
    pub fn full(shape: Shape, value: T) -> Self {
        Self::from_vec(shape, vec![value; shape.len()])
    }

    /// A tensor of zeros.
    pub fn zeros(shape: Shape) -> Self {
        Self::full(shape, T::ZERO)
    }

    /// One number, shape `[1, 1, 1, 1]`.
    pub fn scalar(value: T) -> Self {
        Self::full(Shape::SCALAR, value)
    }

    /// A tensor from a function of the indices `(n, c, h, w)`.
    pub fn from_fn(shape: Shape, mut f: impl FnMut(usize, usize, usize, usize) -> T) -> Self {
        let mut data = Vec::with_capacity(shape.len());
        for n in 0..shape.n() {
            for c in 0..shape.c() {
                for h in 0..shape.h() {
                    data.extend((0..shape.w()).map(|w| f(n, c, h, w)));
                }
            }
        }
        Self::from_vec(shape, data)
    }

    /// The shape.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// The elements in row-major order.
    pub fn data(&self) -> &[T] {
        &self.buffer.data
    }

    /// The elements, copied.
    pub fn to_vec(&self) -> Vec<T> {
        self.data().to_vec()
    }

    /// One element.
    pub fn at(&self, n: usize, c: usize, h: usize, w: usize) -> T {
        self.data()[self.shape.index(n, c, h, w)]
    }

    /// The value of a one-element tensor.
    ///
    /// # Panics
    /// When there is not exactly one element.
    #[track_caller]
    pub fn item(&self) -> T {
        assert!(self.shape.len() == 1, "item: needs exactly one element, got shape {}", self.shape);
        self.data()[0]
    }

    /// The plane of sample `n` and channel `c`, `h * w` elements.
    pub fn plane(&self, n: usize, c: usize) -> &[T] {
        let plane = self.shape.plane();
        let start = (n * self.shape.c() + c) * plane;
        &self.data()[start..start + plane]
    }

    /// The same elements under another shape of equal length.
    ///
    /// # Panics
    /// When the lengths differ.
    #[track_caller]
    pub fn reshaped(&self, shape: Shape) -> Self {
        assert!(shape.len() == self.shape.len(), "reshape: {} and {shape} hold different numbers of elements", self.shape);
        Tensor { shape, buffer: self.buffer.clone() }
    }

    /// The elements converted to another number type.
    pub fn cast<U: Scalar>(&self) -> Tensor<U> {
        Tensor::from_vec(self.shape, self.data().iter().map(|x| U::from_f64(x.to_f64())).collect())
    }

    /// Whether every element is finite.
    pub fn is_finite(&self) -> bool {
        self.data().iter().all(|x| x.is_finite())
    }

    /// Writable elements. Other handles keep what they have: a buffer that is shared is copied first.
    pub fn make_mut(&mut self) -> &mut [T] {
        if Arc::get_mut(&mut self.buffer).is_none() {
            let (data, pool) = match &self.buffer.pool {
                Some(pool) => {
                    let mut data = pool.take(self.shape.len());
                    data.copy_from_slice(self.data());
                    (data, Some(pool.clone()))
                }
                None => (self.to_vec(), None),
            };
            self.buffer = Arc::new(Buffer { data, pool });
        }
        &mut Arc::get_mut(&mut self.buffer).expect("just made unique").data
    }
}

impl<T: Scalar> PartialEq for Tensor<T> {
    fn eq(&self, other: &Self) -> bool {
        self.shape == other.shape && self.data() == other.data()
    }
}

impl<T: Scalar> fmt::Debug for Tensor<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = &self.data()[..self.shape.len().min(8)];
        let dots = if shown.len() < self.shape.len() { ", .." } else { "" };
        write!(f, "Tensor<{}>{} {shown:?}{dots}", T::NAME, self.shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writing_to_a_shared_buffer_copies_it() {
        let first = Tensor::<f64>::from_fn(Shape::new(1, 2, 1, 2), |_, c, _, w| (2 * c + w) as f64);
        let mut second = first.clone();
        second.make_mut()[0] = 9.0;
        assert_eq!(first.data(), [0.0, 1.0, 2.0, 3.0]);
        assert_eq!(second.data(), [9.0, 1.0, 2.0, 3.0]);
        assert_eq!(first.plane(0, 1), [2.0, 3.0]);
    }

    #[test]
    fn a_tensor_beside_another_has_a_buffer_of_its_pool() {
        let pool = Pool::<f64>::new();
        let shape = Shape::new(1, 1, 30, 10);
        let first = Tensor::pooled(shape, pool.take(300), &pool);
        let second = first.beside(shape, |data| data.fill(2.0));
        drop(first);
        assert_eq!((pool.elements(), second.at(0, 0, 29, 9)), (300, 2.0));
        drop(second);
        assert_eq!(pool.elements(), 600);
        let heap = Tensor::<f64>::zeros(shape);
        assert_eq!(heap.beside(Shape::SCALAR, |data| data[0] = 3.0).item(), 3.0);
    }

    #[test]
    #[should_panic(expected = "every size must be at least 1, got shape [1, 0, 2, 2]")]
    fn a_size_of_zero_is_refused() {
        Tensor::<f32>::zeros(Shape::new(1, 0, 2, 2));
    }

    #[test]
    #[should_panic(expected = "shape [1, 1, 2, 2] needs 4 elements, got 3")]
    fn wrong_length_is_named() {
        Tensor::from_vec(Shape::new(1, 1, 2, 2), vec![1.0_f32; 3]);
    }
}
