//! The depth network, whichever architecture it has.

use std::fmt;
use std::str::FromStr;

use dimode_autodiff::{Scalar, Tape, Tensor, Var};

use crate::kind::{name_of, parse_name};
use crate::{
    Binder, Blueprint, DHrNet, DHrNetConfig, LiteMono, LiteMonoConfig, Network, ParamSet, ResNetDepth, ResNetDepthConfig,
    UnfitSize, UnknownName,
};

/// Depth networks that can be asked for by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthNetKind {
    /// `nano_resnet`: 134 thousand parameters.
    NanoResnet,
    /// `resnet18`: the size of the reference, 14.8 million parameters.
    Resnet18,
    /// `nano_lite_mono`: 113 thousand parameters.
    NanoLiteMono,
    /// `lite_mono_tiny`: 2.1 million parameters.
    LiteMonoTiny,
    /// `lite_mono_small`: 2.5 million parameters.
    LiteMonoSmall,
    /// `lite_mono`: 3.1 million parameters.
    LiteMono,
    /// `lite_mono_8m`: 8.8 million parameters.
    LiteMono8m,
    /// `nano_d_hrnet`: 300 thousand parameters.
    NanoDHrNet,
    /// `d_hrnet`: the size of the reference, 10 million parameters.
    DHrNet,
}

const NAMES: &[(&str, DepthNetKind)] = &[
    ("nano_resnet", DepthNetKind::NanoResnet),
    ("resnet18", DepthNetKind::Resnet18),
    ("nano_lite_mono", DepthNetKind::NanoLiteMono),
    ("lite_mono_tiny", DepthNetKind::LiteMonoTiny),
    ("lite_mono_small", DepthNetKind::LiteMonoSmall),
    ("lite_mono", DepthNetKind::LiteMono),
    ("lite_mono_8m", DepthNetKind::LiteMono8m),
    ("nano_d_hrnet", DepthNetKind::NanoDHrNet),
    ("d_hrnet", DepthNetKind::DHrNet),
];

impl DepthNetKind {
    /// All of them, in the order in which messages list their names.
    pub fn all() -> impl ExactSizeIterator<Item = Self> {
        NAMES.iter().map(|&(_, kind)| kind)
    }

    /// The sizes behind the name, for images of any size but those that [`DepthNetKind::config_for`] knows of.
    pub fn config(self) -> DepthNetConfig {
        match self {
            Self::NanoResnet => DepthNetConfig::nano(),
            Self::Resnet18 => DepthNetConfig::resnet18(),
            Self::NanoLiteMono => DepthNetConfig::LiteMono(LiteMonoConfig::nano()),
            Self::LiteMonoTiny => DepthNetConfig::LiteMono(LiteMonoConfig::tiny()),
            Self::LiteMonoSmall => DepthNetConfig::LiteMono(LiteMonoConfig::small()),
            Self::LiteMono => DepthNetConfig::LiteMono(LiteMonoConfig::lite_mono()),
            Self::LiteMono8m => DepthNetConfig::LiteMono(LiteMonoConfig::eight_million()),
            Self::NanoDHrNet => DepthNetConfig::DHrNet(DHrNetConfig::nano()),
            Self::DHrNet => DepthNetConfig::DHrNet(DHrNetConfig::d_hrnet()),
        }
    }

    /// The sizes behind the name for images of one height and width: as the reference does, Lite-Mono takes its wide dilations
    /// at 1024x320 ([`LiteMonoConfig::with_wide_dilations`]); the largest and the nano one do not.
    pub fn config_for(self, height: usize, width: usize) -> DepthNetConfig {
        match (self, self.config()) {
            (Self::LiteMonoTiny | Self::LiteMonoSmall | Self::LiteMono, DepthNetConfig::LiteMono(config))
                if (height, width) == (320, 1024) =>
            {
                DepthNetConfig::LiteMono(config.with_wide_dilations())
            }
            (_, config) => config,
        }
    }
}

impl FromStr for DepthNetKind {
    type Err = UnknownName;
    fn from_str(name: &str) -> Result<Self, UnknownName> {
        parse_name("depth network", name, NAMES)
    }
}

impl fmt::Display for DepthNetKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(name_of(*self, NAMES))
    }
}

/// Architecture and sizes of a [`DepthNet`].
#[derive(Clone, Debug, PartialEq)]
pub enum DepthNetConfig {
    /// ResNet encoder with a skip-connection decoder.
    ResNet(ResNetDepthConfig),
    /// Lite-Mono.
    LiteMono(LiteMonoConfig),
    /// HRNet encoder with a fusing decoder.
    DHrNet(DHrNetConfig),
}

impl DepthNetConfig {
    /// The smallest one.
    pub fn nano() -> Self {
        Self::ResNet(ResNetDepthConfig::nano())
    }

    /// The baseline of the field.
    pub fn resnet18() -> Self {
        Self::ResNet(ResNetDepthConfig::resnet18())
    }
}

/// Disparity from one image.
#[derive(Clone, Debug, PartialEq)]
pub enum DepthNet {
    /// ResNet encoder with a skip-connection decoder.
    ResNet(Box<ResNetDepth>),
    /// Lite-Mono.
    LiteMono(Box<LiteMono>),
    /// HRNet encoder with a fusing decoder.
    DHrNet(Box<DHrNet>),
}

impl DepthNet {
    /// The network of the given architecture and sizes.
    ///
    /// # Panics
    /// When the sizes contradict each other, see the networks.
    #[track_caller]
    pub fn new(config: DepthNetConfig) -> Self {
        match config {
            DepthNetConfig::ResNet(config) => Self::ResNet(Box::new(ResNetDepth::new(config))),
            DepthNetConfig::LiteMono(config) => Self::LiteMono(Box::new(LiteMono::new(config))),
            DepthNetConfig::DHrNet(config) => Self::DHrNet(Box::new(DHrNet::new(config))),
        }
    }

    /// Whether images of this height and width can be taken.
    ///
    /// **Errors** when they cannot, with what the network needs.
    pub fn check_size(&self, height: usize, width: usize) -> Result<(), UnfitSize> {
        match self {
            Self::ResNet(net) => net.check_size(height, width),
            Self::LiteMono(net) => net.check_size(height, width),
            Self::DHrNet(net) => net.check_size(height, width),
        }
    }

    /// Number of disparities that [`DepthNet::forward`] returns, at least one.
    pub fn scales(&self) -> usize {
        match self {
            Self::ResNet(net) => net.scales(),
            Self::LiteMono(net) => net.scales(),
            Self::DHrNet(_) => 1,
        }
    }

    /// Images in [0, 1], (N, 3, H, W) -> disparities in (0, 1), (N, 1, H / 2^s, W / 2^s), full
    /// size first.
    ///
    /// # Panics
    /// When the size does not fit, see [`DepthNet::check_size`].
    #[track_caller]
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> Vec<Var<'t, T>> {
        match self {
            Self::ResNet(net) => {
                let features = net.features(binder, images);
                net.decode(binder, &features)
            }
            Self::LiteMono(net) => {
                let features = net.features(binder, images);
                net.decode(binder, &features)
            }
            Self::DHrNet(net) => {
                let features = net.features(binder, images);
                vec![net.decode(binder, &features)]
            }
        }
    }

    /// The full-size disparity alone, without gradients: (N, 3, H, W) -> (N, 1, H, W).
    ///
    /// # Panics
    /// As [`DepthNet::forward`].
    #[track_caller]
    pub fn predict<T: Scalar>(&self, params: &ParamSet<T>, images: &Tensor<T>) -> Tensor<T> {
        let tape = Tape::new();
        let mut binder = Binder::frozen(&tape, params);
        let images = tape.constant(images.clone());
        self.forward(&mut binder, images)[0].value()
    }
}

impl Network for DepthNet {
    fn blueprint(&self) -> Blueprint {
        match self {
            Self::ResNet(net) => net.blueprint(),
            Self::LiteMono(net) => net.blueprint(),
            Self::DHrNet(net) => net.blueprint(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_both_ways() {
        for &(name, kind) in NAMES {
            assert!(DepthNetKind::all().any(|listed| listed == kind));
            assert_eq!(name.parse::<DepthNetKind>().unwrap(), kind);
            assert_eq!(kind.to_string(), name);
        }
        let text = "resnet".parse::<DepthNetKind>().unwrap_err().to_string();
        assert!(text.contains("'resnet'") && text.contains("nano_resnet"));
    }

    #[test]
    fn parameter_counts_are_those_of_the_reference() {
        let expected = [
            (DepthNetKind::NanoResnet, 78_312, 55_892),
            (DepthNetKind::Resnet18, 11_689_512, 3_152_724),
            (DepthNetKind::NanoLiteMono, 95_756, 16_959),
            (DepthNetKind::LiteMonoTiny, 1_955_192, 192_467),
            (DepthNetKind::LiteMonoSmall, 2_250_232, 226_627),
            (DepthNetKind::LiteMono, 2_848_120, 226_627),
            (DepthNetKind::LiteMono8m, 8_139_960, 635_891),
            (DepthNetKind::NanoDHrNet, 224_032, 76_369),
            (DepthNetKind::DHrNet, 9_562_260, 416_589),
        ];
        assert_eq!(expected.len(), NAMES.len());
        for (kind, encoder, decoder) in expected {
            let params = DepthNet::new(kind.config()).init::<f32>(1);
            let count = |file: &str| {
                let sizes =
                    params.trainable().filter(|(path, _)| path.starts_with(file)).map(|(_, entry)| entry.tensor().shape().len());
                sizes.sum::<usize>()
            };
            assert_eq!([count("encoder:"), count("depth:")], [encoder, decoder], "{kind}");
        }
    }

    #[test]
    fn only_three_sizes_have_wide_dilations_and_only_at_one_image_size() {
        for &(_, kind) in NAMES {
            let wide = matches!(kind, DepthNetKind::LiteMonoTiny | DepthNetKind::LiteMonoSmall | DepthNetKind::LiteMono);
            assert_eq!(kind.config_for(320, 1024) != kind.config(), wide, "{kind}");
            assert_eq!(kind.config_for(192, 640), kind.config(), "{kind}");
        }
    }

    #[test]
    fn every_network_says_which_sizes_it_takes() {
        let unfit = |kind: DepthNetKind, height, width| DepthNet::new(kind.config()).check_size(height, width).is_err();
        for &(_, kind) in NAMES {
            assert!(!unfit(kind, 192, 640) && unfit(kind, 190, 640) && unfit(kind, 192, 650), "{kind}");
            let lite = kind.to_string().contains("lite_mono");
            assert_eq!((unfit(kind, 32, 48), unfit(kind, 96, 112)), (!lite, !lite), "{kind}");
        }
    }
}
