//! Unsupervised loss of the flow network: the warped source must look like the target.
//!
//! `L = sum_i 0.8^(N-1-i) [ mean over in-view pixels of photometric(source(p + F_i), target) + w second_order(F_i) ]`; the second
//! differences of the flow are weighted by `exp(-10 mean_c |I_x|)`, so that kinks are cheap where the image has an edge.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Tensor, Var};
use dimode_geometry::taped::{masks, warp};

use super::photometric::photometric;
use super::raft_sequence::GAMMA;

/// Sharpness of the edge weight of the second-order term.
const EDGE: f64 = 10.0;

/// Loss of successive flows `[n, 2, h, w]` (pixels, target to source) between images `[n, 3, h, w]`.
///
/// # Panics
/// When there is no flow or shapes differ.
#[track_caller]
pub fn flow_photometric<'t, T: Scalar>(
    flows: &[Var<'t, T>],
    target: Var<'t, T>,
    source: Var<'t, T>,
    smoothness: f64,
) -> Var<'t, T> {
    let tape = target.tape();
    let mut total = tape.constant(Tensor::scalar(T::ZERO));
    for (i, &flow) in flows.iter().enumerate() {
        let error = photometric(warp(source, flow, SamplePadding::Border), target);
        let seen = error.masked_mean(&masks::in_view(&flow.value())).mean();
        let smooth = second_order(flow, &target.value()).scale(smoothness);
        total = total.add(seen.add(smooth).scale(GAMMA.powi((flows.len() - 1 - i) as i32)));
    }
    total
}

/// Edge-weighted mean of absolute second differences along rows and columns, halved each.
fn second_order<'t, T: Scalar>(flow: Var<'t, T>, image: &Tensor<T>) -> Var<'t, T> {
    let terms = [2, 3].map(|axis| {
        let len = flow.shape().0[axis];
        let first = flow.slice(axis, 1, len - 1).sub(flow.slice(axis, 0, len - 1));
        let second = first.slice(axis, 1, len - 2).sub(first.slice(axis, 0, len - 2)).abs();
        let weight = flow.tape().constant(edge_weight(image, axis));
        second.mul(weight.broadcast_to(second.shape())).mean().scale(0.5)
    });
    terms[0].add(terms[1])
}

/// `exp(-EDGE mean_c |I(i + 2) - I(i + 1)|)` along an axis.
fn edge_weight<T: Scalar>(image: &Tensor<T>, axis: usize) -> Tensor<T> {
    let mut shape = image.shape().with_c(1);
    shape.0[axis] -= 2;
    let (dy, dx) = if axis == 2 { (1, 0) } else { (0, 1) };
    let channels = image.shape().c();
    Tensor::from_fn(shape, |n, _, h, w| {
        let sum = (0..channels)
            .map(|c| (image.at(n, c, h + 2 * dy, w + 2 * dx) - image.at(n, c, h + dy, w + dx)).abs())
            .fold(T::ZERO, |a, b| a + b);
        (sum * T::from_f64(-EDGE / channels as f64)).exp()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    #[test]
    fn the_true_shift_costs_less_than_none() {
        let tape = Tape::<f64>::new();
        let texture = random::<f64>(3, Shape::new(1, 3, 8, 13), 0.0, 1.0);
        let crop = |x0: usize| Tensor::from_fn(Shape::new(1, 3, 8, 12), |n, c, h, w| texture.at(n, c, h, w + x0));
        let (target, source) = (tape.constant(crop(0)), tape.constant(crop(1)));
        // target(u) = texture(u) = source(u - 1)
        let shape = Shape::new(1, 2, 8, 12);
        let right = tape.constant(Tensor::from_fn(shape, |_, c, _, _| if c == 0 { -1.0 } else { 0.0 }));
        let none = tape.constant(Tensor::zeros(shape));
        let cost = |f| flow_photometric(&[f], target, source, 0.1).value().item();
        assert!(cost(right) < 0.2 * cost(none), "{} against {}", cost(right), cost(none));
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let image = |seed| random::<f64>(seed, Shape::new(1, 3, 5, 6), 0.0, 1.0);
        let flow = random::<f64>(9, Shape::new(1, 2, 5, 6), 0.1, 0.9);
        let (target, source) = (image(1), image(2));
        let check = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, allow_zero: false };
        gradcheck(
            &[flow],
            |tape, v| flow_photometric(&[v[0]], tape.constant(target.clone()), tape.constant(source.clone()), 0.3),
            check,
        )
        .assert_ok();
    }
}
