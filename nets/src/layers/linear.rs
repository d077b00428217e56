//! A linear layer over the channels of every pixel.

use dimode_autodiff::{Conv2d, Scalar, Shape, Var};

use crate::{Binder, Blueprint, Init};

/// Linear layer, the same for all pixels: `path.weight` of dimensions (out, in) and `path.bias` (out).
///
/// Reference modules move the channels to the last axis first. On maps the product is that of a 1x1 convolution with the
/// same weights, and nothing has to be moved.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearLayer {
    path: String,
    inputs: usize,
    outputs: usize,
    weight: Init,
}

impl LinearLayer {
    /// The layer stored at `path`; weights and biases start at [`Init::fan_in`].
    pub fn new(path: impl Into<String>, inputs: usize, outputs: usize) -> Self {
        Self { path: path.into(), inputs, outputs, weight: Init::fan_in(inputs) }
    }

    /// With weights that start Kaiming normal (fan-out).
    #[must_use]
    pub fn kaiming(self) -> Self {
        Self { weight: Init::kaiming_fan_out(self.outputs), ..self }
    }

    fn part(&self, part: &str) -> String {
        format!("{}.{part}", self.path)
    }

    /// Adds weight and bias to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        let (inputs, outputs) = (self.inputs, self.outputs);
        blueprint.parameter(self.part("weight"), &[outputs, inputs], self.weight);
        blueprint.parameter(self.part("bias"), &[outputs], Init::fan_in(inputs));
    }

    /// (N, in, H, W) -> (N, out, H, W).
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let [weight, bias] = self.bind(binder);
        self.product(binder, x, weight, bias)
    }

    /// The same, then every channel times its entry of `scale`, (1, out, 1, 1).
    ///
    /// Weight and bias are scaled in place of the result, which is hundreds of times larger.
    pub fn scaled<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>, scale: Var<'t, T>) -> Var<'t, T> {
        let [weight, bias] = self.bind(binder);
        let rows = scale.reshape(Shape::new(self.outputs, 1, 1, 1)).broadcast_to(weight.shape());
        self.product(binder, x, weight.mul(rows), bias.mul(scale))
    }

    /// Weight as a 1x1 kernel, and bias.
    fn bind<'t, T: Scalar>(&self, binder: &Binder<'t, T>) -> [Var<'t, T>; 2] {
        let weight = binder.param(&self.part("weight")).reshape(Shape::new(self.outputs, self.inputs, 1, 1));
        [weight, binder.param(&self.part("bias"))]
    }

    fn product<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>, weight: Var<'t, T>, bias: Var<'t, T>) -> Var<'t, T> {
        let y = x.conv2d(weight, Some(bias), Conv2d::new(1, 0));
        binder.count_macs(y.shape().len() * self.inputs);
        y
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fill;
    use dimode_autodiff::{Tape, Tensor};

    #[test]
    fn on_maps_it_is_the_linear_map_of_the_last_axis() {
        let layer = LinearLayer::new("net:fc", 3, 5);
        let mut blueprint = Blueprint::new();
        layer.declare(&mut blueprint);
        let params = blueprint.init::<f64>(1);
        let tape = Tape::new();
        let binder = Binder::frozen(&tape, &params);
        let shape = Shape::new(2, 3, 4, 7);
        let x = tape.constant(Tensor::from_vec(shape, (0..shape.len()).map(|i| fill::unit("x", i)).collect()));
        let scale = tape.constant(Tensor::from_vec(Shape::new(1, 5, 1, 1), vec![2.0, -1.0, 0.5, 3.0, 1e-6]));
        let last = x.permute([0, 2, 3, 1]);
        let expected = last.linear(binder.param("net:fc.weight"), Some(binder.param("net:fc.bias"))).permute([0, 3, 1, 2]);
        let near = |a: Var<'_, f64>, b: Var<'_, f64>| {
            let (a, b) = (a.value(), b.value());
            assert!(a.data().iter().zip(b.data()).all(|(a, b)| (a - b).abs() < 1e-14));
        };
        near(layer.forward(&binder, x), expected);
        assert_eq!(binder.macs(), 2 * 4 * 7 * 3 * 5);
        near(layer.scaled(&binder, x, scale), expected.mul(scale.broadcast_to(expected.shape())));
    }
}
