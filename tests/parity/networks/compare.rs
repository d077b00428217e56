//! Runs a network on a golden case and compares everything that was recorded.

use std::collections::{BTreeMap, BTreeSet};

use dimode_autodiff::{Scalar, Shape, Tape, Tensor, Var};
use dimode_nets::{Binder, Mode, Network, fill};
use dimode_tests::Golden;

use crate::store::{gain, manifest, open};

/// What a network returned, by the names used in the golden files.
pub struct Run<'t, T: Scalar> {
    pub outputs: Vec<(String, Var<'t, T>)>,
    pub mids: Vec<(String, Var<'t, T>)>,
}

/// Relative L2 limits in float32, by group. In float64 it is [`EXACT`] for all.
#[derive(Clone, Copy)]
pub struct Limits {
    pub out: f64,
    pub mid: f64,
    pub grad: f64,
    pub stat: f64,
}

/// One golden file in one mode.
pub struct Case<'a> {
    pub name: &'a str,
    pub mode: Mode,
    pub inputs: &'a [&'a str],
    pub limits: Limits,
}

/// The limit in float64 unless the golden numbers themselves are further from what they should be.
pub const EXACT: f64 = 1e-9;

/// The comparison under way.
struct Comparison<'a, T> {
    golden: &'a Golden,
    prefix: &'static str,
    limits: Limits,
    exact: f64,
    double: bool,
    seen: BTreeSet<String>,
    worst: BTreeMap<&'static str, f64>,
    failures: Vec<String>,
    scalar: std::marker::PhantomData<T>,
}

impl<T: Scalar> Comparison<'_, T> {
    /// Compares one tensor when it was recorded.
    fn check(&mut self, group: &'static str, name: &str, values: &Tensor<T>) {
        let plain = format!("{}.{group}.{name}", self.prefix);
        let double = format!("f64.{plain}");
        let (stored, limit) = match (self.double, self.golden.get(&double)) {
            (true, Some(stored)) => (Some(stored), self.exact),
            _ => (self.golden.get(&plain), self.limit(group)),
        };
        let Some(stored) = stored else { return };
        self.seen.insert(plain.clone());
        let distance = relative_l2(values, &stored.values);
        let exact = limit == self.exact || !self.double;
        let shown = self.worst.entry(if exact { group } else { "f32 only" }).or_default();
        *shown = shown.max(distance);
        if distance.is_nan() || distance > limit {
            self.failures.push(format!("{plain}: {distance:.2e} above {limit:.0e}"));
        }
    }

    fn limit(&self, group: &str) -> f64 {
        match group {
            "out" => self.limits.out,
            "mid" => self.limits.mid,
            "stat" => self.limits.stat,
            _ => self.limits.grad,
        }
    }

    /// The loss is a sum with cancellations: the limit is absolute, in units of the summed magnitudes.
    fn check_loss(&mut self, value: f64, magnitude: f64) {
        let plain = format!("{}.loss", self.prefix);
        let (name, share) = if self.double { (format!("f64.{plain}"), self.exact) } else { (plain.clone(), 1e-5) };
        let stored = self.golden.numbers(&name)[0];
        self.seen.insert(plain);
        if (value - stored).abs() > share * magnitude {
            self.failures.push(format!("{name}: {value} against {stored}"));
        }
    }

    /// Fails with all differences, and when something recorded was not compared.
    fn finish(self, case: &Case) {
        let group: Vec<String> = self.worst.iter().map(|(g, d)| format!("{g} {d:.1e}")).collect();
        println!("{} {} {}: {}", case.name, self.prefix, T::NAME, group.join(", "));
        let wanted = |name: &&str| name.starts_with(self.prefix) && !name.contains(".in.");
        let missed: Vec<&str> = self.golden.names().filter(wanted).collect();
        let missed: Vec<&&str> = missed.iter().filter(|n| !self.seen.contains(**n)).collect();
        assert!(missed.is_empty(), "{}: not compared: {missed:?}", case.name);
        assert!(self.failures.is_empty(), "{}: {:#?}", case.name, self.failures);
    }
}

fn relative_l2<T: Scalar>(values: &Tensor<T>, expected: &[f64]) -> f64 {
    assert_eq!(values.shape().len(), expected.len(), "number of elements");
    let (mut difference, mut norm) = (0.0, 0.0);
    for (a, b) in values.data().iter().zip(expected) {
        difference += (a.to_f64() - b).powi(2);
        norm += b * b;
    }
    if norm == 0.0 { difference.sqrt() } else { (difference / norm).sqrt() }
}

/// Fills the parameters, runs `forward`, and compares outputs, activations, loss, gradients and statistics.
pub fn compare<T, N, F>(case: &Case, network: &N, forward: F)
where
    T: Scalar,
    N: Network,
    F: for<'t> Fn(&mut Binder<'t, T>, &[Var<'t, T>]) -> Run<'t, T>,
{
    compare_within::<T, N, F>(EXACT, case, network, forward);
}

/// The same with another limit in float64.
pub fn compare_within<T, N, F>(exact: f64, case: &Case, network: &N, forward: F)
where
    T: Scalar,
    N: Network,
    F: for<'t> Fn(&mut Binder<'t, T>, &[Var<'t, T>]) -> Run<'t, T>,
{
    let (golden, manifest) = (open(case.name), manifest(case.name));
    let mut params = network.blueprint().filled::<T>(|file| gain(&manifest, file));
    let prefix = match case.mode {
        Mode::Eval => "eval",
        Mode::Train => "train",
    };
    let mut comparison = Comparison {
        golden: &golden,
        prefix,
        limits: case.limits,
        exact,
        double: T::NAME == "f64",
        seen: BTreeSet::new(),
        worst: BTreeMap::new(),
        failures: Vec::new(),
        scalar: std::marker::PhantomData,
    };
    let tape = Tape::new();
    let mut binder = Binder::new(&tape, &params, case.mode);
    let input = |name: &&str| tape.leaf(golden.map(&format!("{prefix}.in.{name}")));
    let inputs: Vec<Var<T>> = case.inputs.iter().map(input).collect();
    let run = forward(&mut binder, &inputs);
    for (name, var) in &run.mids {
        comparison.check("mid", name, &var.value());
    }
    let mut loss = tape.constant(Tensor::zeros(Shape::new(1, 1, 1, 1)));
    let mut magnitude = 0.0;
    for (name, var) in &run.outputs {
        comparison.check("out", name, &var.value());
        let weights = loss_weights::<T>(name, var.shape());
        let products = var.mul(tape.constant(weights));
        magnitude += products.value().data().iter().map(|p| p.to_f64().abs()).sum::<f64>();
        loss = loss.add(products.sum());
    }
    comparison.check_loss(loss.value().item().to_f64(), magnitude);
    let gradients = tape.backward(loss);
    for (name, var) in case.inputs.iter().zip(&inputs) {
        comparison.check("grad", &format!("input.{name}"), &gradients.wrt(*var));
    }
    for item in binder.gradients(&gradients) {
        comparison.check("grad", &format!("param.{}", item.path), &item.gradient);
    }
    params.apply_statistics(&binder.into_statistics());
    if case.mode == Mode::Train {
        for (path, entry) in params.iter() {
            comparison.check("stat", &path, entry.tensor());
        }
    }
    comparison.finish(case);
}

fn loss_weights<T: Scalar>(output: &str, shape: Shape) -> Tensor<T> {
    let key = format!("loss.{output}");
    let weight = |i| T::from_f64(fill::unit(&key, i));
    Tensor::from_vec(shape, (0..shape.len()).map(weight).collect())
}
