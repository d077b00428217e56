//! Comparison of all results of one golden file, in double or single precision, with a list of what has been compared.

use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};

use dimode_autodiff::{Gradients, Scalar, Shape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_tests::{Golden, json};

/// Distance of values in double precision, as a share of the largest magnitude of the tensor.
const VALUE: f64 = 1e-10;
/// The same of gradients.
const GRADIENT: f64 = 1e-8;
/// In single precision a tensor may be off by this many times the error of the reference in single precision
/// (`f32_noise.json`, a share of the largest magnitude as well) and one rounding. The error of a single number is one draw, which
/// may come out at nothing by chance, so it counts as one rounding at least.
const NOISE: f64 = 4.0;

/// A golden file `NAME.f64` or `NAME.f32`, as `T` says, whose results are compared one after the other.
///
/// Tensors named `out.` are values, others gradients. A tensor of zeros must be met exactly.
pub struct Compared<T> {
    name: String,
    golden: Golden,
    noise: BTreeMap<String, f64>,
    seen: RefCell<BTreeSet<String>>,
    worst: [Cell<f64>; 2],
    kind: std::marker::PhantomData<T>,
}

impl<T: Scalar> Compared<T> {
    /// Opens a file of `golden/losses`.
    #[track_caller]
    pub fn open(name: &str) -> Self {
        let noise = json("losses/f32_noise.json");
        let noise = noise[name].as_object().unwrap_or_else(|| panic!("f32_noise.json has no '{name}'"));
        Compared {
            name: format!("{name}.{}", T::NAME),
            golden: Golden::open(&format!("losses/{name}.{}.safetensors", T::NAME)),
            noise: noise.iter().map(|(k, v)| (k.clone(), v.as_f64().expect("a number"))).collect(),
            seen: RefCell::default(),
            worst: [Cell::new(0.0), Cell::new(0.0)],
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
        let found: Vec<f64> = found.data().iter().map(|x| x.to_f64()).collect();
        self.numbers_match(name, &found);
    }

    /// Compares a result whose numbers are given in the stored order.
    #[track_caller]
    pub fn numbers_match(&self, name: &str, found: &[f64]) {
        let expected = self.result(name, found.len());
        let scale = expected.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let value = name.starts_with("out.");
        let share = match T::NAME {
            "f32" => {
                let least = if expected.len() == 1 { f64::from(f32::EPSILON) } else { 0.0 };
                NOISE * self.noise(name).max(least) + f64::from(f32::EPSILON)
            }
            _ if value => VALUE,
            _ => GRADIENT,
        };
        let off = |(a, b): (&f64, &f64)| if a.is_finite() { (a - b).abs() } else { f64::INFINITY };
        let worst = found.iter().zip(expected).map(off).fold(0.0, f64::max);
        assert!(
            worst <= share * scale,
            "{}: '{name}' is off by {worst:.3e} at a scale of {scale:.3e}, that is {:.3e}; {share:.1e} is allowed",
            self.name,
            worst / scale
        );
        if scale > 0.0 {
            let worst_so_far = &self.worst[usize::from(!value)];
            worst_so_far.set(worst_so_far.get().max(worst / scale / if T::NAME == "f32" { share } else { 1.0 }));
        }
    }

    /// Compares a mask or indices: none may differ in double precision, in single as many as differ within the reference.
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
        let left = |name: &&str| (name.starts_with("out.") || name.starts_with("grad")) && !seen.contains(*name);
        let left: Vec<&str> = self.golden.names().filter(left).collect();
        assert!(left.is_empty(), "{}: not compared: {}", self.name, left.join(", "));
        let [value, gradient] = &self.worst;
        println!("{}: {} tensors, worst value {:.1e}, gradient {:.1e}", self.name, seen.len(), value.get(), gradient.get());
    }

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
