//! Batched matrix product over the last two axes: `y[n, c] = a[n, c] b[n, c]`, each operand stored as it is or transposed.
//!
//! Vector-Jacobian products: `g bᵀ` to `a`, `aᵀ g` to `b` (their transposes where an operand is stored transposed), summed in order
//! over the planes that share a plane of the operand. Linear in each operand, no kinks. Keeps both operands, each only when the
//! other one needs its gradient.

use super::reduce::span;
use crate::gemm::View;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, total};
use crate::{Scalar, Shape, Var, par};

/// Multiplications of one unit of work, below which matrices are grouped.
const UNIT: usize = 1 << 16;

/// Attributes of a matrix product.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MatMul {
    /// Whether the planes of the left operand hold the transposed matrix, `[k, m]`.
    pub transpose_left: bool,
    /// Whether the planes of the right operand hold the transposed matrix, `[p, k]`.
    pub transpose_right: bool,
    /// Whether an operand with one sample or one channel goes with every sample or channel of the other.
    pub broadcast: bool,
}

impl MatMul {
    /// Shape of the product of two operands.
    ///
    /// # Panics
    /// When the inner sizes differ, or the leading axes do (with `broadcast`: and neither is 1).
    #[track_caller]
    pub fn output_shape(&self, left: Shape, right: Shape) -> Shape {
        let (m, k) = turned(self.transpose_left, left);
        let (l, p) = turned(self.transpose_right, right);
        let agree = |a, b| a == b || (self.broadcast && (a == 1 || b == 1));
        assert!(
            k == l && agree(left.n(), right.n()) && agree(left.c(), right.c()),
            "matmul: needs [n, c, m, k] x [n, c, k, p], got {left} x {right} with {self:?}"
        );
        let joined = |a, b| if a == 1 { b } else { a };
        Shape::new(joined(left.n(), right.n()), joined(left.c(), right.c()), m, p)
    }
}

/// Rows and columns of the matrices that planes of `shape` hold.
fn turned(transposed: bool, shape: Shape) -> (usize, usize) {
    if transposed { (shape.w(), shape.h()) } else { (shape.h(), shape.w()) }
}

/// The planes of one operand within a product.
#[derive(Clone, Copy)]
struct Planes {
    own: Shape,
    product: Shape,
    transposed: bool,
}

impl Planes {
    /// Plane `i` of `data` as a matrix.
    fn matrix<T>(self, data: &[T], i: usize) -> View<'_, T> {
        let (len, (rows, cols)) = (self.own.plane(), turned(self.transposed, self.own));
        let data = &data[i * len..][..len];
        if self.transposed { View::transpose_of(data, rows, cols) } else { View::new(data, rows, cols) }
    }

    /// The plane that takes part in plane `i` of the product.
    fn source(self, i: usize) -> usize {
        let pin = |i, size| if size == 1 { 0 } else { i };
        let (n, c) = (i / self.product.c(), i % self.product.c());
        pin(n, self.own.n()) * self.own.c() + pin(c, self.own.c())
    }

    /// The planes of the product in which plane `i` takes part, in order.
    fn uses(self, i: usize) -> impl Iterator<Item = usize> {
        let (n, c) = (i / self.own.c(), i % self.own.c());
        let channels = span(c, self.own.c(), self.product.c());
        span(n, self.own.n(), self.product.n()).flat_map(move |n| channels.clone().map(move |c| n * self.product.c() + c))
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Matrix product of each `(n, c)` pair of planes: `[n, c, m, k] x [n, c, k, p] -> [n, c, m, p]`.
    ///
    /// **Gradient**: `g bᵀ` to `self`, `aᵀ g` to `other`.
    ///
    /// **Panics** when the leading axes or the inner sizes differ.
    #[track_caller]
    pub fn matmul(self, other: Var<'t, T>) -> Var<'t, T> {
        self.matmul_with(other, MatMul::default())
    }

    /// As [`Var::matmul`], with operands that are read transposed or go with every plane of the other, without a copy.
    ///
    /// **Shapes**: with [`MatMul::transpose_left`] the left operand is `[n, c, k, m]`, with [`MatMul::transpose_right`] the right
    /// one `[n, c, p, k]`; with [`MatMul::broadcast`] the leading axes may be 1.
    ///
    /// **Gradient**: `g bᵀ` to `self`, `aᵀ g` to `other`, in the order in which they are stored, summed over repetitions.
    ///
    /// **Panics** when the shapes do not fit (see [`MatMul::output_shape`]).
    #[track_caller]
    pub fn matmul_with(self, other: Var<'t, T>, attributes: MatMul) -> Var<'t, T> {
        let (a, b) = (self.value(), other.value());
        let product = attributes.output_shape(a.shape(), b.shape());
        let left = Planes { own: a.shape(), product, transposed: attributes.transpose_left };
        let right = Planes { own: b.shape(), product, transposed: attributes.transpose_right };
        let whole = Planes { own: product, product, transposed: false };
        let (m, p, k) = (product.h(), product.w(), turned(left.transposed, left.own).1);
        let mut out = self.tape().scratch(product.len());
        batched(&mut out, [m, k, p], false, |i| {
            std::iter::once((left.matrix(a.data(), left.source(i)), right.matrix(b.data(), right.source(i))))
        });
        let output = self.tape().tensor(product, out);
        let a = other.requires_grad().then_some(a);
        let b = self.requires_grad().then_some(b);
        self.tape().push("matmul", output, &[self, other], move |g, grads| {
            let g = g.data();
            if let (Some(mut slot), Some(b)) = (grads.slot(0), &b) {
                batched(slot.as_mut_slice(), [left.own.h(), p, left.own.w()], true, |i| {
                    left.uses(i).map(|i| {
                        let (g, b) = (whole.matrix(g, i), right.matrix(b.data(), right.source(i)));
                        if left.transposed { (b, g.t()) } else { (g, b.t()) }
                    })
                });
            }
            if let (Some(mut slot), Some(a)) = (grads.slot(1), &a) {
                batched(slot.as_mut_slice(), [right.own.h(), m, right.own.w()], true, |i| {
                    right.uses(i).map(|i| {
                        let (g, a) = (whole.matrix(g, i), left.matrix(a.data(), left.source(i)));
                        if right.transposed { (g.t(), a) } else { (a.t(), g) }
                    })
                });
            }
        })
    }

    /// Transposes every plane: `[n, c, h, w] -> [n, c, w, h]`.
    pub fn transpose_hw(self) -> Var<'t, T> {
        self.permute([0, 1, 3, 2])
    }
}

/// Sums of products of many small matrices, grouped into units of fixed size. `sizes` are rows, inner size and columns.
fn batched<'a, T: Scalar, I: Iterator<Item = (View<'a, T>, View<'a, T>)>>(
    out: &mut [T],
    sizes: [usize; 3],
    add: bool,
    factors: impl Fn(usize) -> I + Sync + Send,
) {
    let [m, k, p] = sizes;
    let group = (UNIT / (m * k * p).max(1)).max(1);
    par::for_each_chunk(out, group * m * p, |chunk, out| {
        for (j, out) in out.chunks_mut(m * p).enumerate() {
            let mut add = add;
            for (a, b) in factors(chunk * group + j) {
                if m * k * p <= 64 {
                    small(out, a, b, add)
                } else {
                    T::gemm(out, a, b, add)
                }
                add = true;
            }
        }
    });
}

/// Plain loops for matrices such as rotations, where the library's fixed cost dominates.
fn small<T: Scalar>(out: &mut [T], a: View<'_, T>, b: View<'_, T>, add: bool) {
    let at = |v: View<'_, T>, i: usize, j: usize| if v.transposed { v.data[j * v.rows + i] } else { v.data[i * v.cols + j] };
    for i in 0..a.rows {
        for j in 0..b.cols {
            let sum = (0..a.cols).fold(T::ZERO, |sum, l| sum + at(a, i, l) * at(b, l, j));
            let o = &mut out[i * b.cols + j];
            *o = if add { *o + sum } else { sum };
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Product(MatMul);

impl Twin for Product {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        if self.0 == MatMul::default() { v[0].matmul(v[1]) } else { v[0].matmul_with(v[1], self.0) }
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let MatMul { transpose_left, transpose_right, .. } = self.0;
        let [left, right] = [&x[0], &x[1]];
        let [n, c] = [left.shape.n().max(right.shape.n()), left.shape.c().max(right.shape.c())];
        let (rows, inner) = if transpose_left { (left.shape.w(), left.shape.h()) } else { (left.shape.h(), left.shape.w()) };
        let columns = if transpose_right { right.shape.h() } else { right.shape.w() };
        let a = |n, c, i, k| left.at_plane(n, c, if transpose_left { [k, i] } else { [i, k] });
        let b = |n, c, k, j| right.at_plane(n, c, if transpose_right { [j, k] } else { [k, j] });
        Plain::from_fn(Shape::new(n, c, rows, columns), |[n, c, i, j]| total((0..inner).map(|k| a(n, c, i, k) * b(n, c, k, j))))
    }
}

#[derive(Clone, Copy, Debug)]
struct Transpose;

impl Twin for Transpose {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].transpose_hw()
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let [n, c, h, w] = x[0].shape.0;
        Plain::from_fn(Shape::new(n, c, w, h), |[n, c, i, j]| x[0].at([n, c, j, i]))
    }
}

fn product(draw: &mut Draw, attributes: MatMul, leading: [[usize; 2]; 2], [m, k, p]: [usize; 3]) -> Case {
    let planes = |[n, c]: [usize; 2], turned: bool, h: usize, w: usize| {
        if turned { Shape::new(n, c, w, h) } else { Shape::new(n, c, h, w) }
    };
    let left = planes(leading[0], attributes.transpose_left, m, k);
    let right = planes(leading[1], attributes.transpose_right, k, p);
    Case::new(Product(attributes), [draw.uniform(left, -1.0, 1.0), draw.uniform(right, -1.0, 1.0)])
}

/// Small and large, thin and square matrices.
const SIZES: [[usize; 3]; 10] =
    [[1, 1, 1], [3, 3, 3], [4, 4, 1], [1, 5, 7], [2, 1, 3], [5, 3, 1], [9, 11, 6], [3, 17, 2], [16, 3, 13], [7, 20, 9]];

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("matmul");
    let mut cases = Vec::new();
    for (i, sizes) in SIZES.into_iter().enumerate() {
        for leading in [[1, 1], [2, 3], [3, 1]] {
            let case = product(&mut draw, MatMul::default(), [leading; 2], sizes);
            cases.push(if leading == [3, 1] && i < 4 { case.constant(i % 2) } else { case });
        }
    }
    cases.push(product(&mut draw, MatMul::default(), [[1, 1]; 2], [45, 46, 47]));
    Proof::new("matmul", cases)
}

pub(crate) fn attributes_proof() -> Proof {
    let mut draw = Draw::new("matmul_with");
    let mut cases = Vec::new();
    let turns = [[false, true], [true, false], [true, true], [false, false]];
    for (i, sizes) in SIZES.into_iter().enumerate() {
        for [transpose_left, transpose_right] in turns {
            let attributes = MatMul { transpose_left, transpose_right, broadcast: false };
            cases.push(product(&mut draw, attributes, [[1 + i % 2, 1 + i % 3]; 2], sizes));
            let attributes = MatMul { broadcast: true, ..attributes };
            let leading = [[[1, 1], [2, 3]], [[2, 3], [1, 1]], [[2, 1], [1, 3]], [[1, 3], [2, 3]], [[2, 3], [2, 1]]][i % 5];
            cases.push(product(&mut draw, attributes, leading, sizes));
        }
    }
    for [transpose_left, transpose_right] in turns {
        let attributes = MatMul { transpose_left, transpose_right, broadcast: false };
        cases.push(product(&mut draw, attributes, [[1, 1]; 2], [45, 46, 47]));
    }
    Proof::new("matmul_with", cases)
}

pub(crate) fn transpose_proof() -> Proof {
    Proof::unary("transpose_hw", Transpose, [-1.0, 1.0], &[])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::MatMul;
    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn worked_product() {
        let tape = Tape::<f64>::new();
        let a = tape.constant(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![2.0, 3.0]));
        let b = tape.constant(Tensor::from_vec(Shape::new(1, 1, 2, 2), vec![1.0, 4.0, 5.0, 6.0]));
        assert_eq!(a.matmul(b).value().data(), [17.0, 26.0]);
        let right = MatMul { transpose_right: true, ..MatMul::default() };
        assert_eq!(a.matmul_with(b, right).value().data(), [14.0, 28.0]);
        let left = MatMul { transpose_left: true, ..MatMul::default() };
        assert_eq!(b.matmul_with(b, left).value().data(), [26.0, 34.0, 34.0, 52.0]);
    }

    #[test]
    fn shared_matrix_collects_the_gradient_of_every_plane() {
        let tape = Tape::<f64>::new();
        let a = tape.leaf(Tensor::from_vec(Shape::new(2, 1, 1, 1), vec![2.0, 3.0]));
        let b = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![5.0, 7.0]));
        let y = a.matmul_with(b, MatMul { broadcast: true, ..MatMul::default() });
        close(y.value().data(), &[10.0, 14.0, 15.0, 21.0]);
        let grads = tape.backward(y.sum());
        close(grads.wrt(a).data(), &[12.0, 12.0]);
        close(grads.wrt(b).data(), &[5.0, 5.0]);
    }

    #[test]
    #[should_panic(expected = "matmul: needs [n, c, m, k] x [n, c, k, p], got [1, 1, 2, 3] x [1, 1, 2, 3]")]
    fn rejects_unequal_inner_sizes() {
        let tape = Tape::<f32>::new();
        let a = tape.constant(Tensor::zeros(Shape::new(1, 1, 2, 3)));
        a.matmul(a);
    }

    #[test]
    #[should_panic(expected = "got [2, 1, 2, 2] x [1, 1, 2, 2] with MatMul { transpose_left: false")]
    fn rejects_a_shared_matrix_unless_it_is_asked_for() {
        let tape = Tape::<f32>::new();
        let a = tape.constant(Tensor::zeros(Shape::new(2, 1, 2, 2)));
        a.matmul(tape.constant(Tensor::zeros(Shape::new(1, 1, 2, 2))));
    }

    #[test]
    #[should_panic(expected = "got [2, 1, 2, 2] x [3, 1, 2, 2]")]
    fn rejects_batches_of_different_size() {
        let tape = Tape::<f32>::new();
        let a = tape.constant(Tensor::zeros(Shape::new(2, 1, 2, 2)));
        let b = tape.constant(Tensor::zeros(Shape::new(3, 1, 2, 2)));
        a.matmul_with(b, MatMul { broadcast: true, ..MatMul::default() });
    }

    /// Two operands of random sizes with random attributes; with broadcast, axes shrink to 1 as `shared` says.
    fn operands() -> impl Strategy<Value = (Tensor<f64>, Tensor<f64>, MatMul)> {
        let attributes = any::<[bool; 3]>().prop_map(|[transpose_left, transpose_right, broadcast]| MatMul {
            transpose_left,
            transpose_right,
            broadcast,
        });
        let sizes = (1..6usize, 1..7usize, 1..6usize);
        (testing::shapes(), sizes, attributes, any::<[bool; 4]>(), any::<u64>()).prop_map(
            |(batch, (m, k, p), with, shared, seed)| {
                let axis = |i: usize, size: usize| if with.broadcast && shared[i] { 1 } else { size };
                let operand = |i: usize, rows: usize, cols: usize, transposed: bool| {
                    let (h, w) = if transposed { (cols, rows) } else { (rows, cols) };
                    random(seed ^ i as u64, Shape::new(axis(i, batch.n()), axis(i + 1, batch.c()), h, w), -1.0, 1.0)
                };
                (operand(0, m, k, with.transpose_left), operand(2, k, p, with.transpose_right), with)
            },
        )
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn values_equal_the_plain_loop((a, b, with) in operands()) {
            let shape = with.output_shape(a.shape(), b.shape());
            let inner = if with.transpose_left { a.shape().h() } else { a.shape().w() };
            let at = |x: &Tensor<f64>, n: usize, c: usize, i: usize, j: usize, transposed: bool| {
                let (i, j) = if transposed { (j, i) } else { (i, j) };
                x.at(n.min(x.shape().n() - 1), c.min(x.shape().c() - 1), i, j)
            };
            let want = Tensor::from_fn(shape, |n, c, i, j| {
                (0..inner).map(|k| at(&a, n, c, i, k, with.transpose_left) * at(&b, n, c, k, j, with.transpose_right)).sum()
            });
            let tape = Tape::new();
            let got = tape.constant(a).matmul_with(tape.constant(b), with).value();
            prop_assert_eq!(got.shape(), shape);
            close(got.data(), want.data());
        }

        #[test]
        fn gradient_matches_finite_differences((a, b, with) in operands()) {
            testing::check(&[a, b], |v| v[0].matmul_with(v[1], with));
        }

        #[test]
        fn adjoint_law_holds_in_each_operand((a, b, with) in operands(), seed in any::<u64>()) {
            testing::check_adjoint(a.shape(), seed, |x| x.matmul_with(x.tape().constant(b.clone()), with));
            testing::check_adjoint(b.shape(), seed, |x| x.tape().constant(a.clone()).matmul_with(x, with));
        }
    }

    #[test]
    fn gradient_of_larger_matrices_matches_finite_differences() {
        for with in [MatMul::default(), MatMul { transpose_left: true, transpose_right: true, broadcast: true }] {
            let (left, right) = if with.broadcast { ([1, 2, 6, 7], [3, 1, 9, 6]) } else { ([3, 2, 7, 6], [3, 2, 6, 9]) };
            let (a, b) = (random(1, Shape(left), -1.0, 1.0), random(2, Shape(right), -1.0, 1.0));
            testing::check(&[a, b], |v| v[0].matmul_with(v[1], with));
        }
    }
}
