//! Parameters on a tape for one step.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use dimode_autodiff::{Gradients, Scalar, Tape, Tensor, Var};

use crate::hash::fnv1a64;
use crate::{Kind, ParamSet, Params};

/// How batch normalisation behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Normalise with the statistics of the batch and report them.
    Train,
    /// Normalise with the running statistics.
    Eval,
}

/// Batch statistics that one normalisation layer saw in one forward pass in training.
#[derive(Clone, Debug)]
pub struct StatisticsUpdate<T: Scalar> {
    /// Path of the layer, for example `encoder:encoder.bn1`.
    pub layer: String,
    /// Mean per channel, (1, C, 1, 1).
    pub mean: Tensor<T>,
    /// Unbiased variance per channel, (1, C, 1, 1).
    pub variance: Tensor<T>,
}

/// Gradient of one trained tensor.
#[derive(Clone, Debug)]
pub struct ParamGradient<T: Scalar> {
    /// Path `file:name` of the parameter.
    pub path: String,
    /// Gradient in the shape of the parameter; zeros when the loss does not depend on it.
    pub gradient: Tensor<T>,
}

enum Bound<'t, T: Scalar> {
    Parameter(Var<'t, T>),
    Frozen(Var<'t, T>),
    Buffer(Tensor<T>),
}

/// The tensors of one network bound to one tape.
///
/// Use one binder for all forward passes of a network in a step: gradients then add up on the
/// same leaves, and batch statistics are collected in order.
pub struct Binder<'t, T: Scalar> {
    tape: &'t Tape<T>,
    mode: Mode,
    bound: Vec<(String, Bound<'t, T>)>,
    index: BTreeMap<String, usize>,
    statistics: Vec<StatisticsUpdate<T>>,
    randomness: Option<Randomness>,
    work: Work,
}

/// Multiply-accumulates by checkpoint file.
struct Work {
    /// Of all files.
    total: AtomicU64,
    /// For each file: the number of tensors up to its end, and what was counted.
    files: Vec<(usize, AtomicU64)>,
    /// Number of the tensor that was asked for last.
    latest: AtomicUsize,
}

impl Work {
    fn none<T: Scalar>(params: &ParamSet<T>) -> Self {
        let mut end = 0;
        let file = |(_, params): (&str, &Params<T>)| {
            end += params.len();
            (end, AtomicU64::new(0))
        };
        Self { total: AtomicU64::new(0), files: params.files().map(file).collect(), latest: AtomicUsize::new(0) }
    }

    fn add(&self, macs: usize) {
        self.total.fetch_add(macs as u64, Ordering::Relaxed);
        let latest = self.latest.load(Ordering::Relaxed);
        if let Some((_, counted)) = self.files.iter().find(|(end, _)| latest < *end) {
            counted.fetch_add(macs as u64, Ordering::Relaxed);
        }
    }
}

/// Where the random numbers of a step come from.
#[derive(Clone, Copy, Debug)]
struct Randomness {
    seed: u64,
    step: u64,
}

impl<'t, T: Scalar> Binder<'t, T> {
    /// Binds every parameter as a leaf that wants a gradient, but for those of [`Kind::Frozen`], which are constants always.
    pub fn new(tape: &'t Tape<T>, params: &ParamSet<T>, mode: Mode) -> Self {
        Self::selective(tape, params, mode, |_| true)
    }

    /// Binds everything as constants, in [`Mode::Eval`]: for frozen networks and inference.
    /// Gradients still pass through the network to its inputs.
    pub fn frozen(tape: &'t Tape<T>, params: &ParamSet<T>) -> Self {
        Self::selective(tape, params, Mode::Eval, |_| false)
    }

    /// Binds as leaves the parameters whose path satisfies `trainable`, the others as constants.
    pub fn selective(tape: &'t Tape<T>, params: &ParamSet<T>, mode: Mode, trainable: impl Fn(&str) -> bool) -> Self {
        let mut bound = Vec::with_capacity(params.len());
        let mut index = BTreeMap::new();
        for (path, entry) in params.iter() {
            let tensor = entry.tensor().clone();
            let item = match entry.kind() {
                Kind::Buffer => Bound::Buffer(tensor),
                Kind::Parameter if trainable(&path) => Bound::Parameter(tape.leaf(tensor)),
                Kind::Parameter => Bound::Parameter(tape.constant(tensor)),
                Kind::Frozen => Bound::Frozen(tape.constant(tensor)),
            };
            index.insert(path.clone(), bound.len());
            bound.push((path, item));
        }
        Self { tape, mode, bound, index, statistics: Vec::new(), randomness: None, work: Work::none(params) }
    }

    /// With random layers at work: what a layer draws depends on `seed`, its path and `step` alone. Without this, and in
    /// [`Mode::Eval`], drop path keeps everything.
    #[must_use]
    pub fn random(mut self, seed: u64, step: u64) -> Self {
        self.randomness = Some(Randomness { seed, step });
        self
    }

    /// Seed of the layer at a path, and the step; `None` where random layers are at rest.
    pub(crate) fn randomness(&self, path: &str) -> Option<(u64, u64)> {
        let Randomness { seed, step } = self.randomness.filter(|_| self.mode == Mode::Train)?;
        Some((seed ^ fnv1a64(path), step))
    }

    /// Counts the multiply-accumulates of a convolution or a matrix product, **as the network is defined**: a layer that finds
    /// the same numbers with less work counts the work of its definition. They go to the checkpoint file of the tensor that was
    /// asked for last: a layer asks for its tensors before it counts.
    pub(crate) fn count_macs(&self, macs: usize) {
        self.work.add(macs);
    }

    /// Multiply-accumulates of the convolutions and matrix products of all forward passes so far, and nothing else.
    pub fn macs(&self) -> u64 {
        self.work.total.load(Ordering::Relaxed)
    }

    /// The same for each checkpoint file, in the order of [`ParamSet::files`].
    pub fn macs_by_file(&self) -> Vec<u64> {
        self.work.files.iter().map(|(_, counted)| counted.load(Ordering::Relaxed)).collect()
    }

    /// The tape everything is bound to.
    pub fn tape(&self) -> &'t Tape<T> {
        self.tape
    }

    /// How batch normalisation behaves.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The variable of the parameter at a path.
    ///
    /// # Panics
    /// When the parameters that were bound do not have it.
    #[track_caller]
    pub fn param(&self, path: &str) -> Var<'t, T> {
        match self.find(path) {
            Bound::Parameter(var) | Bound::Frozen(var) => *var,
            Bound::Buffer(_) => panic!("binder: '{path}' is a buffer, not a parameter"),
        }
    }

    /// The buffer at a path.
    ///
    /// # Panics
    /// When the parameters that were bound do not have it.
    #[track_caller]
    pub fn buffer(&self, path: &str) -> &Tensor<T> {
        match self.find(path) {
            Bound::Buffer(tensor) => tensor,
            Bound::Parameter(_) | Bound::Frozen(_) => panic!("binder: '{path}' is a parameter, not a buffer"),
        }
    }

    #[track_caller]
    fn find(&self, path: &str) -> &Bound<'t, T> {
        match self.index.get(path) {
            Some(&i) => {
                self.work.latest.store(i, Ordering::Relaxed);
                &self.bound[i].1
            }
            None => panic!("binder: '{path}' is not among the bound parameters"),
        }
    }

    /// Notes batch statistics, to be applied after the step.
    pub(crate) fn record_statistics(&mut self, update: StatisticsUpdate<T>) {
        self.statistics.push(update);
    }

    /// The gradient of every parameter that can be trained, constants included (zeros), in the order of
    /// [`ParamSet::trainable`].
    pub fn gradients(&self, gradients: &Gradients<T>) -> Vec<ParamGradient<T>> {
        let gradient = |(path, item): &(String, Bound<'t, T>)| match item {
            Bound::Buffer(_) | Bound::Frozen(_) => None,
            Bound::Parameter(var) => Some(ParamGradient {
                path: path.clone(),
                gradient: match gradients.get(*var) {
                    Some(gradient) => gradient.clone(),
                    None => self.tape.tensor(var.shape(), self.tape.buffer(var.shape().len())),
                },
            }),
        };
        self.bound.iter().filter_map(gradient).collect()
    }

    /// Batch statistics seen so far, in the order of the forward passes.
    pub fn statistics(&self) -> &[StatisticsUpdate<T>] {
        &self.statistics
    }

    /// Batch statistics, for [`ParamSet::apply_statistics`] after the step.
    pub fn into_statistics(self) -> Vec<StatisticsUpdate<T>> {
        self.statistics
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Entry;
    use dimode_autodiff::Shape;

    fn params() -> ParamSet<f64> {
        let mut set = ParamSet::new();
        let shape = Shape::new(1, 2, 1, 1);
        for (name, kind, value) in [("a", Kind::Parameter, 3.0), ("m", Kind::Buffer, 5.0), ("b", Kind::Parameter, 7.0)] {
            let entry = Entry::new(vec![2], kind, Tensor::full(shape, value));
            set.file_mut("net").insert(name, entry);
        }
        set
    }

    #[test]
    fn gradients_come_in_order_with_zeros_for_unused() {
        let (tape, set) = (Tape::new(), params());
        let binder = Binder::new(&tape, &set, Mode::Train);
        let loss = binder.param("net:b").square().sum();
        let gradients = binder.gradients(&tape.backward(loss));
        let paths: Vec<&str> = gradients.iter().map(|g| g.path.as_str()).collect();
        assert_eq!(paths, ["net:a", "net:b"]);
        assert_eq!(gradients[0].gradient.data(), &[0.0, 0.0]);
        assert_eq!(gradients[1].gradient.data(), &[14.0, 14.0]);
    }

    #[test]
    fn frozen_parameters_want_no_gradient() {
        let (tape, set) = (Tape::new(), params());
        let binder = Binder::frozen(&tape, &set);
        assert_eq!(binder.mode(), Mode::Eval);
        assert!(!binder.param("net:a").requires_grad());
        assert_eq!(binder.buffer("net:m").data(), &[5.0, 5.0]);
        let some = Binder::selective(&tape, &set, Mode::Train, |path| path == "net:b");
        assert!(!some.param("net:a").requires_grad());
        assert!(some.param("net:b").requires_grad());
    }

    #[test]
    fn parameters_of_the_frozen_kind_are_constants_without_a_gradient() {
        let (tape, mut set) = (Tape::new(), params());
        let tensor = Tensor::full(Shape::new(1, 1, 1, 1), 2.0);
        set.file_mut("net").insert("given", Entry::new(vec![1], Kind::Frozen, tensor));
        let binder = Binder::new(&tape, &set, Mode::Train);
        assert!(!binder.param("net:given").requires_grad());
        let loss = binder.param("net:given").mul(binder.param("net:b").sum());
        let gradients = binder.gradients(&tape.backward(loss));
        let paths: Vec<&str> = gradients.iter().map(|g| g.path.as_str()).collect();
        assert_eq!(paths, set.trainable().map(|(path, _)| path).collect::<Vec<_>>());
        assert_eq!(gradients[1].gradient.data(), &[2.0, 2.0]);
    }

    #[test]
    fn work_goes_to_the_file_of_the_tensor_that_was_asked_for_last() {
        let (tape, mut set) = (Tape::new(), params());
        let entry = Entry::new(vec![1], Kind::Parameter, Tensor::full(Shape::new(1, 1, 1, 1), 2.0));
        set.file_mut("head").insert("c", entry);
        let binder = Binder::frozen(&tape, &set);
        for (path, macs) in [("net:a", 1), ("head:c", 20), ("net:b", 300), ("net:m", 4000)] {
            let _ = if path == "net:m" { binder.buffer(path).data()[0] } else { binder.param(path).value().data()[0] };
            binder.count_macs(macs);
        }
        assert_eq!((binder.macs_by_file(), binder.macs()), (vec![4301, 20], 4321));
    }

    #[test]
    #[should_panic(expected = "'net:c' is not among the bound parameters")]
    fn unknown_names_are_named() {
        let (tape, set) = (Tape::new(), params());
        Binder::frozen(&tape, &set).param("net:c");
    }
}
