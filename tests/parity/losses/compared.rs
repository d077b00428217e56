//! Comparison of all results of one golden file, in double or single precision, with a list of what has been compared.
//!
//! Tensors named `out.` are values, others gradients. Distances count as a share of the largest magnitude that the tensor has in
//! double precision, so a tensor of zeros must be met exactly.
//!
//! - **In `f64`** values lie within 1e-10 and gradients within 1e-8. Values that are 0 but for rounding have no magnitude to speak
//!   of and are compared absolutely: [`Compared::nearly_matches`].
//! - **In `f32`** everything is computed from the inputs of the `f32` file and compared with what the reference got from them.
//!   Allowed are four times the reference's own error in `f32` (`f32_noise.json`, a share of the same magnitude) and one rounding.
//!   The error of a single number is one draw, which may come out at nothing by chance: it counts as one rounding at least.
//! - **Masks and indices** agree in every entry in `f64`; in `f32` as many may differ as differ within the reference.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use dimode_autodiff::{Gradients, Scalar, Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_tests::{Golden, json};

const VALUE: f64 = 1e-10;
const GRADIENT: f64 = 1e-8;
const NOISE: f64 = 4.0;

/// The files `NAME.f64` and, when `T` says so, `NAME.f32`; the results are compared one after the other by the rules above.
pub struct Compared<T> {
    name: String,
    golden: Golden,
    /// Largest magnitude of every tensor in `f64`.
    scale: BTreeMap<String, f64>,
    noise: BTreeMap<String, f64>,
    seen: RefCell<BTreeSet<String>>,
    /// Of values and of gradients.
    worst: RefCell<[Worst; 2]>,
    kind: std::marker::PhantomData<T>,
}

/// The distance that takes most of what is allowed.
#[derive(Default)]
struct Worst {
    of_allowed: f64,
    share: f64,
    name: String,
}

impl<T: Scalar> Compared<T> {
    /// Opens a file of `golden/losses`.
    #[track_caller]
    pub fn open(name: &str) -> Self {
        let file = |precision: &str| Golden::open(&format!("losses/{name}.{precision}.safetensors"));
        let (golden, double) = (file(T::NAME), file("f64"));
        let noise = json("losses/f32_noise.json");
        let noise = noise[name].as_object().unwrap_or_else(|| panic!("f32_noise.json has no '{name}'"));
        Compared {
            name: format!("{name}.{}", T::NAME),
            scale: double.names().map(|n| (n.to_owned(), largest(double.numbers(n)))).collect(),
            noise: noise.iter().map(|(k, v)| (k.clone(), v.as_f64().expect("a number"))).collect(),
            seen: RefCell::default(),
            worst: RefCell::default(),
            golden,
            kind: std::marker::PhantomData,
        }
    }

    /// The stored tensors.
    pub fn golden(&self) -> &Golden {
        &self.golden
    }

    /// A stored map; see [`Golden::map`].
    #[track_caller]
    pub fn map(&self, name: &str) -> Tensor<T> {
        self.golden.map(name)
    }

    /// A stored map as a leaf.
    #[track_caller]
    pub fn leaf<'t>(&self, tape: &'t Tape<T>, name: &str) -> Var<'t, T> {
        tape.leaf(self.map(name))
    }

    /// Stored vectors of three numbers, `[n, 3, 1, 1]`.
    #[track_caller]
    pub fn vectors(&self, name: &str) -> Tensor<T> {
        let numbers = self.golden.numbers(name);
        self.golden.tensor(name, Shape::new(numbers.len() / 3, 3, 1, 1))
    }

    /// Cameras of `in.K` for 32 x 24 pixels.
    #[track_caller]
    pub fn cameras(&self) -> Vec<Intrinsics> {
        crate::support::cameras(&self.golden)
    }

    /// Compares a result.
    #[track_caller]
    pub fn matches(&self, name: &str, found: &Tensor<T>) {
        self.numbers_match(name, &numbers(found));
    }

    /// Compares a result whose numbers are given in the stored order.
    #[track_caller]
    pub fn numbers_match(&self, name: &str, found: &[f64]) {
        let worst = furthest(found, self.result(name, found.len()));
        let (scale, allowed) = (self.scale[name], self.allowed(name, found.len()));
        assert!(
            worst <= allowed * scale,
            "{}: '{name}' is off by {worst:.3e} at a scale of {scale:.3e}, that is {:.3e}; {allowed:.1e} is allowed",
            self.name,
            worst / scale
        );
        let share = if worst == 0.0 { 0.0 } else { worst / scale };
        let record = &mut self.worst.borrow_mut()[usize::from(!is_value(name))];
        if share / allowed > record.of_allowed {
            *record = Worst { of_allowed: share / allowed, share, name: name.to_owned() };
        }
    }

    /// Compares a value that may be 0 but for rounding: in `f64` it lies within `absolute`, where the rule allows less.
    #[track_caller]
    pub fn nearly_matches(&self, name: &str, found: &Tensor<T>, absolute: f64) {
        if T::NAME == "f32" || self.scale[name] * VALUE >= absolute {
            return self.matches(name, found);
        }
        let found = numbers(found);
        let worst = furthest(&found, self.result(name, found.len()));
        assert!(worst <= absolute, "{}: '{name}' is off by {worst:.3e}; {absolute:.1e} is allowed", self.name);
    }

    /// Compares a result except at the indices in the stored order where `skip` holds.
    #[track_caller]
    pub fn matches_except(&self, name: &str, found: &Tensor<T>, skip: impl Fn(usize) -> bool) {
        let expected = self.golden.numbers(name);
        let kept = |(i, x)| if skip(i) { expected[i] } else { x };
        let found: Vec<f64> = numbers(found).into_iter().enumerate().map(kept).collect();
        self.numbers_match(name, &found);
    }

    /// Compares a mask.
    #[track_caller]
    pub fn mask_matches(&self, name: &str, found: &Tensor<T>) {
        self.labels_match(name, numbers(found));
    }

    /// Compares a mask or indices whose numbers are given in the stored order.
    #[track_caller]
    pub fn labels_match(&self, name: &str, found: impl IntoIterator<Item = f64>) {
        let found: Vec<f64> = found.into_iter().collect();
        let expected = self.result(name, found.len());
        let differing = found.iter().zip(expected).filter(|(a, b)| a != b).count();
        let allowed = if T::NAME == "f32" { self.noise(name) } else { 0.0 };
        assert!(differing as f64 <= allowed, "{}: {differing} entries of '{name}' differ; {allowed} may", self.name);
    }

    /// Compares the gradients with respect to variables: tensor `PREFIX.INPUT` for each input.
    #[track_caller]
    pub fn gradients_match(&self, prefix: &str, gradients: &Gradients<T>, inputs: &[(&str, Var<'_, T>)]) {
        for (name, var) in inputs {
            self.matches(&format!("{prefix}.{name}"), &gradients.wrt(*var));
        }
    }

    /// Ends the comparison: every `out.` and `grad` tensor of the file must have been compared.
    #[track_caller]
    pub fn finish(self) {
        let seen = self.seen.borrow();
        let left = |name: &&str| (is_value(name) || name.starts_with("grad")) && !seen.contains(*name);
        let left: Vec<&str> = self.golden.names().filter(left).collect();
        assert!(left.is_empty(), "{}: not compared: {}", self.name, left.join(", "));
        println!("{}: {} tensors", self.name, seen.len());
        for (kind, Worst { of_allowed, share, name }) in ["value", "gradient"].iter().zip(self.worst.borrow().iter()) {
            println!("  {kind} furthest by {share:.1e}, {:.1} % of what is allowed: {name}", 100.0 * of_allowed);
        }
    }

    /// The distance allowed for a tensor of some length, as a share of its magnitude.
    #[track_caller]
    fn allowed(&self, name: &str, len: usize) -> f64 {
        let rounding = f64::from(f32::EPSILON);
        match T::NAME {
            "f32" => NOISE * self.noise(name).max(if len == 1 { rounding } else { 0.0 }) + rounding,
            _ if is_value(name) => VALUE,
            _ => GRADIENT,
        }
    }

    /// The stored numbers; the tensor counts as compared.
    #[track_caller]
    fn result(&self, name: &str, len: usize) -> &[f64] {
        let expected = self.golden.numbers(name);
        assert_eq!(len, expected.len(), "{}: number of entries of '{name}'", self.name);
        self.seen.borrow_mut().insert(name.to_owned());
        expected
    }

    #[track_caller]
    fn noise(&self, name: &str) -> f64 {
        *self.noise.get(name).unwrap_or_else(|| panic!("f32_noise.json: nothing on '{name}' of {}", self.name))
    }
}

fn is_value(name: &str) -> bool {
    name.starts_with("out.")
}

fn numbers<T: Scalar>(tensor: &Tensor<T>) -> Vec<f64> {
    tensor.data().iter().map(|x| x.to_f64()).collect()
}

fn largest(numbers: &[f64]) -> f64 {
    numbers.iter().fold(0.0, |m, x| m.max(x.abs()))
}

/// Largest difference; infinite when a number that was found is not finite.
fn furthest(found: &[f64], expected: &[f64]) -> f64 {
    let off = |(a, b): (&f64, &f64)| if a.is_finite() { (a - b).abs() } else { f64::INFINITY };
    found.iter().zip(expected).map(off).fold(0.0, f64::max)
}

#[test]
#[should_panic(expected = "smoothness.f64: not compared: grad_normalised.disp, grad_normalised.image, grad_raw.disp")]
fn a_result_that_is_left_out_is_named() {
    let golden = Compared::<f64>::open("smoothness");
    golden.matches("out.raw", &golden.map("out.raw"));
    golden.finish();
}

#[test]
#[should_panic(expected = "'out.raw' is off by")]
fn a_number_that_is_off_by_a_billionth_is_refused() {
    let golden = Compared::<f64>::open("smoothness");
    golden.numbers_match("out.raw", &[golden.golden().numbers("out.raw")[0] * (1.0 + 1e-9)]);
}

#[test]
#[should_panic(expected = "'out.range_map' is off by inf")]
fn what_is_not_a_number_is_refused() {
    let golden = Compared::<f64>::open("flow_masks");
    let mut found = golden.golden().numbers("out.range_map").to_vec();
    found[7] = f64::NAN;
    golden.numbers_match("out.range_map", &found);
}

#[test]
#[should_panic(expected = "flow_masks.f32: 1 entries of 'out.in_view' differ; 0 may")]
fn another_mask_is_refused() {
    let golden = Compared::<f32>::open("flow_masks");
    let found = golden.golden().numbers("out.in_view").iter().enumerate().map(|(i, &m)| if i == 7 { 1.0 - m } else { m });
    golden.labels_match("out.in_view", found);
}

/// The two numbers of a result of `dimode_exact` that is 0 but for rounding, moved.
fn almost_zero(golden: &Compared<f64>, by: f64) -> Tensor<f64> {
    Tensor::from_vec(Shape::new(2, 1, 1, 1), golden.golden().numbers("out.next.target.L_pla").iter().map(|x| x + by).collect())
}

/// A gradient whose first entry is off by one.
fn off_at_the_first(golden: &Compared<f64>) -> Tensor<f64> {
    let mut found = golden.golden().numbers("grad_raw.disp").to_vec();
    found[0] += 1.0;
    Tensor::from_vec(golden.map("grad_raw.disp").shape(), found)
}

/// A single number in `f32`, off by a number of roundings.
fn compare_off_by_roundings(count: f64) {
    let golden = Compared::<f32>::open("flow_losses");
    let stored = golden.golden().numbers("out.raft_sequence")[0];
    golden.numbers_match("out.raft_sequence", &[stored * (1.0 + count * f64::from(f32::EPSILON))]);
}

#[test]
fn what_the_rules_allow_passes() {
    compare_off_by_roundings(4.9);
    let golden = Compared::<f64>::open("dimode_exact");
    golden.nearly_matches("out.next.target.L_pla", &almost_zero(&golden, 0.5e-18), 1e-18);
    let golden = Compared::<f64>::open("smoothness");
    golden.matches_except("grad_raw.disp", &off_at_the_first(&golden), |i| i == 0);
}

#[test]
#[should_panic(expected = "flow_losses.f32: 'out.raft_sequence' is off by")]
fn a_single_number_may_be_off_by_five_roundings_only() {
    compare_off_by_roundings(5.1);
}

#[test]
#[should_panic(expected = "'out.next.target.L_pla' is off by 2.000e-18; 1.0e-18 is allowed")]
fn what_is_zero_but_for_rounding_is_compared_absolutely() {
    let golden = Compared::<f64>::open("dimode_exact");
    golden.nearly_matches("out.next.target.L_pla", &almost_zero(&golden, 2e-18), 1e-18);
}

#[test]
#[should_panic(expected = "'grad_raw.disp' is off by")]
fn only_what_is_skipped_may_differ() {
    let golden = Compared::<f64>::open("smoothness");
    golden.matches_except("grad_raw.disp", &off_at_the_first(&golden), |i| i == 1);
}
