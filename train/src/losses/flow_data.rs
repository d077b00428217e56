//! Unsupervised loss of the flow network: the warped source must look like the target, and the flow be smooth.
//!
//! **Formula**: `L = sum_i 0.8^(N-1-i) [ data(source(p + F_i), target) + w smoothness(F_i) ]` over `N` successive flows. What the
//! images are compared by is a [`FlowDataTerm`], over which pixels a [`Visibility`], and how the flow is smooth a
//! [`FlowSmoothness`].

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Tensor, Var};
use dimode_geometry::taped::weighted::weighted_mean;
use dimode_geometry::taped::{masks, visibility, warp};

use super::census::{CensusForm, census};
use super::flow_smoothness::{FlowSmoothness, flow_smoothness};
use super::occluded_photometric::occluded_photometric;
use super::photometric::photometric;
use super::raft_sequence::GAMMA;

/// Source pixels that must flow to a target pixel for it to count as seen, as ARFlow has it.
pub const REACHED: f64 = 0.2;

/// Which target pixels the source is expected to show; all of them are also in view. Backward flows lead from source to target.
#[derive(Clone, Copy, Debug)]
pub enum Visibility<'a, T: Scalar> {
    /// The flow ends inside the source.
    InView,
    /// And the flow back ends near the start: [`masks::not_occluded`].
    ForwardBackward(&'a Tensor<T>),
    /// And enough source pixels flow here: [`visibility::reached`] with this threshold.
    Reached(&'a Tensor<T>, f64),
    /// As [`Visibility::Reached`], weighted by how many do: [`visibility::reached_softly`].
    ReachedSoftly(&'a Tensor<T>),
}

impl<T: Scalar> Visibility<'_, T> {
    /// The weights in [0, 1] of the pixels for a forward flow `[n, 2, h, w]`; `[n, 1, h, w]`, without gradient.
    ///
    /// # Panics
    /// When the flows' shapes differ.
    #[must_use]
    #[track_caller]
    pub fn weights(self, flow: &Tensor<T>) -> Tensor<T> {
        let seen = masks::in_view(flow);
        match self {
            Self::InView => seen,
            Self::ForwardBackward(backward) => masks::all_of(&[&masks::not_occluded(flow, backward), &seen]),
            Self::Reached(backward, least) => masks::all_of(&[&visibility::reached(backward, least), &seen]),
            Self::ReachedSoftly(backward) => masks::all_of(&[&visibility::reached_softly(backward), &seen]),
        }
    }
}

/// How the warped source is compared with the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlowDataTerm {
    /// Mean of [`photometric`] over the visible pixels of each image.
    Photometric,
    /// [`census`] over the visible pixels of the batch.
    Census(CensusForm),
    /// [`occluded_photometric`] of the batch.
    Occluded,
}

impl FlowDataTerm {
    fn measure<'t, T: Scalar>(self, warped: Var<'t, T>, target: Var<'t, T>, weights: &Tensor<T>) -> Var<'t, T> {
        match self {
            Self::Photometric => weighted_mean(photometric(warped, target), weights).mean(),
            Self::Census(form) => census(warped, target, weights, form),
            Self::Occluded => occluded_photometric(target, warped, weights),
        }
    }
}

/// The loss of successive flows `[n, 2, h, w]` (pixels, target to source) between target and source `[n, 3, h, w]`, with a form of
/// smoothness and its weight.
///
/// **Gradient**: to the flows and the images; none through the choice of pixels. Pixels that are not visible have none of the data
/// term, and an image without a visible pixel counts 0.
///
/// # Panics
/// When there is no flow or shapes differ.
#[track_caller]
pub fn flow_data<'t, T: Scalar>(
    data: FlowDataTerm,
    flows: &[Var<'t, T>],
    [target, source]: [Var<'t, T>; 2],
    (form, smoothness): (FlowSmoothness, f64),
    visible: Visibility<'_, T>,
) -> Var<'t, T> {
    assert!(!flows.is_empty(), "flow_data: at least one flow");
    let tape = target.tape();
    let mut total = tape.constant(Tensor::scalar(T::ZERO));
    for (i, &flow) in flows.iter().enumerate() {
        let warped = warp(source, flow, SamplePadding::Border);
        let seen = data.measure(warped, target, &visible.weights(&flow.value()));
        let smooth = flow_smoothness(flow, &target.value(), form).scale(smoothness);
        total = total.add(seen.add(smooth).scale(GAMMA.powi((flows.len() - 1 - i) as i32)));
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    /// The photometric form with second-order smoothness.
    fn photometric_flow<'t>(
        flows: &[Var<'t, f64>],
        images: [Var<'t, f64>; 2],
        smoothness: f64,
        visible: Visibility<'_, f64>,
    ) -> Var<'t, f64> {
        let form = FlowSmoothness::Second { edge: 10.0 };
        flow_data(FlowDataTerm::Photometric, flows, images, (form, smoothness), visible)
    }

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
        let cost = |f| photometric_flow(&[f], [target, source], 0.1, Visibility::InView).value().item();
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
            |tape, v| {
                let images = [&target, &source].map(|image| tape.constant(image.clone()));
                photometric_flow(&[v[0]], images, 0.3, Visibility::InView)
            },
            check,
        )
        .assert_ok();
    }

    #[test]
    fn every_kind_of_visibility_drops_its_pixels() {
        // Two pixels leave the view on the right; the flow back is right but for one pixel and one row that nothing reaches.
        let shape = Shape::new(1, 2, 3, 6);
        let forward = Tensor::from_fn(shape, |_, c, _, _| if c == 0 { 2.0 } else { 0.0 });
        let backward = Tensor::from_fn(shape, |_, c, h, w| match (c, h, w) {
            (0, 1, 3) => 1.0,
            (1, 2, _) => 50.0,
            (0, ..) => -2.0,
            _ => 0.0,
        });
        let weights = |kind: Visibility<'_, f64>| kind.weights(&forward).to_vec();
        assert_eq!(weights(Visibility::InView), [1.0, 1.0, 1.0, 1.0, 0.0, 0.0].repeat(3));
        let whole = [1.0, 1.0, 1.0, 1.0, 0.0, 0.0];
        let hole = [1.0, 0.0, 1.0, 1.0, 0.0, 0.0];
        for kind in
            [Visibility::ForwardBackward(&backward), Visibility::Reached(&backward, 0.2), Visibility::ReachedSoftly(&backward)]
        {
            assert_eq!(weights(kind), [whole, hole, [0.0; 6]].concat(), "{kind:?}");
        }
    }

    #[test]
    fn gradient_over_soft_weights_matches_finite_differences_and_hidden_images_have_none() {
        let shape = Shape::new(2, 2, 5, 6);
        let image = |seed| random::<f64>(seed, Shape::new(2, 3, 5, 6), 0.0, 1.0);
        let (target, source) = (image(1), image(2));
        // Nothing of the second source image flows back into the second target.
        let backward = Tensor::from_fn(shape, |n, c, h, w| if n == 1 { 90.0 } else { 0.3 * (c + h + w) as f64 - 1.0 });
        let loss = |tape: &'_ Tape<f64>, flow: Tensor<f64>| {
            let flow = tape.leaf(flow);
            let (target, source) = (tape.constant(target.clone()), tape.constant(source.clone()));
            let loss = photometric_flow(&[flow], [target, source], 0.0, Visibility::ReachedSoftly(&backward));
            tape.backward(loss).wrt(flow)
        };
        let flow = random::<f64>(9, shape, 0.1, 0.9);
        let grad = loss(&Tape::new(), flow.clone());
        assert!(grad.plane(0, 0).iter().any(|&g| g != 0.0));
        assert!([grad.plane(1, 0), grad.plane(1, 1)].concat().iter().all(|&g| g == 0.0));
        let check = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-8, allow_zero: false };
        gradcheck(
            &[flow],
            |tape, v| {
                let (target, source) = (tape.constant(target.clone()), tape.constant(source.clone()));
                photometric_flow(&[v[0]], [target, source], 0.3, Visibility::ReachedSoftly(&backward))
            },
            check,
        )
        .assert_ok();
    }
}
