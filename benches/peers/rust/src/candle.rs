//! Convolutions of candle.

use anyhow::{Context, Result};
use candle_core::{Device, Tensor, Var};

use crate::{Conv, Numbers, Sizes};

/// A convolution with its operands.
pub struct Candle {
    x: Var,
    weight: Var,
    bias: Var,
    gy: Tensor,
    sizes: Sizes,
}

impl Candle {
    /// The convolution of the given numbers.
    pub fn new(sizes: &Sizes, numbers: Numbers) -> Result<Self> {
        let device = Device::Cpu;
        Ok(Self {
            x: Var::from_vec(numbers.x, &sizes.input(), &device)?,
            weight: Var::from_vec(numbers.weight, &sizes.weight(), &device)?,
            bias: Var::from_vec(numbers.bias, sizes.outputs, &device)?,
            gy: Tensor::from_vec(numbers.gy, &sizes.output(), &device)?,
            sizes: sizes.clone(),
        })
    }

    fn output(&self, [x, weight, bias]: [&Tensor; 3]) -> Result<Tensor> {
        let s = &self.sizes;
        let y = x.conv2d(weight, s.padding, s.stride, s.dilation, s.groups)?;
        Ok(y.broadcast_add(&bias.reshape((1, s.outputs, 1, 1))?)?)
    }

    /// The output without a record for the backward pass.
    fn plain(&self) -> Result<Tensor> {
        self.output([&self.x.detach(), &self.weight.detach(), &self.bias.detach()])
    }
}

impl Conv for Candle {
    fn forward(&self) -> Result<Vec<f32>> {
        Ok(self.plain()?.flatten_all()?.to_vec1()?)
    }

    fn run_forward(&self) -> Result<()> {
        self.plain().map(drop)
    }

    fn run_forward_backward(&self, read: bool) -> Result<Vec<Vec<f32>>> {
        let y = self.output([&self.x, &self.weight, &self.bias])?;
        let gradients = (y * &self.gy)?.sum_all()?.backward()?;
        let operands: &[&Var] = if read { &[&self.x, &self.weight, &self.bias] } else { &[] };
        let numbers = |v: &&Var| Ok(gradients.get(v).context("no gradient")?.flatten_all()?.to_vec1()?);
        operands.iter().map(numbers).collect()
    }
}
