//! The rotation between two views, from both images: the network of SC-Depth V2 that learns to remove it (auto-rectify;
//! JiawangBian/sc_depth_pl, `models/RectifyNet.py`).

use dimode_autodiff::{Activation, Scalar, Tape, Tensor, Var};

use crate::layers::ConvLayer;
use crate::{Binder, Blueprint, Network, ParamSet, ResNetConfig, ResNetEncoder};

/// Sizes of a [`RectifyNet`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RectifyNetConfig {
    /// The encoder, on two images.
    pub encoder: ResNetConfig,
    /// Channels inside the decoder.
    pub decoder: usize,
}

impl RectifyNetConfig {
    /// 394 115 parameters, the encoder of the nano pose network: for tests and small machines.
    pub fn nano() -> Self {
        Self { encoder: ResNetConfig::nano(2, [16, 16, 32, 64, 128]), decoder: 64 }
    }

    /// The size of the reference, 13 million parameters.
    pub fn resnet18() -> Self {
        Self { encoder: ResNetConfig::resnet18(2), decoder: 256 }
    }
}

/// Three Euler angles from two stacked images of half the size; all in the file `rectify`, under the names of the reference.
#[derive(Clone, Debug, PartialEq)]
pub struct RectifyNet {
    encoder: ResNetEncoder,
    decoder: [ConvLayer; 4],
}

impl RectifyNet {
    /// The network of the given sizes.
    pub fn new(config: RectifyNetConfig) -> Self {
        let (inputs, width) = (config.encoder.widths[4], config.decoder);
        let conv =
            |name: &str, inputs, outputs, kernel| ConvLayer::new(format!("rectify:decoder.{name}"), inputs, outputs, kernel);
        Self {
            encoder: ResNetEncoder::under("rectify:encoder.encoder".to_owned(), config.encoder),
            decoder: [
                conv("conv_squeeze", inputs, width, 1),
                conv("convs_pose.0", width, width, 3),
                conv("convs_pose.1", width, width, 3),
                conv("convs_pose.2", width, 3, 1),
            ],
        }
    }

    /// Two images in [0, 1], each (N, 3, H, W) -> angles about the x, y and z axes in radians, (N, 3, 1, 1).
    ///
    /// The rotation `R = R_x R_y R_z` is `source_from_target` with `reference` as source: read at `K R K^-1 p`, the reference
    /// becomes an image without rotation against the target. The images are halved by bilinear interpolation with aligned
    /// corners. Unlike the pose network's, the output has no factor 0.01.
    ///
    /// # Panics
    /// When an image has not three channels, the two differ in size or a side is shorter than two pixels.
    #[track_caller]
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, target: Var<'t, T>, reference: Var<'t, T>) -> Var<'t, T> {
        let stack = Var::concat(&[target, reference], 1);
        let [_, _, height, width] = stack.shape().0;
        let features = self.encoder.forward(binder, stack.resize_bilinear(height / 2, width / 2, true));
        let [squeeze, first, second, last] = &self.decoder;
        let x = squeeze.activated(binder, features[4], Activation::Relu);
        let x = x.last_use(|x| first.activated(binder, x, Activation::Relu));
        let x = x.last_use(|x| second.activated(binder, x, Activation::Relu));
        x.last_use(|x| last.forward(binder, x)).last_use(Var::mean_hw)
    }

    /// The angles without gradients, (N, 3, 1, 1).
    ///
    /// # Panics
    /// As [`RectifyNet::forward`].
    #[track_caller]
    pub fn predict<T: Scalar>(&self, params: &ParamSet<T>, target: &Tensor<T>, reference: &Tensor<T>) -> Tensor<T> {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, params);
        let (target, reference) = (tape.constant(target.clone()), tape.constant(reference.clone()));
        self.forward(&mut binder, target, reference).value()
    }
}

impl Network for RectifyNet {
    fn blueprint(&self) -> Blueprint {
        let mut blueprint = Blueprint::new();
        self.encoder.declare(&mut blueprint);
        self.decoder.iter().for_each(|conv| conv.declare(&mut blueprint));
        blueprint
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Kind, PoseNet, PoseNetConfig};
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Shape, gradcheck};

    const SIZE: Shape = Shape([2, 3, 10, 15]);

    /// A few channels on every level: quick, and of the shape of the others.
    fn tiny() -> RectifyNet {
        RectifyNet::new(RectifyNetConfig { encoder: ResNetConfig::nano(2, [2, 2, 3, 3, 4]), decoder: 3 })
    }

    #[test]
    fn parameter_counts_are_encoder_and_decoder() {
        let count = |config| RectifyNet::new(config).blueprint().parameter_count();
        assert_eq!(count(RectifyNetConfig::nano()), 311_808 + 82_307);
        assert_eq!(count(RectifyNetConfig::resnet18()), 11_698_920 + 1_312_259);
    }

    #[test]
    fn names_and_dimensions_are_those_of_the_reference() {
        let blueprint = RectifyNet::new(RectifyNetConfig::resnet18()).blueprint();
        let dims = |name: &str| {
            let path = format!("rectify:{name}");
            let found = blueprint.declarations().iter().find(|d| d.path == path);
            found.unwrap_or_else(|| panic!("{path}")).dims.clone()
        };
        assert_eq!(dims("encoder.encoder.conv1.weight"), [64, 6, 7, 7]);
        assert_eq!(dims("encoder.encoder.bn1.running_mean"), [64]);
        assert_eq!(dims("encoder.encoder.layer4.1.conv2.weight"), [512, 512, 3, 3]);
        assert_eq!(dims("encoder.encoder.layer2.0.downsample.0.weight"), [128, 64, 1, 1]);
        assert_eq!(dims("encoder.encoder.fc.weight"), [1000, 512]);
        let decoder: Vec<_> = blueprint.declarations().iter().filter(|d| d.path.starts_with("rectify:decoder.")).collect();
        let expected: [(&str, &[usize]); 8] = [
            ("conv_squeeze.weight", &[256, 512, 1, 1]),
            ("conv_squeeze.bias", &[256]),
            ("convs_pose.0.weight", &[256, 256, 3, 3]),
            ("convs_pose.0.bias", &[256]),
            ("convs_pose.1.weight", &[256, 256, 3, 3]),
            ("convs_pose.1.bias", &[256]),
            ("convs_pose.2.weight", &[3, 256, 1, 1]),
            ("convs_pose.2.bias", &[3]),
        ];
        assert_eq!(decoder.len(), expected.len());
        for (found, (name, dims)) in decoder.iter().zip(expected) {
            assert_eq!((found.path.as_str(), &found.dims[..]), (format!("rectify:decoder.{name}").as_str(), dims));
        }
        // Of the encoder: 20 convolutions, 20 normalisations of four tensors each, and the classifier.
        assert_eq!(blueprint.declarations().len(), 20 + 20 * 4 + 2 + 8);
        assert_eq!(blueprint.declarations().iter().filter(|d| d.kind == Kind::Buffer).count(), 20 * 2);
    }

    #[test]
    fn the_nano_size_has_the_encoder_of_the_nano_pose_network() {
        let tensors = |blueprint: Blueprint, root: &str| -> Vec<_> {
            let own =
                blueprint.declarations().iter().filter_map(|d| Some((d.path.strip_prefix(root)?.to_owned(), d.dims.clone())));
            own.collect()
        };
        let own = tensors(RectifyNet::new(RectifyNetConfig::nano()).blueprint(), "rectify:encoder.encoder.");
        let pose = tensors(PoseNet::new(PoseNetConfig::nano()).blueprint(), "pose_encoder:encoder.");
        assert!(!own.is_empty() && own == pose);
    }

    #[test]
    fn the_last_bias_is_the_output_of_a_decoder_without_weights() {
        let net = tiny();
        let mut params = net.init::<f64>(1);
        let mut set = |name: &str, value: &[f64]| {
            let path = format!("rectify:decoder.convs_pose.2.{name}");
            let shape = params.get(&path).unwrap().tensor().shape();
            params.set(&path, Tensor::from_vec(shape, value.to_vec()));
        };
        set("weight", &[0.0; 9]);
        set("bias", &[0.3, -0.2, 0.1]);
        let images = [1, 2].map(|seed| random(seed, SIZE, 0.0, 1.0));
        let angles = net.predict(&params, &images[0], &images[1]);
        assert_eq!((angles.shape(), angles.to_vec()), (Shape::new(2, 3, 1, 1), [0.3, -0.2, 0.1].repeat(2)));
    }

    #[test]
    fn the_target_comes_first() {
        let net = tiny();
        let mut params = net.init::<f64>(3);
        let [a, b] = [1, 2].map(|seed| random(seed, SIZE, 0.0, 1.0));
        assert_ne!(net.predict(&params, &a, &b), net.predict(&params, &b, &a));
        let path = "rectify:encoder.encoder.conv1.weight";
        let weight = params.get(path).unwrap().tensor().clone();
        let blind = Tensor::from_fn(weight.shape(), |o, c, i, j| if c < 3 { weight.at(o, c, i, j) } else { 0.0 });
        params.set(path, blind);
        assert_eq!(net.predict(&params, &a, &b), net.predict(&params, &a, &a));
        assert_ne!(net.predict(&params, &b, &a), net.predict(&params, &a, &a));
    }

    #[test]
    fn halving_keeps_the_corners_where_they_are() {
        let (net, shape) = (tiny(), Shape::new(1, 3, 4, 4));
        let params = net.init::<f64>(3);
        let image = random(1, shape, 0.0, 1.0);
        // To 2 x 2 pixels: the corners, and nothing of the others.
        let changed = |corner: bool| {
            let at_corner = |v: usize, u: usize| [v, u].iter().all(|i| [0, 3].contains(i));
            Tensor::from_fn(shape, |n, c, v, u| image.at(n, c, v, u) + if at_corner(v, u) == corner { 0.5 } else { 0.0 })
        };
        let [own, inner, corners] = [image.clone(), changed(false), changed(true)].map(|x| net.predict(&params, &x, &image));
        assert_eq!(own, inner);
        assert_ne!(own, corners);
    }

    #[test]
    fn gradients_to_the_images_match_differences() {
        let net = tiny();
        let params = net.init::<f64>(3);
        let images = [1, 2].map(|seed| random(seed, SIZE, 0.0, 1.0));
        let check = GradCheck { step: 1e-6, rtol: 1e-5, atol: 1e-9, ..GradCheck::default() };
        gradcheck(
            &images,
            |tape, v| {
                let mut binder = Binder::frozen(tape, &params);
                weighted_sum(net.forward(&mut binder, v[0], v[1]), 5)
            },
            check,
        )
        .assert_ok();
    }
}
