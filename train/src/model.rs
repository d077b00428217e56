//! The networks of a run, and their weights.

use std::sync::Arc;

use dimode_autodiff::{Pool, Scalar, Shape, Tensor, Var};
use dimode_nets::{Binder, DepthNet, FlowNet, Network, ParamSet, PoseNet, RectifyNet};

use crate::config::{Config, NetsConfig, SCALE_ANCHOR};

/// How a sigmoid output becomes depth: `1 / depth = 1/max + (1/min - 1/max) disparity`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthRange {
    /// Depth at disparity 1.
    pub min: f64,
    /// Depth at disparity 0.
    pub max: f64,
}

impl DepthRange {
    /// Monodepth2's: 0.1 to 100.
    pub const MONODEPTH: DepthRange = DepthRange { min: 0.1, max: 100.0 };
    /// Of both SC-Depth programs, `1 / depth = 10 disparity + 0.01`: 0.0999 to 100.
    pub const SC_DEPTH: DepthRange = DepthRange { min: 1.0 / 10.01, max: 100.0 };

    /// Depth `[n, 1, h, w]` of disparities in (0, 1).
    pub fn depth<'t, T: Scalar>(self, disparity: Var<'t, T>) -> Var<'t, T> {
        self.inverse_depth(disparity).recip()
    }

    /// `1 / depth`, `[n, 1, h, w]`, of disparities in (0, 1).
    pub fn inverse_depth<'t, T: Scalar>(self, disparity: Var<'t, T>) -> Var<'t, T> {
        disparity.scale(1.0 / self.min - 1.0 / self.max).add_scalar(1.0 / self.max)
    }

    /// The disparity of a depth: 1 at the smallest, 0 at the largest, beyond them outside of (0, 1).
    pub fn disparity(self, depth: f64) -> f64 {
        (1.0 / depth - 1.0 / self.max) / (1.0 / self.min - 1.0 / self.max)
    }

    /// Depth at the mean disparity near which training holds a network ([`SCALE_ANCHOR`]).
    pub fn usual(self) -> f64 {
        1.0 / (1.0 / self.max + (1.0 / self.min - 1.0 / self.max) * SCALE_ANCHOR)
    }

    /// Depth of plain disparities.
    pub fn depth_values(self, disparity: &Tensor<f32>) -> Tensor<f32> {
        self.depth_in(&Pool::new(), disparity)
    }

    /// The same in a buffer of a pool.
    pub fn depth_in(self, pool: &Arc<Pool<f32>>, disparity: &Tensor<f32>) -> Tensor<f32> {
        let (scale, offset) = ((1.0 / self.min - 1.0 / self.max) as f32, (1.0 / self.max) as f32);
        let mut depth = pool.take(disparity.shape().len());
        for (z, d) in depth.iter_mut().zip(disparity.data()) {
            *z = 1.0 / (offset + scale * d);
        }
        Tensor::pooled(disparity.shape(), depth, pool)
    }
}

/// The networks of a run: descriptions without numbers.
#[derive(Clone, Debug)]
pub struct Model {
    /// Depth from one image.
    pub depth: DepthNet,
    /// Motion between two images.
    pub pose: PoseNet,
    /// Optical flow between two images.
    pub flow: FlowNet,
    /// Rotation between two images, where it is removed first.
    pub rectify: Option<RectifyNet>,
    /// Disparity to depth.
    pub range: DepthRange,
    /// Factors on the pose network's rotation vector, tangential and radial translation.
    pub pose_scale: [f64; 3],
    /// Refinements of the flow network.
    pub flow_iterations: usize,
}

/// The numbers of the networks.
#[derive(Clone, Debug)]
pub struct Weights {
    /// Of the depth network.
    pub depth: ParamSet<f32>,
    /// Of the pose network.
    pub pose: ParamSet<f32>,
    /// Of the flow network.
    pub flow: ParamSet<f32>,
    /// Of the network that removes rotation; empty without one.
    pub rectify: ParamSet<f32>,
}

impl Weights {
    /// Names of the networks, as in checkpoints and logs.
    pub const NAMES: [&'static str; 4] = ["depth", "pose", "flow", "rectify"];

    /// All of them in the order of [`Weights::NAMES`].
    pub fn sets(&self) -> [&ParamSet<f32>; 4] {
        [&self.depth, &self.pose, &self.flow, &self.rectify]
    }

    /// All of them in the order of [`Weights::NAMES`].
    pub fn sets_mut(&mut self) -> [&mut ParamSet<f32>; 4] {
        [&mut self.depth, &mut self.pose, &mut self.flow, &mut self.rectify]
    }
}

impl Model {
    /// The networks of a run: those that its configuration names, for frames of its size.
    pub fn of(config: &Config) -> Self {
        let depth = config.nets.depth.config_for(config.data.height, config.data.width);
        Model { depth: DepthNet::new(depth), ..Self::new(&config.nets) }
    }

    /// The networks that a configuration names, for frames of usual size.
    pub fn new(nets: &NetsConfig) -> Self {
        Model {
            depth: DepthNet::new(nets.depth.config()),
            pose: PoseNet::new(nets.pose.config()),
            flow: FlowNet::new(nets.flow.config()),
            rectify: nets.rectify.config().map(RectifyNet::new),
            range: DepthRange { min: nets.min_depth, max: nets.max_depth },
            pose_scale: [nets.rotation_scale, nets.tangential_scale, nets.radial_scale],
            flow_iterations: nets.flow_iterations,
        }
    }

    /// Fresh weights from a seed.
    pub fn init(&self, seed: u64) -> Weights {
        let rectify = self.rectify.as_ref().map_or_else(ParamSet::new, |net| net.init(seed));
        Weights { depth: self.depth.init(seed), pose: self.pose.init(seed), flow: self.flow.init(seed), rectify }
    }

    /// Depth `[n, 1, h, w]` of images `[n, 3, h, w]`, in the unit of the training run.
    pub fn predict_depth(&self, weights: &Weights, images: &Tensor<f32>) -> Tensor<f32> {
        self.range.depth_values(&self.depth.predict(&weights.depth, images))
    }

    /// Rotation vectors and translations `second_from_first`, each `[n, 3, 1, 1]`, on the tape: one look.
    pub fn motion<'t>(&self, binder: &mut Binder<'t, f32>, first: Var<'t, f32>, second: Var<'t, f32>) -> [Var<'t, f32>; 2] {
        let said = self.pose.forward(binder, first, second);
        let [rotation, tangential, radial] = self.pose_scale;
        let factors =
            Tensor::from_fn(said.translation.shape(), |_, c, _, _| if c < 2 { tangential as f32 } else { radial as f32 });
        [said.axis_angle.scale(rotation), said.translation.mul(binder.tape().constant(factors))]
    }

    /// Flow `[n, 2, h, w]` in pixels from the first to the second image.
    pub fn predict_flow(&self, weights: &Weights, first: &Tensor<f32>, second: &Tensor<f32>) -> Tensor<f32> {
        self.flow.predict(&weights.flow, first, second, Some(self.flow_iterations))
    }
}

/// Images of equal size as one tensor `[n, 3, h, w]`.
///
/// # Panics
/// When there is none or sizes differ.
pub fn stack<'a>(images: impl IntoIterator<Item = &'a crate::data::Image>) -> Tensor<f32> {
    let images: Vec<_> = images.into_iter().collect();
    let first = images.first().expect("stack: at least one image");
    let shape = Shape::new(images.len(), first.channels, first.height, first.width);
    let data: Vec<f32> = images.iter().flat_map(|i| i.data.iter().copied()).collect();
    Tensor::from_vec(shape, data)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    #[test]
    fn disparities_reach_from_the_largest_depth_to_the_smallest() {
        let tape = Tape::<f64>::new();
        let ends = tape.constant(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![0.0, 1.0]));
        for (range, near) in [(DepthRange::MONODEPTH, 0.1), (DepthRange::SC_DEPTH, 1.0 / 10.01)] {
            let depth = range.depth(ends).value();
            assert!((depth.data()[0] - 100.0).abs() < 1e-10 && (depth.data()[1] - near).abs() < 1e-15, "{depth:?}");
            assert_eq!([near, 100.0].map(|depth| range.disparity(depth)), [1.0, 0.0]);
            let middle = range.depth(tape.constant(Tensor::scalar(0.25))).value().item();
            assert!((range.disparity(middle) - 0.25).abs() < 1e-14);
        }
    }

    #[test]
    fn gradient_of_the_depth_matches_finite_differences() {
        let disparity = random(1, Shape::new(1, 1, 3, 4), 0.2, 0.9);
        let check = GradCheck { step: 1e-5, ..GradCheck::default() };
        gradcheck(&[disparity], |_, v| weighted_sum(DepthRange::SC_DEPTH.depth(v[0]), 2), check).assert_ok();
    }
}
