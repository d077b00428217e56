//! `y` = the axes in another order: axis `i` of the result is axis `order[i]` of the operand. Vector-Jacobian product: `g`
//! in the inverse order. Linear. Keeps: nothing but sizes.

use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{GradSink, Scalar, Shape, Tensor, Var, par};

/// Writes `x`, of `shape`, with its axes in `order`; serves both directions.
fn permute<T: Scalar>(x: &[T], shape: Shape, order: [usize; 4], y: &mut [T]) {
    let [_, c, h, w] = shape.0;
    let strides = order.map(|axis| [c * h * w, h * w, w, 1][axis]);
    let to = permuted(shape, order);
    let width = to.w().max(1);
    let rows_per_chunk = (par::CHUNK / width).max(1);
    par::for_each_chunk(y, rows_per_chunk * width, |chunk, y| {
        for (i, y) in y.chunks_exact_mut(width).enumerate() {
            let row = chunk * rows_per_chunk + i;
            let (h, c, n) = (row % to.h(), row / to.h() % to.c(), row / to.h() / to.c());
            let start = n * strides[0] + c * strides[1] + h * strides[2];
            if strides[3] == 1 {
                y.copy_from_slice(&x[start..start + width]);
            } else {
                y.iter_mut().zip(x[start..].iter().step_by(strides[3])).for_each(|(y, &x)| *y = x);
            }
        }
    });
}

fn permuted(shape: Shape, order: [usize; 4]) -> Shape {
    Shape(order.map(|axis| shape.0[axis]))
}

fn inverse(order: [usize; 4]) -> [usize; 4] {
    let mut inverse = [0; 4];
    for (i, axis) in order.into_iter().enumerate() {
        inverse[axis] = i;
    }
    inverse
}

impl<'t, T: Scalar> Var<'t, T> {
    /// The axes in another order: axis `i` of the result is axis `order[i]` of the operand.
    ///
    /// **Gradient**: `g` in the inverse order.
    ///
    /// **Panics** unless `order` holds each of 0, 1, 2, 3 once.
    #[track_caller]
    pub fn permute(self, order: [usize; 4]) -> Var<'t, T> {
        let shape = self.shape();
        let complete = (0..4).all(|axis| order.contains(&axis));
        assert!(complete, "permute: order {order:?} for shape {shape}; the rule: each of 0, 1, 2, 3 once");
        let to = permuted(shape, order);
        let mut y = self.tape().scratch(to.len());
        permute(self.value().data(), shape, order, &mut y);
        let y = self.tape().tensor(to, y);
        self.tape().push("permute", y, &[self], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| permute(g.data(), to, inverse(order), out));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Permute([usize; 4]);

impl Twin for Permute {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].permute(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let shape = Shape(self.0.map(|axis| x[0].shape.0[axis]));
        Plain::from_fn(shape, |to| {
            let mut from = [0; 4];
            for (i, axis) in self.0.into_iter().enumerate() {
                from[axis] = to[i];
            }
            x[0].at(from)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("permute");
    let mut cases = Vec::new();
    let orders = (0..256).map(|i| [i / 64, i / 16 % 4, i / 4 % 4, i % 4]);
    for order in orders.filter(|order| (0..4).all(|axis| order.contains(&axis))) {
        let shape = draw.shape([3, 4, 5, 6]);
        cases.push(Case::new(Permute(order), [draw.uniform(shape, -2.0, 2.0)]));
    }
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let order = [[0, 2, 3, 1], [3, 2, 1, 0], [1, 0, 2, 3]][i % 3];
        cases.push(Case::new(Permute(order), [draw.uniform(shape, -2.0, 2.0)]));
    }
    Proof::new("permute", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{inverse, permuted};
    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 2, 3), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let y = x.permute([0, 1, 3, 2]);
        assert_eq!(y.shape(), Shape::new(1, 1, 3, 2));
        close(y.value().data(), &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        let weights = tape.constant(Tensor::from_vec(y.shape(), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        close(tape.backward(y.mul(weights).sum()).wrt(x).data(), &[1.0, 3.0, 5.0, 2.0, 4.0, 6.0]);
    }

    #[test]
    #[should_panic(expected = "permute: order [0, 1, 1, 3] for shape [1, 2, 3, 4]")]
    fn incomplete_order_is_refused() {
        Tape::<f64>::new().leaf(Tensor::zeros(Shape::new(1, 2, 3, 4))).permute([0, 1, 1, 3]);
    }

    fn orders() -> impl Strategy<Value = [usize; 4]> {
        Just([0, 1, 2, 3]).prop_shuffle()
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn every_entry_arrives_at_its_place(shape in testing::shapes(), order in orders(), seed in any::<u64>()) {
            let tape = Tape::new();
            let x: Tensor<f64> = random(seed, shape, -2.0, 2.0);
            let back = inverse(order);
            let want = Tensor::from_fn(permuted(shape, order), |n, c, h, w| {
                let [n, c, h, w] = back.map(|i| [n, c, h, w][i]);
                x.at(n, c, h, w)
            });
            prop_assert_eq!(tape.leaf(x.clone()).permute(order).value(), want);
            prop_assert_eq!(tape.leaf(x.clone()).permute(order).permute(back).value(), x);
        }

        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), order in orders(), seed in any::<u64>()) {
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].permute(order));
        }

        #[test]
        fn adjoint_law_holds(shape in testing::shapes(), order in orders(), seed in any::<u64>()) {
            testing::check_adjoint(shape, seed, |x| x.permute(order));
        }
    }
}
