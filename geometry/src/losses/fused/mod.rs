//! The four losses as one operation, for the forms that training uses and those of the paper.
//!
//! The composed form, [`AlignedPair`](super::AlignedPair) with [`planar()`](super::planar()), [`axial()`](super::axial()),
//! [`tangential()`](super::tangential()) and [`radial()`](super::radial()), says what is computed; this says the same fast.
//! The first pass over the pixels reads the source depth where the flow ends, aligns, and sums; the second, at the time of the
//! backward pass, aligns again and turns the gradients of the four losses into those of all inputs. Nothing else of the size of
//! an image is kept.
//!
//! One loss, one file; each has its sums, its value from them, and what it sends back.

mod aligned;
mod axial;
mod passes;
mod plan;
mod planar;
mod radial;
mod ratio;
mod residual;
mod rows;
mod sampling;
mod tangential;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use dimode_autodiff::{GradSink, Scalar, Shape, Tensor, Var};

use self::passes::{Gradients, Scene};
use self::plan::{Plan, Upstream, counts};
use self::rows::Sample;
use self::sampling::Grid;
use super::{LossOptions, LossTerm, PairInputs};
use crate::alignment::Convention;
use crate::taped::rigid_flow::{add_sums, check_motion};
use crate::taped::translation_in_target_frame;

/// `L_pla`, `L_axi`, `L_tan` and `L_rad`, those that are wanted; the others are 0 of no pixel.
///
/// `None` when a wanted loss has a form without a kernel, or the map has too many pixels to be counted in `T`: use the
/// composed form. There are kernels for the `Literal` forms and for the forms in pixels, mixed at will.
///
/// **Shapes**, **frames**: those of [`PairInputs`]. Values, numbers of pixels and gradients equal the composed ones.
/// **Gradient**: to both depths, rotation, translation and flow; exactly 0 at pixels that no loss uses, whatever they hold.
/// **Panics** when a shape does not fit.
#[must_use]
#[track_caller]
pub fn geometric_losses<'t, T: Scalar>(
    inputs: &PairInputs<'_, 't, T>,
    options: &LossOptions,
    wanted: [bool; 4],
) -> Option<[LossTerm<'t, T>; 4]> {
    let shape = inputs.target_depth.shape();
    check(inputs, shape);
    if !Grid::counts::<T>(shape) {
        return None;
    }
    let source_depth = if options.detach_source_depth { inputs.source_depth.detach() } else { inputs.source_depth };
    let a = match options.convention {
        Convention::AsPrinted => inputs.translation,
        Convention::Consistent => translation_in_target_frame(inputs.rotation, inputs.translation),
    };
    let parents = [inputs.target_depth, source_depth, inputs.rotation, a, inputs.flow];
    let scene = scene(inputs, options, wanted, parents)?;
    let tape = a.tape();
    let pool = tape.pool().clone();
    let mut read = tape.scratch(shape.len());
    let sums = scene.sum(&pool, &mut read);
    let values = scene.samples.iter().zip(&sums).flat_map(|((sample, plan), sums)| plan.values(sample, sums));
    let values = Tensor::from_vec(Shape::new(shape.n(), 4, 1, 1), values.map(T::from_f64).collect());
    let pixels: Vec<[usize; 4]> = sums.iter().map(counts).collect();
    let read = Arc::new(tape.tensor(shape, read));
    let through_reading = !options.detach_source_depth;
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        let g = |n: usize| std::array::from_fn(|k| g.at(n, k, 0, 0).to_f64());
        let upstream: Vec<_> = sums.iter().enumerate().map(|(n, &sums)| Upstream { g: g(n), sums }).collect();
        let mut to_target = grads.scratch(shape.len());
        let mut to_source = grads.needs(1).then(|| grads.scratch(shape.len()));
        let mut to_flow = grads.needs(4).then(|| grads.scratch(2 * shape.len()));
        let out = Gradients {
            target_depth: &mut to_target,
            source_depth: to_source.as_deref_mut(),
            flow: to_flow.as_deref_mut().map(|flow| (flow, through_reading)),
        };
        let motion = scene.spread(&pool, read.data(), &upstream, out);
        for (k, gradient) in [(0, Some(to_target)), (1, to_source), (4, to_flow)] {
            let Some(gradient) = gradient else { continue };
            match grads.slot(k) {
                Some(mut slot) => slot.add_fresh(gradient),
                None => grads.give_back(gradient),
            }
        }
        add_sums(grads, 2, &motion, 0..9);
        add_sums(grads, 3, &motion, 9..12);
    };
    let losses = tape.push("geometric_losses", values, &parents, record);
    Some(std::array::from_fn(|k| {
        let counts = pixels.iter().map(|pixels| pixels[k]).collect();
        LossTerm::from_counts(losses.slice(1, k, 1), counts, shape.plane(), options.min_valid_share)
    }))
}

#[track_caller]
fn check<T: Scalar>(inputs: &PairInputs<'_, '_, T>, shape: Shape) {
    let (source, flow, mask) = (inputs.source_depth.shape(), inputs.flow.shape(), inputs.mask.shape());
    assert!(shape.c() == 1, "geometric_losses: target depth has shape (N, 1, H, W), got {shape}");
    assert!(source == shape && mask == shape, "geometric_losses: source depth {source} and mask {mask} must be {shape}");
    assert!(flow == shape.with_c(2), "geometric_losses: flow has shape {}, got {flow}", shape.with_c(2));
    check_motion("geometric_losses", shape, inputs.rotation.shape(), inputs.translation.shape(), inputs.intrinsics);
}

/// What both passes read; `None` when a form has no kernel.
fn scene<T: Scalar>(
    inputs: &PairInputs<'_, '_, T>,
    options: &LossOptions,
    wanted: [bool; 4],
    [target_depth, source_depth, rotation, a, flow]: [Var<'_, T>; 5],
) -> Option<Scene<T>> {
    let (rotation, a) = (rotation.value(), a.value());
    let noisy = options.noise_pixels > 0.0 || options.noise_share > 0.0;
    let noise = noisy.then_some([options.noise_pixels, options.noise_share]);
    let sample = |(n, camera)| {
        let sample = Sample::new(camera, rotation.data(), a.data(), n, options.z_min, noise);
        Plan::new(options, wanted, &sample).map(|plan| (sample, plan))
    };
    Some(Scene {
        grid: Grid::new(target_depth.shape()),
        target_depth: target_depth.value(),
        source_depth: source_depth.value(),
        flow: flow.value(),
        mask: inputs.mask.clone(),
        samples: inputs.intrinsics.iter().enumerate().map(sample).collect::<Option<_>>()?,
    })
}
