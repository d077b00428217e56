//! A golden file in one precision, and which of its results have been compared.
//!
//! **Rule in `f64`**: values within 1e-10 and gradients within 1e-8 of the largest magnitude of the stored tensor.
//!
//! **Rule in `f32`**: inputs are read and everything is computed in `f32`, and compared with the numbers that the reference got in
//! `f32`. `NAME.f32_noise.txt` holds, for each result, how far the reference's own `f32` lies from its `f64`, as a share of the
//! largest `f64` magnitude. Allowed are four times that share plus the spacing of `f32` near 1. For masks it holds how many
//! entries may differ.
//!
//! Values of a scene without error are 0 but for rounding: in `f64` these are compared absolutely, see [`Compared::value_near`].
//!
//! A result that is stored as zeros must be zero exactly, in either precision.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use dimode_autodiff::{Gradients, Scalar, Shape, Tape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_tests::Golden;

const VALUE: f64 = 1e-10;
const GRADIENT: f64 = 1e-8;
const NOISE_FACTOR: f64 = 4.0;

/// See the head of this file.
pub struct Compared<T: Scalar> {
    name: String,
    golden: Golden,
    /// Largest magnitude of every tensor in `f64`.
    scale: BTreeMap<String, f64>,
    /// The noise table, for `f32` only.
    noise: BTreeMap<String, f64>,
    missing: RefCell<BTreeSet<String>>,
    /// Largest error of values and of gradients as a share of the scale and of what is allowed, and where.
    worst: RefCell<[(f64, f64, String); 2]>,
    precision: std::marker::PhantomData<T>,
}

impl<T: Scalar> Compared<T> {
    /// Opens `golden/losses/NAME` in the precision of `T`.
    #[track_caller]
    pub fn open(name: &str) -> Self {
        let file = |precision: &str| Golden::open(&format!("losses/{name}.{precision}.safetensors"));
        let (golden, double) = (file(T::NAME), file("f64"));
        let largest = |tensor: &str| double.numbers(tensor).iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        let results = golden.names().filter(|n| n.starts_with("out.") || n.starts_with("grad"));
        Self {
            name: name.to_owned(),
            scale: double.names().map(|n| (n.to_owned(), largest(n))).collect(),
            noise: if T::NAME == "f32" { noise_table(name) } else { BTreeMap::new() },
            missing: RefCell::new(results.map(str::to_owned).collect()),
            worst: RefCell::default(),
            golden,
            precision: std::marker::PhantomData,
        }
    }

    /// The stored tensors.
    pub fn golden(&self) -> &Golden {
        &self.golden
    }

    /// A stored map.
    #[track_caller]
    pub fn map(&self, name: &str) -> Tensor<T> {
        self.golden.map(name)
    }

    /// A stored map as a leaf.
    #[track_caller]
    pub fn leaf<'t>(&self, tape: &'t Tape<T>, name: &str) -> Var<'t, T> {
        tape.leaf(self.map(name))
    }

    /// A stored list of three numbers for each sample, (N,3,1,1), as a leaf.
    #[track_caller]
    pub fn vectors<'t>(&self, tape: &'t Tape<T>, name: &str) -> Var<'t, T> {
        let count = self.golden.numbers(name).len() / 3;
        tape.leaf(self.golden.tensor(name, Shape::new(count, 3, 1, 1)))
    }

    /// Cameras of `in.K` for 32x24 pixels.
    pub fn cameras(&self) -> Vec<Intrinsics> {
        crate::support::cameras(&self.golden)
    }

    /// Compares a value.
    #[track_caller]
    pub fn value(&self, name: &str, found: &Tensor<T>) {
        self.numbers(name, found, 0);
    }

    /// Compares a value that may be 0 but for rounding: in `f64` within `absolute`, or within the rule if that allows more.
    #[track_caller]
    pub fn value_near(&self, name: &str, found: &Tensor<T>, absolute: f64) {
        if T::NAME == "f64" && self.scale[name] * VALUE < absolute {
            let expected = self.take(name, found.data().len());
            let worst = furthest(found, expected);
            assert!(worst <= absolute, "{} f64: {name}: off by {worst:.2e}, allowed {absolute:.0e}", self.name);
        } else {
            self.value(name, found);
        }
    }

    /// Compares the gradients of each of `leaves`, stored as `PREFIX.LEAF`.
    #[track_caller]
    pub fn gradients(&self, prefix: &str, grads: &Gradients<T>, leaves: &[(&str, Var<'_, T>)]) {
        for (leaf, var) in leaves {
            self.gradient(&format!("{prefix}.{leaf}"), &grads.wrt(*var));
        }
    }

    /// Compares one gradient.
    #[track_caller]
    pub fn gradient(&self, name: &str, found: &Tensor<T>) {
        self.numbers(name, found, 1);
    }

    /// Compares one gradient except at the flat indices where `skip` holds.
    #[track_caller]
    pub fn gradient_except(&self, name: &str, found: &Tensor<T>, skip: impl Fn(usize) -> bool) {
        let expected = self.golden.numbers(name);
        let patched: Vec<T> =
            found.data().iter().enumerate().map(|(i, &x)| if skip(i) { T::from_f64(expected[i]) } else { x }).collect();
        self.numbers(name, &Tensor::from_vec(found.shape(), patched), 1);
    }

    /// Compares a mask: as many entries may differ as the noise table says, none in `f64`.
    #[track_caller]
    pub fn mask(&self, name: &str, found: &Tensor<T>) {
        let expected = self.take(name, found.data().len());
        let differ = found.data().iter().zip(expected).filter(|(f, e)| f.to_f64() != **e).count();
        let allowed = self.noise.get(name).copied().unwrap_or(0.0);
        assert!(differ as f64 <= allowed, "{} {}: {name}: {differ} entries differ, allowed {allowed}", self.name, T::NAME);
    }

    #[track_caller]
    fn numbers(&self, name: &str, found: &Tensor<T>, kind: usize) {
        let expected = self.take(name, found.data().len());
        let scale = self.scale[name];
        let share = self.allowed(name, kind);
        let worst = furthest(found, expected);
        let allowed = share * scale;
        let relative = if worst == 0.0 { 0.0 } else { worst / scale };
        assert!(worst <= allowed, "{} {}: {name}: off by {relative:.2e} of {scale:.2e}, allowed {share:.2e}", self.name, T::NAME);
        let record = &mut self.worst.borrow_mut()[kind];
        if relative / share > record.1 {
            *record = (relative, relative / share, name.to_owned());
        }
    }

    fn allowed(&self, name: &str, kind: usize) -> f64 {
        if T::NAME == "f64" {
            return [VALUE, GRADIENT][kind];
        }
        let noise = self.noise.get(name).unwrap_or_else(|| panic!("{}.f32_noise.txt has no line for {name}", self.name));
        NOISE_FACTOR * noise + T::EPSILON.to_f64()
    }

    /// The stored numbers; the tensor counts as compared.
    #[track_caller]
    fn take(&self, name: &str, length: usize) -> &[f64] {
        let expected = self.golden.numbers(name);
        assert_eq!(length, expected.len(), "{}: {name}", self.name);
        self.missing.borrow_mut().remove(name);
        expected
    }

    /// Asserts that nothing was left out, and prints the largest errors.
    #[track_caller]
    pub fn finish(self) {
        let missing = self.missing.into_inner();
        assert!(missing.is_empty(), "{} {}: not compared: {missing:?}", self.name, T::NAME);
        for (kind, (relative, of_allowed, at)) in ["value", "gradient"].iter().zip(self.worst.into_inner()) {
            println!("{} {}: {kind} furthest {relative:.1e} ({of_allowed:.2} of what is allowed) at {at}", self.name, T::NAME);
        }
    }
}

/// Largest difference; infinite when a number is not finite.
fn furthest<T: Scalar>(found: &Tensor<T>, expected: &[f64]) -> f64 {
    let error = |f: &T, e: &f64| if f.is_finite() { (f.to_f64() - e).abs() } else { f64::INFINITY };
    found.data().iter().zip(expected).map(|(f, e)| error(f, e)).fold(0.0, f64::max)
}

/// `NAME.f32_noise.txt`: a result and its noise on each line, or the number of entries that differ.
#[track_caller]
fn noise_table(name: &str) -> BTreeMap<String, f64> {
    let path = dimode_tests::path(&format!("losses/{name}.f32_noise.txt"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    text.lines()
        .map(|line| {
            let mut words = line.split_whitespace();
            let (result, noise) = (words.next().expect("a name"), words.next().expect("a number"));
            (result.to_owned(), noise.parse().unwrap_or_else(|e| panic!("{name}: {line}: {e}")))
        })
        .collect()
}

#[test]
#[should_panic(expected = "not compared: {\"out.bw_warped\"")]
fn a_result_that_no_test_reads_is_named() {
    Compared::<f64>::open("flow_masks").finish();
}

#[test]
#[should_panic(expected = "out.range_map: off by")]
fn a_difference_is_named() {
    let c = Compared::<f64>::open("flow_masks");
    let mut numbers = c.map("out.range_map").to_vec();
    numbers[7] += 1e-9;
    c.value("out.range_map", &Tensor::from_vec(Shape::new(2, 1, 24, 32), numbers));
}

#[test]
#[should_panic(expected = "out.in_view: 1 entries differ, allowed 0")]
fn another_mask_is_named() {
    let c = Compared::<f32>::open("flow_masks");
    let mut numbers = c.map("out.in_view").to_vec();
    numbers[7] = 1.0 - numbers[7];
    c.mask("out.in_view", &Tensor::from_vec(Shape::new(2, 1, 24, 32), numbers));
}
