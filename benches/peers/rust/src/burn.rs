//! Convolutions of burn, on any of its backends.

use anyhow::{Context, Result, anyhow};
use burn_autodiff::Autodiff;
use burn_tensor::backend::Backend;
use burn_tensor::module::conv2d;
use burn_tensor::ops::ConvOptions;
use burn_tensor::{Tensor, TensorData};

use crate::{Conv, Numbers, Sizes};

/// A convolution with its operands.
pub struct Burn<B: Backend> {
    x: Tensor<B, 4>,
    weight: Tensor<B, 4>,
    bias: Tensor<B, 1>,
    gy: Tensor<B, 4>,
    options: ConvOptions<2>,
}

impl<B: Backend> Burn<B> {
    /// The convolution of the given numbers.
    pub fn new(sizes: &Sizes, numbers: Numbers) -> Self {
        let device = B::Device::default();
        let s = sizes;
        Self {
            x: Tensor::from_data(TensorData::new(numbers.x, s.input()), &device),
            weight: Tensor::from_data(TensorData::new(numbers.weight, s.weight()), &device),
            bias: Tensor::from_data(TensorData::new(numbers.bias, [s.outputs]), &device),
            gy: Tensor::from_data(TensorData::new(numbers.gy, s.output()), &device),
            options: ConvOptions::new([s.stride; 2], [s.padding; 2], [s.dilation; 2], s.groups),
        }
    }

    fn plain(&self) -> Tensor<B, 4> {
        conv2d(self.x.clone(), self.weight.clone(), Some(self.bias.clone()), self.options.clone())
    }
}

fn numbers<B: Backend, const D: usize>(tensor: Tensor<B, D>) -> Result<Vec<f32>> {
    tensor.into_data().to_vec().map_err(|error| anyhow!("{error:?}"))
}

impl<B: Backend> Conv for Burn<B> {
    fn forward(&self) -> Result<Vec<f32>> {
        numbers(self.plain())
    }

    fn run_forward(&self) -> Result<()> {
        let y = self.plain();
        B::sync(&y.device()).map_err(|error| anyhow!("{error:?}"))
    }

    fn run_forward_backward(&self, read: bool) -> Result<Vec<Vec<f32>>> {
        let x = Tensor::<Autodiff<B>, 4>::from_inner(self.x.clone()).require_grad();
        let weight = Tensor::<Autodiff<B>, 4>::from_inner(self.weight.clone()).require_grad();
        let bias = Tensor::<Autodiff<B>, 1>::from_inner(self.bias.clone()).require_grad();
        let y = conv2d(x.clone(), weight.clone(), Some(bias.clone()), self.options.clone());
        let gradients = (y * Tensor::from_inner(self.gy.clone())).sum().backward();
        B::sync(&self.x.device()).map_err(|error| anyhow!("{error:?}"))?;
        if !read {
            return Ok(Vec::new());
        }
        Ok(vec![
            numbers(x.grad(&gradients).context("no gradient")?)?,
            numbers(weight.grad(&gradients).context("no gradient")?)?,
            numbers(bias.grad(&gradients).context("no gradient")?)?,
        ])
    }
}
