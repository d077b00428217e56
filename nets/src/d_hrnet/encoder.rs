//! HRNet: the encoder of D-HRNet.

use dimode_autodiff::{Activation, Scalar, Var};

use super::DHrNetConfig;
use super::bottleneck::{Bottleneck, EXPANSION};
use super::conv_norm::ConvNorm;
use super::module::Module;
use crate::{Binder, Blueprint};

/// Branches at 1/4, 1/8, 1/16 and 1/32 of the size, which exchange what they find; each stage has one more.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Encoder {
    stem: [ConvNorm; 2],
    layer: Vec<Bottleneck>,
    /// To the first branch.
    first: ConvNorm,
    /// To the new branch of each stage, from the coarsest map before it.
    transitions: [ConvNorm; 3],
    stages: [Vec<Module>; 3],
}

impl Encoder {
    /// The encoder stored in the checkpoint file `file`.
    pub(super) fn new(file: &str, config: &DHrNetConfig) -> Self {
        let widths = config.branches();
        let wide = EXPANSION * config.bottleneck;
        let path = |name: &str| format!("{file}:{name}");
        let stem =
            |n: usize, inputs| ConvNorm::new(path(&format!("conv{n}")), path(&format!("bn{n}")), [inputs, config.stem], 3, 2);
        let bottleneck = |j: usize| {
            let inputs = if j == 0 { config.stem } else { wide };
            Bottleneck::new(&path(&format!("layer1.{j}")), inputs, config.bottleneck)
        };
        let transition = |t: usize| {
            let inputs = if t == 0 { wide } else { widths[t] };
            ConvNorm::pair(&path(&format!("transition{}.{}.0", t + 1, t + 1)), [inputs, widths[t + 1]], 3, 2)
        };
        let module = |t: usize, m: usize| Module::new(&path(&format!("stage{}.{m}", t + 2)), &widths[..t + 2], config.blocks);
        Self {
            stem: [stem(1, 3), stem(2, config.stem)],
            layer: (0..config.bottlenecks).map(bottleneck).collect(),
            first: ConvNorm::pair(&path("transition1.0"), [wide, widths[0]], 3, 1),
            transitions: std::array::from_fn(transition),
            stages: std::array::from_fn(|t| (0..config.modules[t]).map(|m| module(t, m)).collect()),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.stem.iter().for_each(|conv| conv.declare(blueprint));
        self.layer.iter().for_each(|block| block.declare(blueprint));
        self.first.declare(blueprint);
        for (transition, modules) in self.transitions.iter().zip(&self.stages) {
            transition.declare(blueprint);
            modules.iter().for_each(|module| module.declare(blueprint));
        }
    }

    /// Images in [0, 1], (N, 3, H, W) -> features at 1/2, 1/4, 1/8, 1/16 and 1/32 of the size. Nothing is taken out of the
    /// images.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, images: Var<'t, T>) -> [Var<'t, T>; 5] {
        let [once, twice] = &self.stem;
        let half = once.forward(binder, images, Activation::Relu);
        let quarter = twice.forward(binder, half, Activation::Relu);
        let quarter = self.layer.iter().fold(quarter, |x, block| block.forward(binder, x));
        // The first branch is made last, when the values of the map that both first branches come from can go.
        let second = self.transitions[0].forward(binder, quarter, Activation::Relu);
        let first = quarter.last_use(|x| self.first.forward(binder, x, Activation::Relu));
        let mut maps = vec![first, second];
        for (t, modules) in self.stages.iter().enumerate() {
            if t > 0 {
                let new = self.transitions[t].forward(binder, maps[t], Activation::Relu);
                maps.push(new);
            }
            maps = modules.iter().fold(maps, |maps, module| module.forward(binder, maps));
        }
        [half, maps[0], maps[1], maps[2], maps[3]]
    }
}
