//! Batched matrix product over the last two axes: `c[n, c] = a[n, c] b[n, c]`.
//!
//! vjp: `da = g b^T`, `db = a^T g`. Linear in each operand, no kinks. Keeps both operands, each only when the other one needs
//! its gradient.

use crate::gemm::View;
use crate::{Scalar, Var, par};

/// Multiplications of one unit of work, below which matrices are grouped.
const UNIT: usize = 1 << 16;

impl<'t, T: Scalar> Var<'t, T> {
    /// Matrix product of each `(n, c)` pair of planes: `[n, c, m, k] x [n, c, k, p] -> [n, c, m, p]`.
    ///
    /// # Panics
    /// When the leading axes or the inner sizes differ.
    #[track_caller]
    pub fn matmul(self, other: Var<'t, T>) -> Var<'t, T> {
        let (a, b) = (self.value(), other.value());
        let (sa, sb) = (a.shape(), b.shape());
        assert!(
            sa.n() == sb.n() && sa.c() == sb.c() && sa.w() == sb.h(),
            "matmul: needs [n, c, m, k] x [n, c, k, p], got {sa} x {sb}"
        );
        let (m, k, p) = (sa.h(), sa.w(), sb.w());
        let shape = sa.with_plane(m, p);
        let mut out = self.tape().scratch(shape.len());
        batched(&mut out, [m, k, p], false, |i| {
            (View::new(&a.data()[i * m * k..][..m * k], m, k), View::new(&b.data()[i * k * p..][..k * p], k, p))
        });
        let output = self.tape().tensor(shape, out);
        let a = other.requires_grad().then_some(a);
        let b = self.requires_grad().then_some(b);
        self.tape().push("matmul", output, &[self, other], move |g, grads| {
            let g = g.data();
            if let (Some(mut slot), Some(b)) = (grads.slot(0), &b) {
                batched(slot.as_mut_slice(), [m, p, k], true, |i| {
                    let b = View::transpose_of(&b.data()[i * k * p..][..k * p], p, k);
                    (View::new(&g[i * m * p..][..m * p], m, p), b)
                });
            }
            if let (Some(mut slot), Some(a)) = (grads.slot(1), &a) {
                batched(slot.as_mut_slice(), [k, m, p], true, |i| {
                    let a = View::transpose_of(&a.data()[i * m * k..][..m * k], k, m);
                    (a, View::new(&g[i * m * p..][..m * p], m, p))
                });
            }
        })
    }

    /// Transposes every plane: `[n, c, h, w] -> [n, c, w, h]`.
    pub fn transpose_hw(self) -> Var<'t, T> {
        self.permute([0, 1, 3, 2])
    }
}

/// Products of many small matrices, grouped into units of fixed size. `sizes` are rows, inner size and columns.
fn batched<'a, T: Scalar>(
    out: &mut [T],
    sizes: [usize; 3],
    add: bool,
    operands: impl Fn(usize) -> (View<'a, T>, View<'a, T>) + Sync + Send,
) {
    let [m, k, p] = sizes;
    let group = (UNIT / (m * k * p).max(1)).max(1);
    par::for_each_chunk(out, group * m * p, |chunk, out| {
        for (j, out) in out.chunks_mut(m * p).enumerate() {
            let (a, b) = operands(chunk * group + j);
            if m * k * p <= 64 { small(out, a, b, add) } else { T::gemm(out, a, b, add) }
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

#[cfg(test)]
mod tests {
    use crate::gradcheck::{random, weighted_sum};
    use crate::{GradCheck, Shape, Tape, Tensor, gradcheck};

    #[test]
    fn worked_product() {
        let tape = Tape::<f64>::new();
        let a = tape.constant(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![2.0, 3.0]));
        let b = tape.constant(Tensor::from_vec(Shape::new(1, 1, 2, 2), vec![1.0, 4.0, 5.0, 6.0]));
        assert_eq!(a.matmul(b).value().data(), [17.0, 26.0]);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for (i, [n, c, m, k, p]) in [[1, 1, 1, 1, 1], [2, 1, 3, 3, 1], [3, 2, 2, 5, 4], [1, 2, 7, 6, 9]].into_iter().enumerate() {
            let a = random(i as u64, Shape::new(n, c, m, k), -1.0, 1.0);
            let b = random(i as u64 + 9, Shape::new(n, c, k, p), -1.0, 1.0);
            gradcheck(&[a, b], |_, v| weighted_sum(v[0].matmul(v[1]), 5), GradCheck::default()).assert_ok();
        }
    }

    #[test]
    #[should_panic(expected = "matmul: needs [n, c, m, k] x [n, c, k, p], got [1, 1, 2, 3] x [1, 1, 2, 3]")]
    fn rejects_unequal_inner_sizes() {
        let tape = Tape::<f32>::new();
        let a = tape.constant(Tensor::zeros(Shape::new(1, 1, 2, 3)));
        a.matmul(a);
    }
}
