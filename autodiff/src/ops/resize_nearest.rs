//! Resizing of planes to a given size without blending: larger or smaller, every position takes one element.
//!
//! `y[i, j] = x[floor(i H / H'), floor(j W / W')]` for a result of `H' x W'`, in exact integers.
//! Vector-Jacobian product: `g` summed over the positions that took an element; 0 where none did. Linear. Keeps: nothing but sizes.

use std::sync::Arc;

use super::planes::for_each_plane;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin};
use crate::{Scalar, Shape, Var};

/// The element that each of `out` positions takes from an axis of `size`.
fn sources(size: usize, out: usize) -> Vec<usize> {
    (0..out).map(|i| i * size / out).collect()
}

/// The sources of both axes and the row length.
struct Plan {
    rows: Vec<usize>,
    columns: Vec<usize>,
    width: usize,
}

impl Plan {
    fn forward_plane<T: Scalar>(&self, x: &[T], y: &mut [T]) {
        for (&row, out) in self.rows.iter().zip(y.chunks_exact_mut(self.columns.len())) {
            let x = &x[row * self.width..][..self.width];
            for (o, &column) in out.iter_mut().zip(&self.columns) {
                *o = x[column];
            }
        }
    }

    fn backward_plane<T: Scalar>(&self, g: &[T], gx: &mut [T]) {
        gx.fill(T::ZERO);
        for (&row, grad) in self.rows.iter().zip(g.chunks_exact(self.columns.len())) {
            let gx = &mut gx[row * self.width..][..self.width];
            for (&g, &column) in grad.iter().zip(&self.columns) {
                gx[column] += g;
            }
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Resizes every plane to `height` x `width` by taking the nearest element above and to the left.
    ///
    /// **Shapes**: `[n, c, h, w]` to `[n, c, height, width]`. For whole factors see also [`Var::upsample_nearest`].
    ///
    /// **Gradient**: the sum over the positions that took an element.
    ///
    /// **Panics** when the requested size is empty. Equals PyTorch's `interpolate(mode="nearest")`, except for
    /// the rare sizes at which its ratio in single precision rounds a whole position down to the element before it.
    #[track_caller]
    pub fn resize_nearest(self, height: usize, width: usize) -> Var<'t, T> {
        let shape = self.shape();
        assert!(height > 0 && width > 0, "resize_nearest: input {shape} to {height}x{width}; the rule: at least 1x1");
        let out_shape = shape.with_plane(height, width);
        let (plane, out_plane) = (shape.plane(), out_shape.plane());
        let plan = Arc::new(Plan { rows: sources(shape.h(), height), columns: sources(shape.w(), width), width: shape.w() });
        let x = self.value();
        let mut y = self.tape().scratch(out_shape.len());
        for_each_plane(&mut y, out_plane, |i, out| plan.forward_plane(&x.data()[i * plane..][..plane], out));
        let y = self.tape().tensor(out_shape, y);
        self.tape().push("resize_nearest", y, &[self], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| plan.backward_plane(&g.data()[i * out_plane..][..out_plane], out));
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct ResizeNearest {
    height: usize,
    width: usize,
}

impl Twin for ResizeNearest {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].resize_nearest(self.height, self.width)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let from = x[0].shape;
        Plain::from_fn(from.with_plane(self.height, self.width), |[n, c, i, j]| {
            x[0].at([n, c, i * from.h() / self.height, j * from.w() / self.width])
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("resize_nearest");
    let sizes = [
        ([1, 1, 1, 1], [1, 1]),
        ([1, 1, 1, 1], [3, 2]),
        ([2, 3, 5, 4], [1, 1]),
        ([1, 2, 3, 4], [6, 8]),
        ([1, 2, 6, 8], [3, 4]),
        ([1, 1, 1, 6], [4, 9]),
        ([3, 2, 4, 1], [7, 1]),
        ([1, 2, 7, 5], [3, 11]),
        ([2, 2, 3, 2], [10, 5]),
        ([2, 3, 11, 31], [9, 40]),
    ];
    let case = |(shape, [height, width]): ([usize; 4], [usize; 2])| {
        Case::new(ResizeNearest { height, width }, [draw.uniform(Shape(shape), -1.0, 1.0)])
    };
    Proof::new("resize_nearest", sizes.map(case))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::sources;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{self, close, random};
    use crate::{Tape, Tensor};

    #[test]
    fn positions_are_rounded_down() {
        assert_eq!(sources(3, 5), [0, 0, 1, 1, 2]);
        assert_eq!(sources(5, 3), [0, 1, 3]);
        assert_eq!(sources(4, 2), [0, 2]);
        assert_eq!(sources(2, 82)[40..42], [0, 1]);
        assert_eq!(sources(1, 4), [0; 4]);
    }

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 1, 2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let y = x.resize_nearest(3, 2);
        close(y.value().data(), &[1.0, 2.0, 1.0, 2.0, 4.0, 5.0]);
        let weights = tape.constant(Tensor::from_fn(y.shape(), |_, _, h, w| (10 * h + w + 1) as f64));
        close(tape.backward(y.mul(weights).sum()).wrt(x).data(), &[12.0, 14.0, 0.0, 21.0, 22.0, 0.0]);
    }

    #[test]
    #[should_panic(expected = "resize_nearest: input [1, 1, 2, 2] to 0x3; the rule: at least 1x1")]
    fn an_empty_result_is_refused() {
        Tape::new().constant(noise(1, [1, 1, 2, 2])).resize_nearest(0, 3);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), h in 1..8usize, w in 1..8usize, seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.resize_nearest(h, w));
        }

        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), h in 1..8usize, w in 1..8usize, seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -1.0, 1.0)], |v| v[0].resize_nearest(h, w));
        }

        #[test]
        fn whole_factors_repeat_blocks_and_the_way_back_is_exact(
            shape in testing::shapes(), factor in 1..4usize, seed in any::<u64>()
        ) {
            let tape = Tape::<f64>::new();
            let x = tape.constant(random(seed, shape, -1.0, 1.0));
            let y = x.resize_nearest(shape.h() * factor, shape.w() * factor);
            prop_assert_eq!(y.value(), x.upsample_nearest(factor).value());
            prop_assert_eq!(y.resize_nearest(shape.h(), shape.w()).value(), x.value());
        }
    }
}
