//! One entry of the reference numbers, which knows what of it has been reproduced.

use std::cell::RefCell;
use std::collections::BTreeSet;

use dimode_geometry::{Intrinsics, Se3, scenes, so3};
use nalgebra::{Vector2, Vector3};
use serde_json::Value;

/// An entry.
pub struct Entry {
    value: Value,
    reproduced: RefCell<BTreeSet<String>>,
}

/// Entries of the file.
pub fn entries() -> Vec<Entry> {
    let file = dimode_tests::json("derivations/derivations.json");
    let entries = file["entries"].as_array().expect("a list of entries").clone();
    entries.into_iter().map(|value| Entry { value, reproduced: RefCell::default() }).collect()
}

impl Entry {
    /// Short name of the claim, and the case.
    pub fn name(&self) -> (&str, &str) {
        (self.value["id"].as_str().unwrap(), self.value["case"].as_str().unwrap())
    }

    /// An input.
    pub fn input(&self, name: &str) -> &Value {
        self.value["inputs"].get(name).unwrap_or_else(|| panic!("{:?} has no input '{name}'", self.name()))
    }

    /// The numbers of an input, row by row.
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        numbers(self.input(name))
    }

    /// An input of one number.
    pub fn number(&self, name: &str) -> f64 {
        self.input(name).as_f64().unwrap_or_else(|| panic!("{:?}: '{name}' is no number", self.name()))
    }

    /// An input of three numbers.
    pub fn vector(&self, name: &str) -> Vector3<f64> {
        Vector3::from_column_slice(&self.numbers(name))
    }

    /// Rows of a table.
    pub fn rows(&self, name: &str) -> Vec<Vec<f64>> {
        self.input(name).as_array().unwrap().iter().map(numbers).collect()
    }

    /// The pixel `p`, or `u` and `v`.
    pub fn pixel(&self) -> Vector2<f64> {
        match self.value["inputs"].get("p") {
            Some(p) => Vector2::from_column_slice(&numbers(p)),
            None => Vector2::new(self.number("u"), self.number("v")),
        }
    }

    /// The camera `cam`, of an image that the entry does not tell.
    pub fn camera(&self) -> Intrinsics {
        let k = self.input("cam");
        let k = if let Some(name) = k.as_str() { return named_camera(name) } else { k };
        let get = |field: &str| k[field].as_f64().unwrap();
        Intrinsics::new(get("fu"), get("fv"), get("u0"), get("v0"), 640, 288).unwrap()
    }

    /// Motion of a rotation vector and a translation in the source frame, named as the inputs.
    pub fn pose(&self, omega: &str, t: &str) -> Se3 {
        Se3 { rotation: so3::exp(&self.vector(omega)), translation: self.vector(t) }
    }

    /// Compares the expected numbers at a place (`flow`, `pixel_100/p_s`, `rows/2`), row by row.
    #[track_caller]
    pub fn check(&self, place: &str, found: &[f64]) {
        self.check_within(place, found, 0.0);
    }

    /// As [`Entry::check`] with a larger absolute tolerance, for numbers that are zero in exact arithmetic.
    #[track_caller]
    pub fn check_within(&self, place: &str, found: &[f64], atol: f64) {
        let pointer = format!("/{place}");
        let expected = self.value["expected"].pointer(&pointer);
        let expected = expected.unwrap_or_else(|| panic!("{:?} expects nothing at '{place}'", self.name()));
        let expected = numbers(expected);
        assert_eq!(found.len(), expected.len(), "{:?} '{place}': number of values", self.name());
        let (rtol, own) = (self.value["rtol"].as_f64().unwrap(), self.value["atol"].as_f64().unwrap());
        for (i, (a, b)) in found.iter().zip(&expected).enumerate() {
            let bound = own.max(atol) + rtol * b.abs();
            assert!(
                (a - b).abs() <= bound,
                "{:?} '{place}' [{i}]: {a:e}, expected {b:e}, off by {:e}",
                self.name(),
                (a - b).abs()
            );
        }
        self.reproduced.borrow_mut().insert(pointer);
    }

    /// Compares one number by its relative error alone, however small it is.
    #[track_caller]
    pub fn check_relative(&self, place: &str, found: f64) {
        let expected = self.value["expected"].pointer(&format!("/{place}")).and_then(Value::as_f64);
        let expected = expected.unwrap_or_else(|| panic!("{:?} expects no number at '{place}'", self.name()));
        let rtol = self.value["rtol"].as_f64().unwrap();
        assert!(
            (found - expected).abs() <= rtol * expected.abs(),
            "{:?} '{place}': {found:e}, expected {expected:e}",
            self.name()
        );
    }

    /// Fails when an expected number was not compared.
    #[track_caller]
    pub fn finish(&self) {
        let mut leaves = Vec::new();
        collect(&self.value["expected"], String::new(), &mut leaves);
        let reproduced = self.reproduced.borrow();
        let covered = |leaf: &str| reproduced.iter().any(|place| leaf == place || leaf.starts_with(&format!("{place}/")));
        let missing: Vec<_> = leaves.iter().filter(|leaf| !covered(leaf)).collect();
        assert!(missing.is_empty(), "{:?}: expected numbers that nothing was compared with: {missing:?}", self.name());
    }
}

/// A camera by its name.
fn named_camera(name: &str) -> Intrinsics {
    match name {
        "kitti640" => scenes::kitti640(),
        "hand512" => scenes::hand512(),
        other => panic!("no camera '{other}'"),
    }
}

/// All numbers of a nested list, in order.
pub fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Number(number) => vec![number.as_f64().unwrap()],
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        Value::Object(_) | Value::String(_) | Value::Bool(_) | Value::Null => panic!("not numbers: {value}"),
    }
}

/// Pointers to all numbers.
fn collect(value: &Value, place: String, leaves: &mut Vec<String>) {
    match value {
        Value::Number(_) => leaves.push(place),
        Value::Array(items) => items.iter().enumerate().for_each(|(i, v)| collect(v, format!("{place}/{i}"), leaves)),
        Value::Object(fields) => {
            fields.iter().for_each(|(k, v)| collect(v, format!("{place}/{}", k.replace('~', "~0").replace('/', "~1")), leaves))
        }
        Value::String(_) | Value::Bool(_) | Value::Null => {}
    }
}
