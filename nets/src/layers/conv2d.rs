//! A convolution with named weight and optional bias.

use dimode_autodiff::{Activation, Conv2d, PadMode, Scalar, Var};

use crate::{Binder, Blueprint, Init};

/// Convolution layer: `path.weight` of dimensions (out, in / groups, kh, kw) and, unless switched
/// off, `path.bias` (out).
#[derive(Clone, Debug, PartialEq)]
pub struct ConvLayer {
    path: String,
    inputs: usize,
    outputs: usize,
    kernel: (usize, usize),
    options: Conv2d,
    bias: bool,
    start: Start,
}

/// How weights start; biases start at [`Init::fan_in`], beside normal weights at zero.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Start {
    FanIn,
    KaimingFanOut,
    Elu,
    Normal(f64),
}

impl ConvLayer {
    /// A square kernel with stride 1, "same" zero padding for odd kernels, and a bias.
    pub fn new(path: impl Into<String>, inputs: usize, outputs: usize, kernel: usize) -> Self {
        let padding = kernel / 2;
        Self {
            path: path.into(),
            inputs,
            outputs,
            kernel: (kernel, kernel),
            options: Conv2d { stride: (1, 1), padding: (padding, padding), dilation: (1, 1), groups: 1, pad_mode: PadMode::Zero },
            bias: true,
            start: Start::FanIn,
        }
    }

    /// With a kernel of the given odd height and width in place of a square one; the padding keeps the size.
    #[must_use]
    pub fn kernel(mut self, height: usize, width: usize) -> Self {
        self.kernel = (height, width);
        self.options.padding = (height / 2, width / 2);
        self
    }

    /// With another stride, the same along both axes.
    #[must_use]
    pub fn stride(mut self, stride: usize) -> Self {
        self.options.stride = (stride, stride);
        self
    }

    /// Depth-wise with a dilation: one group per channel, padding equal to the dilation.
    #[must_use]
    pub fn depthwise(mut self, dilation: usize) -> Self {
        self.options.groups = self.inputs;
        self.options.dilation = (dilation, dilation);
        self.options.padding = (dilation, dilation);
        self
    }

    /// Without a bias.
    #[must_use]
    pub fn without_bias(mut self) -> Self {
        self.bias = false;
        self
    }

    /// With reflection of the input at the border in place of zeros.
    #[must_use]
    pub fn reflect(mut self) -> Self {
        self.options.pad_mode = PadMode::Reflect;
        self
    }

    /// With weights that start uniform in `+-1/sqrt(fan_in)` ([`Init::fan_in`]), as they do unless told otherwise.
    #[must_use]
    pub fn fan_in(mut self) -> Self {
        self.start = Start::FanIn;
        self
    }

    /// With weights that start Kaiming normal (fan-out) in place of uniform.
    #[must_use]
    pub fn kaiming(mut self) -> Self {
        self.start = Start::KaimingFanOut;
        self
    }

    /// With weights that start at the spread that an ELU behind them asks for ([`Init::elu`]).
    #[must_use]
    pub fn before_elu(mut self) -> Self {
        self.start = Start::Elu;
        self
    }

    /// With weights that start normal with the given deviation and a bias that starts at zero.
    #[must_use]
    pub fn normal(mut self, deviation: f64) -> Self {
        self.start = Start::Normal(deviation);
        self
    }

    /// Path of the weight.
    pub fn weight_path(&self) -> String {
        format!("{}.weight", self.path)
    }

    /// Path of the bias.
    pub fn bias_path(&self) -> String {
        format!("{}.bias", self.path)
    }

    /// Options of the convolution.
    pub fn options(&self) -> Conv2d {
        self.options
    }

    /// Multiply-accumulates of one output value.
    pub fn macs_per_output(&self) -> usize {
        self.inputs / self.options.groups * self.kernel.0 * self.kernel.1
    }

    /// Multiply-accumulates of the values of all output channels at one position.
    pub fn macs_per_position(&self) -> usize {
        self.outputs * self.macs_per_output()
    }

    /// Adds weight and bias to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        let (kh, kw) = self.kernel;
        let inputs = self.inputs / self.options.groups;
        let default = Init::fan_in(inputs * kh * kw);
        let (weight, bias) = match self.start {
            Start::FanIn => (default, default),
            Start::KaimingFanOut => (Init::kaiming_fan_out(self.outputs * kh * kw), default),
            Start::Elu => (Init::elu(inputs * kh * kw), default),
            Start::Normal(deviation) => (Init::Normal { deviation }, Init::Constant(0.0)),
        };
        blueprint.parameter(self.weight_path(), &[self.outputs, inputs, kh, kw], weight);
        if self.bias {
            blueprint.parameter(self.bias_path(), &[self.outputs], bias);
        }
    }

    /// (N, in, H, W) -> (N, out, H', W').
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let (weight, bias) = self.bind(binder);
        let y = x.conv2d(weight, bias, self.options);
        binder.count_macs(y.shape().len() * self.macs_per_output());
        y
    }

    /// The same, and the activation of the result, in one operation.
    pub fn activated<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>, activation: Activation) -> Var<'t, T> {
        let (weight, bias) = self.bind(binder);
        let y = x.conv2d_activated(weight, bias, self.options, activation);
        binder.count_macs(y.shape().len() * self.macs_per_output());
        y
    }

    fn bind<'t, T: Scalar>(&self, binder: &Binder<'t, T>) -> (Var<'t, T>, Option<Var<'t, T>>) {
        (binder.param(&self.weight_path()), self.bias.then(|| binder.param(&self.bias_path())))
    }
}
