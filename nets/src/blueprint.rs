//! The list of tensors a network needs, before there are any numbers.

use std::collections::BTreeSet;

use dimode_autodiff::{Scalar, Tensor};

use crate::params::shape_of;
use crate::{Entry, Init, Kind, ParamSet, fill, init};

/// One tensor of a network: where it is stored, how large it is, how it starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Declaration {
    /// `file:name`: checkpoint file without extension, then the name inside that file.
    pub path: String,
    /// Dimensions as in the checkpoint file, rank kept.
    pub dims: Vec<usize>,
    /// Parameter (trained or frozen) or buffer (running statistic).
    pub kind: Kind,
    /// How the start value is drawn.
    pub init: Init,
}

/// All tensors of a network in module order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Blueprint {
    declarations: Vec<Declaration>,
    paths: BTreeSet<String>,
}

impl Blueprint {
    /// An empty list.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a trained tensor.
    ///
    /// # Panics
    /// When the path was declared before or has no `file:` part.
    #[track_caller]
    pub fn parameter(&mut self, path: String, dims: &[usize], init: Init) {
        self.declare(path, dims, Kind::Parameter, init);
    }

    /// Adds a tensor that is stored but not trained.
    ///
    /// # Panics
    /// As [`Blueprint::parameter`].
    #[track_caller]
    pub fn buffer(&mut self, path: String, dims: &[usize], init: Init) {
        self.declare(path, dims, Kind::Buffer, init);
    }

    /// Adds what `part` declares; its parameters are [`Kind::Frozen`].
    ///
    /// # Panics
    /// As [`Blueprint::parameter`].
    #[track_caller]
    pub fn frozen(&mut self, part: impl FnOnce(&mut Blueprint)) {
        let mut declared = Blueprint::new();
        part(&mut declared);
        for Declaration { path, dims, kind, init } in declared.declarations {
            let kind = if kind == Kind::Parameter { Kind::Frozen } else { kind };
            self.declare(path, &dims, kind, init);
        }
    }

    #[track_caller]
    fn declare(&mut self, path: String, dims: &[usize], kind: Kind, init: Init) {
        split_path(&path);
        assert!(self.paths.insert(path.clone()), "blueprint: '{path}' is declared twice");
        self.declarations.push(Declaration { path, dims: dims.to_vec(), kind, init });
    }

    /// The tensors in order.
    pub fn declarations(&self) -> &[Declaration] {
        &self.declarations
    }

    /// Names of the checkpoint files in order.
    pub fn files(&self) -> Vec<&str> {
        let mut files = Vec::new();
        for declaration in &self.declarations {
            let (file, _) = split_path(&declaration.path);
            if !files.contains(&file) {
                files.push(file);
            }
        }
        files
    }

    /// Names and dimensions in one checkpoint file, in order.
    pub fn file(&self, file: &str) -> impl Iterator<Item = (&str, &[usize])> {
        let paths = self.declarations.iter().map(|d| (split_path(&d.path), d.dims.as_slice()));
        paths.filter(move |((own, _), _)| *own == file).map(|((_, name), dims)| (name, dims))
    }

    /// Number of scalars in parameters, trained and frozen.
    pub fn parameter_count(&self) -> usize {
        self.declarations.iter().filter(|d| d.kind != Kind::Buffer).map(|d| d.dims.iter().product::<usize>()).sum()
    }

    /// Start values drawn from `seed`, by the rule of its [`crate::Init`].
    pub fn init<T: Scalar>(&self, seed: u64) -> ParamSet<T> {
        self.build(|d| init::draw(&d.init, seed, &d.path, d.dims.iter().product()))
    }

    /// The deterministic test values of [`fill::values`]; `gain` gives the weight gain of a file.
    pub fn filled<T: Scalar>(&self, gain: impl Fn(&str) -> f64) -> ParamSet<T> {
        self.build(|d| {
            let (file, name) = split_path(&d.path);
            fill::values(name, &d.dims, gain(file))
        })
    }

    fn build<T: Scalar>(&self, values: impl Fn(&Declaration) -> Vec<f64>) -> ParamSet<T> {
        let mut set = ParamSet::new();
        for declaration in &self.declarations {
            let (file, name) = split_path(&declaration.path);
            let data = values(declaration).into_iter().map(T::from_f64).collect();
            let tensor = Tensor::from_vec(shape_of(&declaration.dims), data);
            let entry = Entry::new(declaration.dims.clone(), declaration.kind, tensor);
            set.file_mut(file).insert(name, entry);
        }
        set
    }
}

/// Cuts `file:name` in two.
///
/// # Panics
/// When there is no colon.
#[track_caller]
pub(crate) fn split_path(path: &str) -> (&str, &str) {
    path.split_once(':').unwrap_or_else(|| panic!("parameter path '{path}' has no 'file:' part"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "declared twice")]
    fn a_path_is_declared_once() {
        let mut blueprint = Blueprint::new();
        blueprint.parameter("f:w".into(), &[1], Init::Constant(0.0));
        blueprint.parameter("f:w".into(), &[1], Init::Constant(0.0));
    }

    #[test]
    fn order_and_counts_survive() {
        let mut blueprint = Blueprint::new();
        blueprint.parameter("b:z".into(), &[2, 3], Init::Constant(1.0));
        blueprint.buffer("a:m".into(), &[5], Init::Constant(0.0));
        blueprint.parameter("b:a".into(), &[4], Init::Constant(2.0));
        assert_eq!(blueprint.parameter_count(), 10);
        let set = blueprint.init::<f64>(1);
        let paths: Vec<String> = set.iter().map(|(path, _)| path).collect();
        assert_eq!(paths, ["b:z", "b:a", "a:m"]);
        assert_eq!(blueprint.files(), ["b", "a"]);
        assert_eq!(blueprint.file("b").collect::<Vec<_>>(), [("z", &[2, 3][..]), ("a", &[4])]);
        assert_eq!(set.get("b:a").unwrap().tensor().data(), &[2.0; 4]);
    }

    #[test]
    fn parameters_of_a_frozen_part_are_counted_and_not_trained() {
        let mut blueprint = Blueprint::new();
        blueprint.parameter("f:own".into(), &[2], Init::Constant(1.0));
        blueprint.frozen(|part| {
            part.parameter("f:given".into(), &[3], Init::Constant(2.0));
            part.buffer("f:mean".into(), &[5], Init::Constant(0.0));
        });
        let kinds: Vec<Kind> = blueprint.declarations().iter().map(|d| d.kind).collect();
        assert_eq!(kinds, [Kind::Parameter, Kind::Frozen, Kind::Buffer]);
        assert_eq!(blueprint.parameter_count(), 5);
        assert_eq!(blueprint.init::<f64>(1).trainable().count(), 1);
    }

    #[test]
    fn a_new_tensor_does_not_change_the_others() {
        let mut one = Blueprint::new();
        one.parameter("f:w".into(), &[3], Init::Uniform { bound: 1.0 });
        let mut two = Blueprint::new();
        two.parameter("f:new".into(), &[7], Init::Uniform { bound: 1.0 });
        two.parameter("f:w".into(), &[3], Init::Uniform { bound: 1.0 });
        let (one, two) = (one.init::<f64>(3), two.init::<f64>(3));
        let of = |set: &ParamSet<f64>| set.get("f:w").unwrap().tensor().to_vec();
        assert_eq!(of(&one), of(&two));
    }
}
