//! What the networks said about a batch, and the gradient with respect to it.

use dimode_autodiff::{Tape, Tensor, Var};
use dimode_geometry::taped::Pose;

/// What the networks said about a batch of `n` snippets. Disparities are on one tape, everything else is on one, too, which may be
/// another.
pub struct Outputs<'t> {
    /// Disparities of the targets in (0, 1), full size first, `[n, 1, h, w]`.
    pub disparities: Vec<Var<'t, f32>>,
    /// Disparities of the sources, previous ones first, full size first, `[2 n, 1, h, w]`; empty where no term needs them.
    pub source_disparities: Vec<Var<'t, f32>>,
    /// Motions `source_from_target`, 2 n of them, previous ones first.
    pub motion: Pose<'t, f32>,
    /// Optical flow; only where a term needs it.
    pub flow: Option<Flow<'t>>,
    /// The sources without rotation, `[2 n, 3, h, w]`, where it was removed.
    pub rectified: Option<Var<'t, f32>>,
}

/// Optical flow between targets and sources, `[2 n, 2, h, w]`, pixels, previous sources first.
#[derive(Clone, Copy)]
pub struct Flow<'t> {
    /// From target to source.
    pub forward: Var<'t, f32>,
    /// From source to target; only where a term needs it.
    pub backward: Option<Var<'t, f32>>,
    /// Whether its network is trained by these losses.
    pub trained: bool,
}

impl<'t> Flow<'t> {
    fn maps(self) -> impl Iterator<Item = Var<'t, f32>> {
        std::iter::once(self.forward).chain(self.backward)
    }

    /// The same values on another tape.
    fn on<'l>(self, tape: &'l Tape<f32>) -> Flow<'l> {
        let put = |x: Var<'t, f32>| if self.trained { tape.leaf(x.value()) } else { tape.constant(x.value()) };
        Flow { forward: put(self.forward), backward: self.backward.map(put), trained: self.trained }
    }
}

/// The gradient of the total with respect to [`Outputs`], in the same order.
pub struct OutputGradients(pub(super) Vec<Tensor<f32>>);

impl<'t> Outputs<'t> {
    /// Everything that takes a gradient: the disparities, then the rest.
    pub(super) fn all(&self) -> Vec<Var<'t, f32>> {
        [self.of_depth(), self.of_motion()].concat()
    }

    fn of_depth(&self) -> Vec<Var<'t, f32>> {
        self.disparities.iter().chain(&self.source_disparities).copied().collect()
    }

    fn of_motion(&self) -> Vec<Var<'t, f32>> {
        let mut all = vec![self.motion.rotation, self.motion.translation];
        all.extend(self.flow.filter(|flow| flow.trained).into_iter().flat_map(Flow::maps));
        all.extend(self.rectified);
        all
    }

    /// Two scalars whose gradients with respect to the outputs are the given ones: of the disparities, and of everything else.
    pub fn carry(&self, gradients: &OutputGradients) -> [Var<'t, f32>; 2] {
        let (outputs, mut gradients) = ([self.of_depth(), self.of_motion()], gradients.0.iter());
        outputs.map(|outputs| {
            let parts: Vec<_> = outputs.into_iter().zip(&mut gradients).map(|(x, g)| dot(x, g)).collect();
            parts.into_iter().reduce(|a, b| a.add(b)).expect("there are always outputs")
        })
    }

    /// The same values as leaves of another tape; a flow that is not trained as constants.
    pub(super) fn on<'l>(&self, tape: &'l Tape<f32>) -> Outputs<'l> {
        let leaves = |maps: &[Var<'t, f32>]| maps.iter().map(|d| tape.leaf(d.value())).collect();
        Outputs {
            disparities: leaves(&self.disparities),
            source_disparities: leaves(&self.source_disparities),
            motion: Pose {
                rotation: tape.leaf(self.motion.rotation.value()),
                translation: tape.leaf(self.motion.translation.value()),
            },
            flow: self.flow.map(|flow| flow.on(tape)),
            rectified: self.rectified.map(|images| tape.leaf(images.value())),
        }
    }
}

/// Sum of `x * weights`: carries a known gradient into a variable's tape.
fn dot<'t>(x: Var<'t, f32>, weights: &Tensor<f32>) -> Var<'t, f32> {
    x.mul(x.tape().constant(weights.clone())).sum()
}
