//! The narrow residual block of the small RAFT encoders.

use dimode_autodiff::{Scalar, Var};

use super::{ConvLayer, Norm, NormLayer};
use crate::{Binder, Blueprint};

/// 1x1 to a quarter of the width, 3x3 with the stride, 1x1 to the full width, each followed by
/// norm and ReLU; then `ReLU(skip + y)`. Note the ReLU on `y` before the sum.
#[derive(Clone, Debug, PartialEq)]
pub struct Bottleneck {
    convs: [ConvLayer; 3],
    norms: [NormLayer; 3],
    skip: Option<(ConvLayer, NormLayer)>,
}

impl Bottleneck {
    /// The block stored under `path`. A skip convolution exists where stride or width change.
    pub fn new(path: &str, inputs: usize, outputs: usize, stride: usize, norm: Norm) -> Self {
        let conv =
            |name: &str, inputs, outputs, kernel| ConvLayer::new(format!("{path}.{name}"), inputs, outputs, kernel).kaiming();
        let norm = |n: usize, channels| norm.layer(format!("{path}.norm{n}"), channels);
        let narrow = outputs / 4;
        let changes = stride != 1 || inputs != outputs;
        Self {
            convs: [
                conv("conv1", inputs, narrow, 1),
                conv("conv2", narrow, narrow, 3).stride(stride),
                conv("conv3", narrow, outputs, 1),
            ],
            norms: [norm(1, narrow), norm(2, narrow), norm(3, outputs)],
            skip: changes.then(|| (conv("downsample.0", inputs, outputs, 1).stride(stride), norm(4, outputs))),
        }
    }

    /// Adds the tensors of the block to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        self.convs.iter().for_each(|conv| conv.declare(blueprint));
        self.norms.iter().for_each(|norm| norm.declare(blueprint));
        if let Some((conv, norm)) = &self.skip {
            norm.declare(blueprint);
            conv.declare(blueprint);
        }
    }

    /// (N, in, H, W) -> (N, out, H / stride, W / stride).
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let mut layer = |n: usize, x| {
            let y = self.convs[n].forward(binder, x);
            self.norms[n].relu(binder, y)
        };
        let y = layer(0, x).last_use(|y| layer(1, y)).last_use(|y| layer(2, y));
        skip_and_rectify(binder, self.skip.as_ref(), x, y)
    }
}

/// `ReLU(skip(x) + y)`, where the skip is `x` or `norm(conv(x))`; gives up the value of `y`.
pub(super) fn skip_and_rectify<'t, T: Scalar>(
    binder: &mut Binder<'t, T>,
    skip: Option<&(ConvLayer, NormLayer)>,
    x: Var<'t, T>,
    y: Var<'t, T>,
) -> Var<'t, T> {
    let sum = match skip {
        None => y.last_use(|y| x.add(y)),
        Some((conv, norm)) => {
            let skip = conv.forward(binder, x);
            let skip = norm.forward(binder, skip);
            y.last_use(|y| skip.last_use(|skip| skip.add(y)))
        }
    };
    sum.last_use(Var::relu)
}
