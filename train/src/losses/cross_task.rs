//! Cross-task consistency of DF-Net: rigid and optical flow must agree, and each teaches the other.
//!
//! **Formula**, for one scale, source and direction: `L = w sum(M (|u_rig - u_opt| + |v_rig - v_opt|)) / (sum(M) + 1e-3)` over the
//! whole batch, `w` half of [`SCALE_WEIGHTS`]; the divisor counts pixels, not components
//! [vt-vl-lab/DF-Net, `core/DFLearner.py`]. `M` keeps what both flows say is visible ([`mutual_mask`]).
//!
//! The sampler of the public code returns 0 also on the last column and row; here the masks use the standard one.

use dimode_autodiff::{Scalar, Tensor, Var};
use dimode_geometry::taped::masks;

/// Weights of the scales, finest first.
pub const SCALE_WEIGHTS: [f64; 4] = [12.7, 4.35, 3.9, 3.4];
/// Keeps the divisor away from 0, pixels.
const GUARD: f64 = 1e-3;

/// Flows of one pair of images in one direction, with the flows back, all `[n, 2, h, w]`, pixels.
#[derive(Clone, Copy, Debug)]
pub struct FlowPair<'t, T: Scalar> {
    /// From depth and motion.
    pub rigid: Var<'t, T>,
    /// From the flow network.
    pub optical: Var<'t, T>,
    /// Rigid flow of the other direction.
    pub rigid_back: Var<'t, T>,
    /// Optical flow of the other direction.
    pub optical_back: Var<'t, T>,
}

/// `sum(M (|du| + |dv|)) / (sum(M) + 1e-3)` of flows `[n, 2, h, w]` under a mask or weights `[n, 1, h, w]`; pixels.
///
/// **Gradient**: to both flows; freeze one by passing a constant. Slope 0 where they are equal; exactly 0 outside the mask,
/// whatever is there. An empty mask gives 0.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn cross_task<'t, T: Scalar>(rigid: Var<'t, T>, optical: Var<'t, T>, mask: &Tensor<T>) -> Var<'t, T> {
    let shape = rigid.shape();
    assert!(mask.shape() == shape.with_c(1), "cross_task: mask {} does not go with flows {shape}", mask.shape());
    rigid.weighted_l1(optical, mask, GUARD)
}

/// Pixels that leave the view by neither flow and pass the forward-backward test of both, `[n, 1, h, w]`, without gradient.
///
/// # Panics
/// When shapes differ.
#[must_use]
#[track_caller]
pub fn mutual_mask<T: Scalar>(pair: &FlowPair<'_, T>) -> Tensor<T> {
    let visible = |forward: Var<'_, T>, backward: Var<'_, T>| {
        let forward = forward.value();
        masks::all_of(&[&masks::in_view(&forward), &masks::not_occluded(&forward, &backward.value())])
    };
    masks::all_of(&[&visible(pair.rigid, pair.rigid_back), &visible(pair.optical, pair.optical_back)])
}

/// The whole loss of one source: both directions at every scale, finest first, each weighted `0.5 w_s`.
///
/// # Panics
/// When shapes differ, or there is no scale or more than four.
#[track_caller]
pub fn cross_task_of_scales<'t, T: Scalar>(scales: &[FlowPair<'t, T>]) -> Var<'t, T> {
    assert!((1..=SCALE_WEIGHTS.len()).contains(&scales.len()), "cross_task: one to four scales, got {}", scales.len());
    let terms = scales.iter().zip(SCALE_WEIGHTS).flat_map(|(pair, weight)| {
        let back =
            FlowPair { rigid: pair.rigid_back, optical: pair.optical_back, rigid_back: pair.rigid, optical_back: pair.optical };
        [*pair, back].map(|p| cross_task(p.rigid, p.optical, &mutual_mask(&p)).scale(0.5 * weight))
    });
    terms.reduce(|a, b| a.add(b)).expect("at least one scale")
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    const SHAPE: Shape = Shape([2, 2, 3, 4]);

    fn mask() -> Tensor<f64> {
        Tensor::from_fn(SHAPE.with_c(1), |n, _, h, w| f64::from(u8::from((n + h + w) % 3 != 0)))
    }

    #[test]
    fn worked_value_counts_pixels() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 2, 1, 3);
        let rigid = tape.leaf(Tensor::from_vec(shape, vec![1.0, 2.0, f64::NAN, 0.0, 0.0, 0.0]));
        let optical = tape.leaf(Tensor::from_vec(shape, vec![3.0, 2.0, 0.0, -1.0, 0.0, 0.0]));
        let mask = Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![1.0, 1.0, 0.0]);
        let loss = cross_task(rigid, optical, &mask);
        assert!((loss.value().item() - 3.0 / 2.001).abs() < 1e-15);
        let (grads, each) = (tape.backward(loss), 1.0 / 2.001);
        assert_eq!(grads.wrt(rigid).data(), [-each, 0.0, 0.0, each, 0.0, 0.0]);
        assert_eq!(grads.wrt(optical).data(), [each, 0.0, 0.0, -each, 0.0, 0.0]);
    }

    /// The loss as one operation or as many.
    type Form = for<'t> fn(Var<'t, f64>, Var<'t, f64>, &Tensor<f64>) -> Var<'t, f64>;

    /// The formula in small operations.
    fn composed<'t>(rigid: Var<'t, f64>, optical: Var<'t, f64>, mask: &Tensor<f64>) -> Var<'t, f64> {
        let (shape, tape) = (rigid.shape(), rigid.tape());
        let weights = tape.constant(mask.clone()).broadcast_to(shape);
        let (chosen, zero) = (weights.value(), tape.constant(Tensor::zeros(shape)));
        let difference = rigid.select(&chosen, zero).sub(optical.select(&chosen, zero)).abs();
        let count: f64 = mask.data().iter().sum();
        difference.mul(weights).sum().scale(1.0 / (count + GUARD))
    }

    #[test]
    fn it_equals_the_composed_form() {
        let shape = Shape::new(2, 2, 150, 131);
        let flows = [1, 2].map(|seed| random::<f64>(seed, shape, -3.0, 3.0));
        let weight = |n, h, w| [0.0, 1.0, 0.25][(n + 2 * h + w) % 3];
        let mask = Tensor::from_fn(shape.with_c(1), |n, _, h, w| weight(n, h, w));
        // What is masked may hold anything.
        let hole = |n, c, h, w| if weight(n, h, w) == 0.0 { f64::NAN } else { flows[0].at(n, c, h, w) };
        let holes = Tensor::from_fn(shape, hole);
        let run = |form: Form| {
            let tape = Tape::new();
            let [rigid, optical] = [&holes, &flows[1]].map(|flow| tape.leaf(flow.clone()));
            let loss = form(rigid, optical, &mask).scale(3.0);
            let grads = tape.backward(loss);
            [loss.value(), grads.wrt(rigid), grads.wrt(optical)]
        };
        for (fused, composed) in run(cross_task).iter().zip(&run(composed)) {
            for (f, c) in fused.data().iter().zip(composed.data()) {
                assert!((f - c).abs() <= 1e-10 * c.abs(), "{f} and {c}");
            }
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let inputs = [random(1, SHAPE, 0.0, 1.0), random(2, SHAPE, 1.5, 2.5)];
        gradcheck(&inputs, |_, v| cross_task(v[0], v[1], &mask()), GradCheck::default()).assert_ok();
    }

    #[test]
    fn an_empty_mask_and_equal_flows_cost_nothing() {
        let tape = Tape::<f64>::new();
        let (a, b) = (tape.leaf(random(1, SHAPE, 0.0, 1.0)), tape.leaf(random(2, SHAPE, 0.0, 1.0)));
        for loss in [cross_task(a, b, &Tensor::zeros(SHAPE.with_c(1))), cross_task(a, a, &mask())] {
            assert_eq!(loss.value().item(), 0.0);
            assert!(tape.backward(loss).wrt(a).data().iter().all(|&g| g == 0.0));
        }
    }

    #[test]
    fn scales_and_directions_add_up_over_what_both_flows_see() {
        let tape = Tape::<f64>::new();
        let along = |u: f64| tape.leaf(Tensor::from_fn(SHAPE, |_, c, _, _| if c == 0 { u } else { 0.0 }));
        let pair = FlowPair { rigid: along(1.0), optical: along(1.25), rigid_back: along(-1.0), optical_back: along(-1.0) };
        // Rigid flow keeps three columns of four; optical flow ends 0.25 px further right, where the last of them is out.
        let seen = mutual_mask(&pair);
        assert_eq!(seen.data()[..4], [1.0, 1.0, 0.0, 0.0]);
        // Forward 0.25 px on 12 pixels; back the flows are equal.
        let one = 0.25 * 12.0 / 12.001;
        let loss = cross_task_of_scales(&[pair, pair]).value().item();
        assert!((loss - 0.5 * (12.7 + 4.35) * one).abs() < 1e-12, "{loss}");
    }
}
