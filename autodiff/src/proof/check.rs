//! The comparison of a case with its oracles.

use std::collections::BTreeSet;
use std::fmt;

use super::{Case, Draw, Dual, Plain, Proof, fault::Planted};
use crate::gradcheck::{random, weighted_sum};
use crate::{GradCheck, Scalar, Shape, Tape, Tensor, Var, gradcheck};

/// Bound on the relative error in `f64` of values and gradients against the reference.
pub const TOLERANCE: f64 = 1e-12;

/// Worst relative errors.
///
/// The error of an entry is divided by its scale: the sum of the magnitudes of the terms `Jⱼᵢ wⱼ` for a gradient, the magnitude
/// itself for a value; at least a hundredth of the largest scale in the tensor. An error that is not a number counts as infinite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Value against the plain loop.
    pub value: f64,
    /// Entries of the gradient against the plain loop in forward mode.
    pub tangent: f64,
    /// `<J v, w>` against `<v, J' w>`.
    pub product: f64,
    /// Entries of the gradient against central differences, relative to the larger one or a thousandth of the largest.
    pub differences: f64,
    /// Whether the differences are within the tolerance of [`GradCheck`].
    pub differences_failed: bool,
    /// Value in `f32` against `f64`.
    pub single_value: f64,
    /// Gradient in `f32` against `f64`.
    pub single_gradient: f64,
}

impl Errors {
    /// The larger of each.
    fn worst(self, other: Errors) -> Errors {
        Errors {
            value: self.value.max(other.value),
            tangent: self.tangent.max(other.tangent),
            product: self.product.max(other.product),
            differences: self.differences.max(other.differences),
            differences_failed: self.differences_failed || other.differences_failed,
            single_value: self.single_value.max(other.single_value),
            single_gradient: self.single_gradient.max(other.single_gradient),
        }
    }

    /// Whether all are within their bounds.
    pub fn are_ok(&self, single_bound: f64) -> bool {
        self.value <= TOLERANCE
            && self.tangent <= TOLERANCE
            && self.product <= TOLERANCE
            && !self.differences_failed
            && self.single_value <= single_bound
            && self.single_gradient <= single_bound
    }
}

/// What [`Proof::check`] found.
#[derive(Clone, Debug)]
pub struct Report {
    /// Name of the operation.
    pub op: &'static str,
    /// Cases tried.
    pub cases: usize,
    /// Different lists of operand shapes among them.
    pub shapes: usize,
    /// Worst errors over all cases.
    pub errors: Errors,
    /// Bound on the errors in `f32`.
    pub single_bound: f64,
    /// Cases outside a bound, with their errors.
    pub failures: Vec<String>,
}

impl Report {
    /// Whether every case is within the bounds.
    pub fn is_ok(&self) -> bool {
        self.failures.is_empty() && self.cases > 0
    }

    /// Panics with the failed cases unless [`Report::is_ok`].
    #[track_caller]
    pub fn assert_ok(&self) {
        assert!(self.is_ok(), "{self}");
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {} of {} cases outside the bounds", self.op, self.failures.len(), self.cases)?;
        self.failures.iter().take(5).try_for_each(|failure| writeln!(f, "  {failure}"))
    }
}

impl Proof {
    /// Compares every case with all oracles.
    pub fn check(&self) -> Report {
        let mut errors = Errors::default();
        let mut failures = Vec::new();
        for case in &self.cases {
            let found = case.check();
            if !found.are_ok(self.single_bound) {
                failures.push(format!("{}: {found:?}", case.label()));
            }
            errors = errors.worst(found);
        }
        let shapes: BTreeSet<Vec<Shape>> =
            self.cases.iter().map(|case| case.inputs.iter().map(Tensor::shape).collect()).collect();
        let (cases, shapes) = (self.cases.len(), shapes.len());
        Report { op: self.op, cases, shapes, errors, single_bound: self.single_bound, failures }
    }
}

impl Proof {
    /// Bits of values and gradients of every case, in `f64` and `f32`.
    pub fn bits(&self) -> Vec<u64> {
        self.cases.iter().flat_map(|case| [case.bits::<f64>(), case.bits::<f32>()]).flatten().collect()
    }
}

impl Case {
    /// Compares this case with all oracles.
    pub fn check(&self) -> Errors {
        let expected = Expected::new(self);
        let (value, gradients) = self.gradients::<f64>(&self.inputs, &expected.weights[0], None);
        let differences = self.is_small().then(|| self.differences(None));
        let (single_value, single_gradient) = self.single_errors(&expected);
        let again = self.gradients::<f64>(&self.inputs, &expected.weights[1], None).1;
        Errors {
            value: expected.value_error(&value),
            tangent: expected.error(0, &gradients).max(expected.error(1, &again)),
            product: expected.product_error(self, &gradients),
            differences: differences.as_ref().map_or(0.0, |report| report.relative_error),
            differences_failed: differences.is_some_and(|report| !report.is_ok()),
            single_value,
            single_gradient,
        }
    }

    /// The variables of the inputs on a tape: leaves and constants.
    fn variables<'t, T: Scalar>(&self, tape: &'t Tape<T>, inputs: &[Tensor<T>]) -> Vec<Var<'t, T>> {
        let variable = |(x, &moves): (&Tensor<T>, &bool)| if moves { tape.leaf(x.clone()) } else { tape.constant(x.clone()) };
        inputs.iter().zip(&self.moves).map(variable).collect()
    }

    /// Value and gradients `J' w` of the inputs that move, by the tape, with a fault where one is given.
    pub(crate) fn gradients<T: Runs>(
        &self,
        inputs: &[Tensor<T>],
        weights: &Tensor<T>,
        planted: Option<Planted<T>>,
    ) -> (Tensor<T>, Vec<Tensor<T>>) {
        let tape = Tape::new();
        let vars = self.variables(&tape, inputs);
        let y = T::run(self, &vars);
        if let Some(planted) = planted {
            tape.plant(planted);
        }
        let grads = tape.backward(weigh(y, weights));
        let moving = vars.iter().zip(&self.moves).filter(|(_, moves)| **moves);
        (y.value(), moving.map(|(var, _)| grads.wrt(*var)).collect())
    }

    /// Value by the tape.
    pub(crate) fn value(&self, inputs: &[Tensor<f64>]) -> Tensor<f64> {
        let tape = Tape::new();
        self.subject.double(&self.variables(&tape, inputs)).value()
    }

    /// Bits of value and gradients in one number type.
    fn bits<T: Runs>(&self) -> Vec<u64> {
        let inputs: Vec<Tensor<T>> = self.inputs.iter().map(Tensor::cast).collect();
        let output = self.value(&self.inputs);
        let (value, gradients) = self.gradients(&inputs, &random(1, output.shape(), -1.0, 1.0), None);
        let all = std::iter::once(&value).chain(&gradients);
        all.flat_map(Tensor::data).map(|x| x.to_f64().to_bits()).collect()
    }

    /// The backward rules that run in this case: position on the tape, name and parent.
    pub(crate) fn rules(&self) -> Vec<(usize, &'static str, usize)> {
        let tape = Tape::new();
        self.subject.double(&self.variables(&tape, &self.inputs));
        tape.rules()
    }

    /// Central differences of a weighted sum of the output by the inputs that move.
    pub(crate) fn differences(&self, planted: Option<&dyn Fn() -> Planted<f64>>) -> gradcheck::Report {
        let moving: Vec<Tensor<f64>> =
            self.inputs.iter().zip(&self.moves).filter(|(_, moves)| **moves).map(|(x, _)| x.clone()).collect();
        let settings = GradCheck { allow_zero: true, ..GradCheck::default() };
        gradcheck(
            &moving,
            |tape, vars| {
                let mut vars = vars.iter();
                let all: Vec<_> = self
                    .inputs
                    .iter()
                    .zip(&self.moves)
                    .map(|(x, &moves)| if moves { *vars.next().expect("one for each") } else { tape.constant(x.clone()) })
                    .collect();
                let y = self.subject.double(&all);
                if let Some(planted) = planted {
                    tape.plant(planted());
                }
                weighted_sum(y, 7)
            },
            settings,
        )
    }

    /// Errors of value and gradient in `f32` against `f64` at the inputs that `f32` can hold.
    fn single_errors(&self, expected: &Expected) -> (f64, f64) {
        let inputs: Vec<Tensor<f32>> = self.inputs.iter().map(Tensor::cast).collect();
        let held: Vec<Tensor<f64>> = inputs.iter().map(Tensor::cast).collect();
        let weights: Tensor<f32> = expected.weights[0].cast();
        let (single, singles) = self.gradients(&inputs, &weights, None);
        let (double, doubles) = self.gradients(&held, &weights.cast(), None);
        let pairs = singles.iter().zip(&doubles).zip(&expected.gradients[0]);
        let gradient = pairs.map(|((single, double), (_, scale))| worst(single.cast::<f64>().data(), double.data(), scale));
        let scale: Vec<f64> = double.data().iter().map(|y| y.abs()).collect();
        (worst(single.cast::<f64>().data(), double.data(), &scale), gradient.fold(0.0, f64::max))
    }
}

/// A number type for which a case can run.
pub(crate) trait Runs: Scalar {
    fn run<'t>(case: &Case, vars: &[Var<'t, Self>]) -> Var<'t, Self>;
}

impl Runs for f64 {
    fn run<'t>(case: &Case, vars: &[Var<'t, f64>]) -> Var<'t, f64> {
        case.subject.double(vars)
    }
}

impl Runs for f32 {
    fn run<'t>(case: &Case, vars: &[Var<'t, f32>]) -> Var<'t, f32> {
        case.subject.single(vars)
    }
}

/// `<y, weights>` as a node of its own, so that no operation under proof is part of the check.
fn weigh<'t, T: Scalar>(y: Var<'t, T>, weights: &Tensor<T>) -> Var<'t, T> {
    let weights = weights.clone();
    y.tape().push("weigh", Tensor::scalar(T::ZERO), &[y], move |_, grads| {
        if let Some(mut slot) = grads.slot(0) {
            slot.accumulate(|i| weights.data()[i]);
        }
    })
}

/// What the reference says of a case.
pub(crate) struct Expected {
    value: Plain<f64>,
    /// Weights of the output, twice.
    pub(crate) weights: [Tensor<f64>; 2],
    /// For both weights and every input that moves: `<J eᵢ, w>` and the sum of the magnitudes of its terms.
    gradients: [Vec<(Vec<f64>, Vec<f64>)>; 2],
}

impl Expected {
    /// Runs the reference: once in `f64`, and once in forward mode for every entry that moves.
    pub(crate) fn new(case: &Case) -> Self {
        let value = case.subject.value(&case.inputs.iter().map(Plain::of).collect::<Vec<_>>());
        let mut draw = Draw::new("weights");
        let weights = [draw.weights(value.shape), draw.weights(value.shape)];
        let mut inputs: Vec<Plain<Dual>> = case.inputs.iter().map(Plain::of).collect();
        let mut gradients = [Vec::new(), Vec::new()];
        for k in (0..inputs.len()).filter(|&k| case.moves[k]) {
            let len = inputs[k].data.len();
            let mut found = [(vec![0.0; len], vec![0.0; len]), (vec![0.0; len], vec![0.0; len])];
            for i in 0..len {
                inputs[k].data[i].slope = 1.0;
                let column = case.subject.tangent(&inputs);
                inputs[k].data[i].slope = 0.0;
                for ((sums, scales), weights) in found.iter_mut().zip(&weights) {
                    for (y, w) in column.data.iter().zip(weights.data()) {
                        sums[i] += y.slope * w;
                        scales[i] += (y.slope * w).abs();
                    }
                }
            }
            let [first, second] = found;
            gradients[0].push(first);
            gradients[1].push(second);
        }
        Expected { value, weights, gradients }
    }

    fn value_error(&self, got: &Tensor<f64>) -> f64 {
        if got.shape() != self.value.shape {
            return f64::INFINITY;
        }
        let scale: Vec<f64> = self.value.data.iter().map(|y| y.abs()).collect();
        worst(got.data(), &self.value.data, &scale)
    }

    /// Worst error of the gradients for the given weights.
    pub(crate) fn error(&self, weights: usize, got: &[Tensor<f64>]) -> f64 {
        let pairs = got.iter().zip(&self.gradients[weights]);
        pairs.map(|(got, (want, scale))| worst(got.data(), want, scale)).fold(0.0, f64::max)
    }

    /// Error of the dot-product identity for dense random directions, all inputs at once.
    fn product_error(&self, case: &Case, gradients: &[Tensor<f64>]) -> f64 {
        let mut draw = Draw::new("directions");
        let mut error = 0.0_f64;
        for _ in 0..3 {
            let mut inputs: Vec<Plain<Dual>> = case.inputs.iter().map(Plain::of).collect();
            let (mut backward, mut scale) = (0.0, 0.0);
            let mut gradients = gradients.iter();
            for (x, _) in inputs.iter_mut().zip(&case.moves).filter(|(_, moves)| **moves) {
                let direction = draw.weights(x.shape);
                let gradient = gradients.next().expect("one for each");
                for ((x, &v), &g) in x.data.iter_mut().zip(direction.data()).zip(gradient.data()) {
                    x.slope = v;
                    backward += v * g;
                    scale += (v * g).abs();
                }
            }
            let column = case.subject.tangent(&inputs);
            let terms = column.data.iter().zip(self.weights[0].data()).map(|(y, w)| y.slope * w);
            let (forward, size) = terms.fold((0.0, 0.0), |(sum, size), term| (sum + term, size + term.abs()));
            error = error.max(worst(&[forward], &[backward], &[scale.max(size)]));
        }
        error
    }
}

/// Largest error divided by its scale, at least a hundredth of the largest scale.
fn worst(got: &[f64], want: &[f64], scale: &[f64]) -> f64 {
    let floor = 1e-2 * scale.iter().fold(0.0_f64, |a, &b| a.max(b));
    let error = |((&got, &want), &scale): ((&f64, &f64), &f64)| {
        let error = (got - want).abs() / scale.max(floor);
        if got == want {
            0.0
        } else if error.is_nan() {
            f64::INFINITY
        } else {
            error
        }
    };
    got.iter().zip(want).zip(scale).map(error).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_relative_to_their_scale_and_nan_is_infinite() {
        assert_eq!(worst(&[1.5, 2.0], &[1.0, 2.0], &[2.0, 2.0]), 0.25);
        assert_eq!(worst(&[0.5], &[0.0], &[0.0]), f64::INFINITY);
        assert_eq!(worst(&[f64::NAN], &[0.0], &[1.0]), f64::INFINITY);
        assert_eq!(worst(&[0.0], &[0.0], &[0.0]), 0.0);
    }
}
