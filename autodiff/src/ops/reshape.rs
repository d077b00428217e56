//! `y` = the same elements, in row-major order, under another shape. Vector-Jacobian product: `g` under the old shape.
//! Linear. Keeps: nothing; neither pass copies an element.

use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{GradSink, Scalar, Shape, Tensor, Var};

impl<'t, T: Scalar> Var<'t, T> {
    /// The same elements under another shape of equal length; the buffer is shared.
    ///
    /// **Gradient**: `g` under the old shape.
    ///
    /// **Panics** when the shapes hold different numbers of elements.
    #[track_caller]
    pub fn reshape(self, shape: Shape) -> Var<'t, T> {
        let y = self.value().reshaped(shape);
        self.tape().push("reshape", y, &[self], |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.add_tensor(g);
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Reshape(Shape);

impl Twin for Reshape {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].reshape(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        Plain { shape: self.0, data: x[0].data.clone() }
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("reshape");
    let shapes = shapes(&mut draw);
    let case = |shape: Shape| {
        let [n, c, h, w] = shape.0;
        Case::new(Reshape(Shape::new(h, n * w, 1, c)), [draw.uniform(shape, -2.0, 2.0)])
    };
    Proof::new("reshape", shapes.into_iter().map(case).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_keep_their_order_and_gradients_return() {
        let tape = Tape::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 2, 1, 3), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
        let y = x.reshape(Shape::new(3, 1, 2, 1));
        close(y.value().data(), &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(y.value().at(1, 0, 0, 0), 3.0);
        let grads = tape.backward(y.square().sum());
        assert_eq!(grads.wrt(x).shape(), x.shape());
        close(grads.wrt(x).data(), &[2.0, 4.0, 6.0, 8.0, 10.0, 12.0]);
    }

    #[test]
    #[should_panic(expected = "reshape: [1, 2, 1, 3] and [1, 1, 1, 5] hold different numbers of elements")]
    fn another_length_is_refused() {
        Tape::<f64>::new().leaf(Tensor::zeros(Shape::new(1, 2, 1, 3))).reshape(Shape::new(1, 1, 1, 5));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let [n, c, h, w] = shape.0;
            testing::check(&[random(seed, shape, -2.0, 2.0)], |v| v[0].reshape(Shape::new(w, h * c, 1, n)));
        }

        #[test]
        fn adjoint_law_holds_beside_another_use(shape in testing::shapes(), seed in any::<u64>()) {
            let flat = Shape::new(1, 1, 1, shape.len());
            testing::check_adjoint(shape, seed, |x| x.reshape(flat).add(x.scale(3.0).reshape(flat)));
        }
    }
}
