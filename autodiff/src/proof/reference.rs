//! Plain arrays for references: obviously right, never fast.

use super::Number;
use crate::{Shape, Tensor};

/// A four-dimensional array of numbers `[n, c, h, w]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Plain<N> {
    /// The sizes.
    pub shape: Shape,
    /// The entries in row-major order.
    pub data: Vec<N>,
}

/// All indices `[n, c, h, w]` of a shape in row-major order.
pub fn indices(shape: Shape) -> impl Iterator<Item = [usize; 4]> {
    let [_, c, h, w] = shape.0;
    (0..shape.len()).map(move |i| [i / (c * h * w), i / (h * w) % c, i / w % h, i % w])
}

impl<N: Number> Plain<N> {
    /// An array from a function of the index `[n, c, h, w]`.
    pub fn from_fn(shape: Shape, f: impl FnMut([usize; 4]) -> N) -> Self {
        Plain { shape, data: indices(shape).map(f).collect() }
    }

    /// Numbers that do not move.
    pub fn of(tensor: &Tensor<f64>) -> Self {
        Plain { shape: tensor.shape(), data: tensor.data().iter().map(|&x| N::constant(x)).collect() }
    }

    /// The entry at `[n, c, h, w]`.
    ///
    /// # Panics
    /// When an index is out of range.
    pub fn at(&self, [n, c, h, w]: [usize; 4]) -> N {
        let inside = [n, c, h, w].iter().zip(self.shape.0).all(|(&i, size)| i < size);
        assert!(inside, "index {:?} outside {}", [n, c, h, w], self.shape);
        self.data[((n * self.shape.0[1] + c) * self.shape.0[2] + h) * self.shape.0[3] + w]
    }

    /// The entry of a plane, where one sample or one channel stands for all.
    pub fn at_plane(&self, n: usize, c: usize, [h, w]: [usize; 2]) -> N {
        let sole = |i: usize, size: usize| if size == 1 { 0 } else { i };
        self.at([sole(n, self.shape.n()), sole(c, self.shape.c()), h, w])
    }

    /// The entry at row `h` and column `w` of a plane, zero outside.
    pub fn or_zero(&self, n: usize, c: usize, h: isize, w: isize) -> N {
        let inside = h >= 0 && w >= 0 && h < self.shape.0[2] as isize && w < self.shape.0[3] as isize;
        if inside { self.at([n, c, h as usize, w as usize]) } else { N::zero() }
    }

    /// The entry at `index` after every axis of size one is read at 0: repetition along such axes.
    pub fn repeated(&self, index: [usize; 4]) -> N {
        let mut index = index;
        for (i, size) in index.iter_mut().zip(self.shape.0) {
            *i = if size == 1 { 0 } else { *i };
        }
        self.at(index)
    }

    /// The entries along `axis` through `index`, in order.
    pub fn line(&self, index: [usize; 4], axis: usize) -> Vec<N> {
        (0..self.shape.0[axis]).map(|k| self.at(with(index, axis, k))).collect()
    }

    /// The sums over the axes where `to` has size one.
    pub fn summed(&self, to: Shape) -> Self {
        let mut sums = Plain::from_fn(to, |_| N::zero());
        for i in indices(self.shape) {
            let mut at = i;
            for (k, size) in at.iter_mut().zip(to.0) {
                *k = if size == 1 { 0 } else { *k };
            }
            let position = to.index(at[0], at[1], at[2], at[3]);
            sums.data[position] = sums.data[position] + self.at(i);
        }
        sums
    }

    /// Mean 0 and variance 1 (biased, with `eps` added) over the axes where `to` has size one.
    pub fn standardised(&self, to: Shape, eps: f64) -> Self {
        let count = N::constant(self.shape.len() as f64 / to.len() as f64);
        let means = self.summed(to);
        let centred = Plain::from_fn(self.shape, |i| self.at(i) - means.repeated(i) / count);
        let squares = centred.map(|x| x * x).summed(to);
        Plain::from_fn(self.shape, |i| centred.at(i) / (squares.repeated(i) / count + N::constant(eps)).sqrt())
    }

    /// `f` of every entry.
    pub fn map(&self, f: impl Fn(N) -> N) -> Self {
        Plain { shape: self.shape, data: self.data.iter().map(|&x| f(x)).collect() }
    }

    /// `f` of every pair of entries of two arrays of one shape.
    pub fn zip(&self, other: &Self, f: impl Fn(N, N) -> N) -> Self {
        assert_eq!(self.shape, other.shape);
        Plain { shape: self.shape, data: self.data.iter().zip(&other.data).map(|(&x, &y)| f(x, y)).collect() }
    }
}

/// `index` with another position along one axis.
pub fn with(index: [usize; 4], axis: usize, k: usize) -> [usize; 4] {
    let mut index = index;
    index[axis] = k;
    index
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_are_row_major_and_lines_run_along_their_axis() {
        let shape = Shape::new(2, 3, 2, 2);
        let x = Plain::from_fn(shape, |[n, c, h, w]| (1000 * n + 100 * c + 10 * h + w) as f64);
        assert_eq!(x.data[5], 101.0);
        assert_eq!(x.at([1, 2, 0, 1]), 1201.0);
        assert_eq!(x.line([1, 9, 0, 1], 1), [1001.0, 1101.0, 1201.0]);
        assert_eq!((x.or_zero(0, 0, -1, 0), x.or_zero(0, 0, 1, 1), x.or_zero(0, 0, 2, 0)), (0.0, 11.0, 0.0));
    }
}
