//! The multi-scale fusion decoder of D-HRNet.

use dimode_autodiff::{Activation, Scalar, Var};

use super::DHrNetConfig;
use crate::layers::{ConvLayer, ReflectConv};
use crate::{Binder, Blueprint};

/// Rounds of fusion over the four branches; the `k`-th works on the `4 - k` finest of them.
const ROUNDS: usize = 3;

/// In each round every branch passes a [`ReflectConv`] and adds to itself what the coarser ones bring; then the first feature of
/// the encoder joins, and three convolutions lead to the disparity.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Decoder {
    rounds: [Round; ROUNDS],
    /// The first feature of the encoder, and the branch that is added to it.
    joint: [ReflectConv; 2],
    lift: Lift,
    tail: [ReflectConv; 2],
    head: ReflectConv,
}

#[derive(Clone, Debug, PartialEq)]
struct Round {
    convs: Vec<ReflectConv>,
    /// For each branch but the coarsest, what comes from those below it, in their order.
    lifts: Vec<Vec<Lift>>,
}

/// Nearest-neighbour enlargement, 1x1 convolution, ELU.
#[derive(Clone, Debug, PartialEq)]
struct Lift {
    conv: ConvLayer,
    factor: usize,
}

impl Decoder {
    /// The decoder stored in the checkpoint file `file`.
    pub(super) fn new(file: &str, config: &DHrNetConfig) -> Self {
        // Weights start as small as in the reference: each sum of branches makes up for what an ELU takes away.
        let path = |n: usize| format!("{file}:decoder.{n}.conv.conv");
        let conv = |n: usize, inputs, outputs| ReflectConv::new(path(n), inputs, outputs).fan_in();
        let lift = |n: usize, inputs, outputs, factor| Lift { conv: ConvLayer::new(path(n), inputs, outputs, 1), factor };
        let widths = config.branches();
        let round = |convs: [usize; 2], lifts: &[&[usize]]| Round {
            convs: (convs[0]..convs[1]).zip(widths).map(|(n, width)| conv(n, width, width)).collect(),
            lifts: lifts
                .iter()
                .enumerate()
                .map(|(i, numbers)| {
                    let from = |(k, &n): (usize, &usize)| lift(n, widths[i + k + 1], widths[i], 2 << k);
                    numbers.iter().enumerate().map(from).collect()
                })
                .collect(),
        };
        let [half, full] = config.tail;
        Self {
            // The numbers of the reference: layers are numbered as they were made, not as they are used.
            rounds: [
                round([0, 4], &[&[4, 6, 9], &[5, 8], &[7]]),
                round([10, 13], &[&[13, 15], &[14]]),
                round([16, 18], &[&[18]]),
            ],
            joint: [conv(19, config.stem, config.stem), conv(20, widths[0], widths[0])],
            lift: lift(21, widths[0], config.stem, 2),
            tail: [conv(22, config.stem, half), conv(23, half, full)],
            head: ReflectConv::head(format!("{file}:decoder.24.conv"), full, 1),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        for round in &self.rounds {
            round.convs.iter().for_each(|conv| conv.declare(blueprint));
            round.lifts.iter().flatten().for_each(|lift| lift.conv.declare(blueprint));
        }
        self.joint.iter().for_each(|conv| conv.declare(blueprint));
        self.lift.conv.declare(blueprint);
        self.tail.iter().chain([&self.head]).for_each(|conv| conv.declare(blueprint));
    }

    /// Five features, fine to coarse -> the disparity in (0, 1), (N, 1, H, W).
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, features: &[Var<'t, T>; 5]) -> Var<'t, T> {
        let mut branches = features[1..].to_vec();
        for (k, round) in self.rounds.iter().enumerate() {
            let maps: Vec<_> = round.convs.iter().zip(&branches).map(|(conv, &x)| conv.forward(binder, x)).collect();
            if k > 0 {
                branches.iter().for_each(|branch| branch.release());
            }
            let fuse = |(i, lifts): (usize, &Vec<Lift>)| {
                let terms = lifts.iter().zip(&maps[i + 1..]).map(|(lift, &map)| lift.forward(binder, map));
                let brought = terms.reduce(|sum, term| sum.last_use(|sum| term.last_use(|term| sum.add(term))));
                brought.map_or(maps[i], |brought| brought.last_use(|brought| maps[i].add(brought)))
            };
            branches = round.lifts.iter().enumerate().map(fuse).collect();
            maps.iter().for_each(|map| map.release());
        }
        let [own, branch] = &self.joint;
        let branch = branches[0].last_use(|x| branch.forward(binder, x)).last_use(|x| self.lift.forward(binder, x));
        let own = own.forward(binder, features[0]);
        let sum = own.last_use(|own| branch.last_use(|branch| own.add(branch)));
        let [half, full] = &self.tail;
        let x = sum.last_use(|x| half.forward(binder, x)).last_use(|x| x.upsample_nearest(2));
        let x = x.last_use(|x| full.forward(binder, x)).last_use(|x| self.head.linear(binder, x));
        x.last_use(Var::sigmoid)
    }
}

impl Lift {
    /// (N, in, H, W) -> (N, out, factor H, factor W).
    ///
    /// A function of single pixels may as well come before the enlargement, where there are fewer of them.
    fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let y = self.conv.activated(binder, x, Activation::Elu);
        let repeated = y.shape().len() * (self.factor * self.factor - 1);
        binder.count_macs(repeated * self.conv.macs_per_output());
        y.last_use(|y| y.upsample_nearest(self.factor))
    }
}
