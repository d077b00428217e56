//! The flow network: encoders, correlation pyramid, refinement, upsampling.

use dimode_autodiff::{Scalar, Shape, Tape, Tensor, Var};

use super::FlowNetConfig;
use super::encoder::Encoder;
use super::padding::{Padding, PaddingStyle};
use super::update::UpdateBlock;
use super::upsampler::Upsampler;
use crate::layers::Norm;
use crate::{Binder, Blueprint, Network, ParamSet, UnfitSize, size};

/// Range of the pixel values handed to the flow network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageRange {
    /// [0, 1], as for all other networks here.
    #[default]
    Unit,
    /// [0, 255], as in the reference.
    Byte,
}

/// How to run the flow network.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FlowOptions {
    /// Refinement steps; `None` takes the number of the configuration.
    pub iterations: Option<usize>,
    /// Range of the pixel values.
    pub range: ImageRange,
    /// Return the last flow only, and upsample only that.
    pub last_only: bool,
}

/// Everything worth looking at in one forward pass. Sizes: H x W of the images, h x w of the
/// coarse grid, that is H / factor and W / factor.
#[derive(Clone)]
pub struct FlowTrace<'t, T: Scalar> {
    /// Flows in pixels of the image, (N, 2, H, W), channel 0 along u; one per iteration in order,
    /// or the last alone.
    pub flows: Vec<Var<'t, T>>,
    /// Flow increment of each iteration, in cells, (N, 2, h, w).
    pub deltas: Vec<Var<'t, T>>,
    /// Features of both images, first image's batch then second's, (2 N, features, h, w).
    pub features: Var<'t, T>,
    /// Output of the context encoder, (N, hidden + context, h, w).
    pub context: Var<'t, T>,
    /// Result of the first look-up, (N, levels (2 radius + 1)^2, h, w).
    pub first_lookup: Option<Var<'t, T>>,
    /// Hidden state at the end, (N, hidden, h, w).
    pub hidden: Var<'t, T>,
}

/// Optical flow from two images. All tensors are in the checkpoint file `raft`.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowNet {
    config: FlowNetConfig,
    features: Encoder,
    context: Encoder,
    update: UpdateBlock,
    upsampler: Upsampler,
}

impl FlowNet {
    /// The network of the given sizes.
    pub fn new(config: FlowNetConfig) -> Self {
        let state = config.hidden + config.context;
        Self {
            features: Encoder::new("raft:fnet", &config, config.features, Norm::Instance),
            context: Encoder::new("raft:cnet", &config, state, config.context_norm()),
            update: UpdateBlock::new("raft:update_block", &config),
            upsampler: Upsampler::new("raft:update_block", &config),
            config,
        }
    }

    /// Sizes.
    pub fn config(&self) -> &FlowNetConfig {
        &self.config
    }

    /// Whether images of `height` rows and `width` columns fit: multiples of the factor between image and grid, and large enough
    /// that the coarsest correlation map is not empty.
    ///
    /// # Errors
    /// [`UnfitSize`] when they do not; [`FlowNet::predict_any_size`] takes them.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        size::fits("the flow network", self.size_rule(), (height, width))
    }

    /// What both sides are multiples of, and the shortest one.
    fn size_rule(&self) -> (usize, usize) {
        let factor = self.config.factor();
        (factor, factor << (self.config.levels - 1))
    }

    /// Flow from the first to the second image after each of `iterations` refinements:
    /// images in **[0, 1]**, (N, 3, H, W) -> (N, 2, H, W) in pixels, channel 0 along u.
    ///
    /// # Panics
    /// As [`FlowNet::trace`].
    #[track_caller]
    pub fn forward<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        first: Var<'t, T>,
        second: Var<'t, T>,
        iterations: usize,
    ) -> Vec<Var<'t, T>> {
        let options = FlowOptions { iterations: Some(iterations), ..FlowOptions::default() };
        self.trace(binder, first, second, &options).flows
    }

    /// The last flow alone, without gradients; images in [0, 1], `None` for the configured number
    /// of refinements.
    ///
    /// # Panics
    /// As [`FlowNet::trace`].
    #[track_caller]
    pub fn predict<T: Scalar>(
        &self,
        params: &ParamSet<T>,
        first: &Tensor<T>,
        second: &Tensor<T>,
        iterations: Option<usize>,
    ) -> Tensor<T> {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, params);
        let (first, second) = (tape.constant(first.clone()), tape.constant(second.clone()));
        let options = FlowOptions { iterations, last_only: true, ..FlowOptions::default() };
        self.trace(&mut binder, first, second, &options).flows[0].value()
    }

    /// The same for frames of any size: copies of their edges fill them up, and the flow is cut to their size.
    ///
    /// # Panics
    /// When the images differ in shape or no iteration is asked for.
    #[track_caller]
    pub fn predict_any_size<T: Scalar>(
        &self,
        params: &ParamSet<T>,
        [first, second]: [&Tensor<T>; 2],
        iterations: Option<usize>,
        style: PaddingStyle,
    ) -> Tensor<T> {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, params);
        let padding = Padding::new(style, self.size_rule(), first.shape());
        let [first, second] = [first, second].map(|image| padding.pad(tape.constant(image.clone())));
        let options = FlowOptions { iterations, last_only: true, ..FlowOptions::default() };
        padding.crop(self.trace(&mut binder, first, second, &options).flows[0]).value()
    }

    /// The forward pass with all its stages.
    ///
    /// # Panics
    /// When the images differ in shape, their size is not a multiple of the factor, the coarsest
    /// correlation map would be empty, or no iteration is asked for.
    #[track_caller]
    pub fn trace<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        first: Var<'t, T>,
        second: Var<'t, T>,
        options: &FlowOptions,
    ) -> FlowTrace<'t, T> {
        let iterations = options.iterations.unwrap_or(self.config.iterations);
        self.check(first.shape(), second.shape(), iterations);
        let (first, second) = (normalise(first, options.range), normalise(second, options.range));
        let batch = first.shape().n();
        let features = Var::concat(&[first, second], 0);
        let features = features.last_use(|images| self.features.forward(binder, images));
        let pyramid = self.pyramid(binder, features.slice(0, 0, batch), features.slice(0, batch, batch));
        let context = self.context.forward(binder, first);
        let (h, c) = (self.config.hidden, self.config.context);
        let mut hidden = context.slice(1, 0, h).tanh();
        let gru = self.update.prepare(binder, context.slice(1, h, c).relu());

        let grid = binder.tape().pixel_grid(hidden.shape());
        let mut flow = binder.tape().constant(Tensor::zeros(grid.shape()));
        let (mut flows, mut deltas, mut first_lookup) = (Vec::new(), Vec::new(), None);
        for iteration in 0..iterations {
            flow = flow.detach();
            let lookup = grid.add(flow).last_use(|ends| Var::correlation_lookup(&pyramid, ends, self.config.radius));
            first_lookup.get_or_insert(lookup);
            let (state, delta) = self.update.step(binder, &gru, hidden, lookup, flow);
            hidden = state;
            flow = flow.add(delta);
            deltas.push(delta);
            if !options.last_only || iteration + 1 == iterations {
                flows.push(self.upsampler.forward(binder, flow, hidden));
            } else {
                self.upsampler.skip(binder, flow.shape());
            }
        }
        FlowTrace { flows, deltas, features, context, first_lookup, hidden }
    }

    #[track_caller]
    fn check(&self, first: Shape, second: Shape, iterations: usize) {
        assert_eq!(first, second, "flow network: the two images differ in shape");
        self.check_size(first.h(), first.w()).unwrap_or_else(|unfit| panic!("{unfit}"));
        assert!(iterations > 0, "flow network: at least one iteration");
    }

    /// All-pairs correlation at level 0, halved over the second image at each further level.
    fn pyramid<'t, T: Scalar>(&self, binder: &Binder<'t, T>, first: Var<'t, T>, second: Var<'t, T>) -> Vec<Var<'t, T>> {
        let mut pyramid = vec![first.correlation(second)];
        binder.count_macs(first.shape().c() * pyramid[0].shape().len());
        for level in 1..self.config.levels {
            pyramid.push(pyramid[level - 1].avg_pool2d(2, 2, 0));
        }
        pyramid
    }
}

impl Network for FlowNet {
    fn blueprint(&self) -> Blueprint {
        let mut blueprint = Blueprint::new();
        self.features.declare(&mut blueprint);
        self.context.declare(&mut blueprint);
        self.update.declare(&mut blueprint);
        self.upsampler.declare(&mut blueprint);
        blueprint
    }
}

/// To [-1, 1].
fn normalise<T: Scalar>(images: Var<'_, T>, range: ImageRange) -> Var<'_, T> {
    let scale = match range {
        ImageRange::Unit => 2.0,
        ImageRange::Byte => 2.0 / 255.0,
    };
    images.scale(scale).add_scalar(-1.0)
}
