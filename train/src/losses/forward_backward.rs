//! Forward-backward consistency of two flows: following one there and the other back must end where one started.
//!
//! **Formula**: `L = mean |F(p) + B(p + F(p))|`, pixels, `B` read bilinearly with 0 outside
//! [Huangying-Zhan/DF-VO, `libs/deep_models/flow/deep_flow.py`, which weighs it 0.005 and halves it at each coarser scale].

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Var};
use dimode_geometry::taped::smooth::length;
use dimode_geometry::taped::warp;

/// Weight of the term in DF-VO's online refinement.
pub const WEIGHT: f64 = 0.005;

/// Mean deviation in pixels of flows `[n, 2, h, w]`, `forward` from target to source and `backward` back.
///
/// **Gradient**: to both flows, to `forward` also through the place where `backward` is read. Slope 0 where the deviation is 0.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn forward_backward<'t, T: Scalar>(forward: Var<'t, T>, backward: Var<'t, T>) -> Var<'t, T> {
    deviation(forward, backward).mean()
}

/// The length of the deviation at every pixel, `[n, 1, h, w]`.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn deviation<'t, T: Scalar>(forward: Var<'t, T>, backward: Var<'t, T>) -> Var<'t, T> {
    let rest = forward.add(warp(backward, forward, SamplePadding::Zeros));
    length(rest.slice(1, 0, 1), rest.slice(1, 1, 1), 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, Tensor, gradcheck};

    #[test]
    fn opposite_translations_agree_except_where_they_leave_the_image() {
        let tape = Tape::<f64>::new();
        let along = |u: f64| Tensor::from_fn(Shape::new(1, 2, 2, 4), |_, c, _, _| if c == 0 { u } else { 0.0 });
        let (forward, backward) = (tape.leaf(along(1.0)), tape.leaf(along(-1.0)));
        let loss = forward_backward(forward, backward);
        // One column of four reads 0 outside.
        assert_eq!(loss.value().item(), 0.25);
        let grads = tape.backward(loss);
        let expected = Tensor::from_fn(Shape::new(1, 2, 2, 4), |_, c, _, w| if c == 0 && w == 3 { 0.125 } else { 0.0 });
        // There the reading slides out of the image: its slope, 1, is that of the forward flow's end.
        assert_eq!(grads.wrt(backward).data(), [0.0; 16]);
        for (found, at) in grads.wrt(forward).data().iter().zip(expected.data()) {
            assert_eq!(*found != 0.0, *at != 0.0);
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let shape = Shape::new(2, 2, 4, 5);
        // Ends stay between pixels: 0.2 to 0.8 right of and below the start.
        let inputs = [random(1, shape, 0.2, 0.8), random(2, shape, -2.0, -1.0)];
        let check = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
        gradcheck(&inputs, |_, v| forward_backward(v[0], v[1]), check).assert_ok();
    }
}
