//! The SCIPaD pose network.

use dimode_autodiff::{Scalar, Var};

use super::ScipadConfig;
use super::decoder::Decoder;
use super::feature_flow::{RADII, feature_flow};
use super::frozen_extractor::FrozenExtractor;
use super::injector::Injector;
use super::position::PositionEncoder;
use crate::{Binder, Blueprint, Network, ResNetEncoder, UnfitSize, size};

/// Relative pose from two images and, where there is one, the point cloud of the first. All tensors are in the checkpoint file
/// `posenet`.
///
/// The reference calls the images *target* and *reference* and predicts odometry from `(frame t, frame t + 1)`: the target is the
/// earlier frame, and comes first here as in [`crate::ResNetPose`].
#[derive(Clone, Debug, PartialEq)]
pub struct ScipadPose {
    semantic: ResNetEncoder,
    frozen: FrozenExtractor,
    position: PositionEncoder,
    injector: Injector,
    decoder: Decoder,
}

/// Everything worth looking at in one forward pass, at 1/4, 1/8 and 1/16 of the size.
#[derive(Clone)]
pub struct ScipadTrace<'t, T: Scalar> {
    /// Feature flow from the first to the second image in cells, **row first**, (N, 2, h, w).
    pub flows: [Var<'t, T>; 3],
    /// How sure the flow is, (N, 1, h, w).
    pub confidences: [Var<'t, T>; 3],
    /// Positional features, (N, embedding, h, w).
    pub positions: [Var<'t, T>; 3],
    /// What the decoder reads, at 1/32 of the size.
    pub fused: Var<'t, T>,
    /// Axis-angle vector and translation, scaled by 0.01, (N, 6, 1, 1).
    pub pose: Var<'t, T>,
}

impl ScipadPose {
    /// The network of the given sizes.
    pub fn new(config: ScipadConfig) -> Self {
        let [_, widths @ ..] = config.semantic.widths;
        Self {
            frozen: FrozenExtractor::new("posenet:frozen_feature_extractor", &config),
            position: PositionEncoder::new("posenet:pca", config.embedding),
            injector: Injector::new("posenet:hpei", widths, config.embedding),
            decoder: Decoder::new("posenet:decoder", widths[3], config.squeeze, config.hidden),
            semantic: ResNetEncoder::with_stem(
                "posenet:sem_feature_extractor".to_owned(),
                ["layer0.0", "layer0.1"],
                config.semantic,
            ),
        }
    }

    /// Whether images of `height` rows and `width` columns fit: multiples of 32, so that every level halves.
    ///
    /// The reference model runs at one size, which is configured; the weights do not depend on it.
    ///
    /// # Errors
    /// [`UnfitSize`] when they do not.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        size::fits("the SCIPaD pose network", (32, 32), (height, width))
    }

    /// Two images in [0, 1], each (N, 3, H, W), the earlier first, and the point of every pixel of the first one in its
    /// camera's frame, (N, 3, H', W') -> all stages of the pose.
    ///
    /// Without points they count as zeros: the published weights were in all likelihood trained so. Points are scaled to
    /// [0, 1] over the whole batch, and so is the feature flow: samples of a batch depend on each other.
    ///
    /// # Panics
    /// When the images differ in shape or do not fit ([`ScipadPose::check_size`]), or the points are not three for each sample.
    #[track_caller]
    pub fn trace<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        first: Var<'t, T>,
        second: Var<'t, T>,
        points: Option<Var<'t, T>>,
    ) -> ScipadTrace<'t, T> {
        let shape = first.shape();
        assert_eq!(shape, second.shape(), "SCIPaD pose network: the two images differ in shape");
        self.check_size(shape.h(), shape.w()).unwrap_or_else(|unfit| panic!("{unfit}"));
        if let Some(points) = points.map(Var::shape) {
            let fit = points.n() == shape.n() && points.c() == 3;
            assert!(fit, "SCIPaD pose network: points {points} for images {shape}; the rule: [n, 3, h, w] for n images");
        }
        let pair = Var::concat(&[first, second], 1);
        let [stem, semantic @ ..] = self.semantic.forward(binder, pair);
        pair.release();
        stem.release();
        let target = self.frozen.forward(binder, first);
        let reference = self.frozen.forward(binder, second);
        let found: [_; 3] = std::array::from_fn(|level| feature_flow(binder, target[level], reference[level], RADII[level]));
        let positions = found.map(|found| self.position.forward(binder, found, points));
        let fused = self.injector.forward(binder, semantic, positions);
        let pose = self.decoder.forward(binder, fused);
        ScipadTrace { flows: found.map(|f| f.flow), confidences: found.map(|f| f.confidence), positions, fused, pose }
    }
}

impl Network for ScipadPose {
    fn blueprint(&self) -> Blueprint {
        let mut blueprint = Blueprint::new();
        self.frozen.declare(&mut blueprint);
        self.semantic.declare(&mut blueprint);
        self.position.declare(&mut blueprint);
        self.injector.declare(&mut blueprint);
        self.decoder.declare(&mut blueprint);
        blueprint
    }
}
