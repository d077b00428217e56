//! All parameters of one network: one [`Params`] per checkpoint file.

use dimode_autodiff::{Scalar, Tensor};

use crate::blueprint::split_path;
use crate::{Entry, Kind, Params, StatisticsUpdate};

/// Momentum of running statistics: the share of the newest batch.
const MOMENTUM: f64 = 0.1;

/// The checkpoint files of a network, in order, each with its tensors in order.
///
/// A tensor is addressed by its path `file:name`, for example `encoder:encoder.conv1.weight`.
#[derive(Clone, Debug, Default)]
pub struct ParamSet<T: Scalar> {
    files: Vec<(String, Params<T>)>,
}

impl<T: Scalar> ParamSet<T> {
    /// A set without files.
    pub fn new() -> Self {
        Self { files: Vec::new() }
    }

    /// Names and contents of the files in order.
    pub fn files(&self) -> impl ExactSizeIterator<Item = (&str, &Params<T>)> {
        self.files.iter().map(|(name, p)| (name.as_str(), p))
    }

    /// The content of one file.
    pub fn file(&self, name: &str) -> Option<&Params<T>> {
        self.files.iter().find(|(n, _)| n == name).map(|(_, p)| p)
    }

    /// The content of one file, to be changed; an empty one is added when there is none.
    pub fn file_mut(&mut self, name: &str) -> &mut Params<T> {
        let position = self.files.iter().position(|(n, _)| n == name);
        let position = position.unwrap_or_else(|| {
            self.files.push((name.to_owned(), Params::new()));
            self.files.len() - 1
        });
        &mut self.files[position].1
    }

    /// The entry at a path `file:name`.
    pub fn get(&self, path: &str) -> Option<&Entry<T>> {
        let (file, name) = split_path(path);
        self.file(file).and_then(|p| p.get(name))
    }

    /// The entry at a path `file:name`, to be changed.
    pub fn get_mut(&mut self, path: &str) -> Option<&mut Entry<T>> {
        let (file, name) = split_path(path);
        let found = self.files.iter_mut().find(|(n, _)| n == file);
        found.and_then(|(_, p)| p.get_mut(name))
    }

    /// Replaces the values at a path.
    ///
    /// # Panics
    /// When the path does not exist or the shape differs.
    #[track_caller]
    pub fn set(&mut self, path: &str, tensor: Tensor<T>) {
        match self.get_mut(path) {
            Some(entry) => entry.set(tensor),
            None => panic!("params: there is no '{path}'"),
        }
    }

    /// Paths and entries, file by file.
    pub fn iter(&self) -> impl Iterator<Item = (String, &Entry<T>)> {
        self.files().flat_map(|(file, params)| params.iter().map(move |(name, entry)| (path(file, name), entry)))
    }

    /// Paths and entries, file by file, to be changed.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = (String, &mut Entry<T>)> {
        self.files.iter_mut().flat_map(|(file, params)| params.iter_mut().map(move |(name, entry)| (path(file, name), entry)))
    }

    /// The trained tensors, in the order in which [`crate::Binder::gradients`] returns gradients.
    pub fn trainable(&self) -> impl Iterator<Item = (String, &Entry<T>)> {
        self.iter().filter(|(_, e)| e.kind() == Kind::Parameter)
    }

    /// Number of tensors.
    pub fn len(&self) -> usize {
        self.files.iter().map(|(_, p)| p.len()).sum()
    }

    /// True when there are no tensors.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of scalars in parameters, trained and frozen.
    pub fn parameter_count(&self) -> usize {
        self.files.iter().map(|(_, p)| p.parameter_count()).sum()
    }

    /// The same values in another scalar type.
    pub fn cast<U: Scalar>(&self) -> ParamSet<U> {
        let cast = |(name, p): &(String, Params<T>)| (name.clone(), p.cast());
        ParamSet { files: self.files.iter().map(cast).collect() }
    }

    /// Moves running statistics towards those of the batches seen in training:
    /// `running <- 0.9 running + 0.1 batch`, in the order of the forward passes.
    ///
    /// # Panics
    /// When an update names a layer that this set does not have.
    #[track_caller]
    pub fn apply_statistics(&mut self, updates: &[StatisticsUpdate<T>]) {
        for update in updates {
            self.blend(&format!("{}.running_mean", update.layer), &update.mean);
            self.blend(&format!("{}.running_var", update.layer), &update.variance);
        }
    }

    #[track_caller]
    fn blend(&mut self, path: &str, batch: &Tensor<T>) {
        let Some(entry) = self.get_mut(path) else {
            panic!("params: there is no running statistic '{path}'");
        };
        let (keep, take) = (T::from_f64(1.0 - MOMENTUM), T::from_f64(MOMENTUM));
        let old = entry.tensor();
        let blended = old.data().iter().zip(batch.data());
        let blended = blended.map(|(&r, &b)| keep * r + take * b).collect();
        let blended = Tensor::from_vec(old.shape(), blended);
        entry.set(blended);
    }
}

/// `file:name`, in one allocation: every step asks for all paths.
fn path(file: &str, name: &str) -> String {
    [file, ":", name].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;

    fn set() -> ParamSet<f64> {
        let mut set = ParamSet::new();
        let shape = Shape::new(1, 2, 1, 1);
        for (name, kind, value) in
            [("bn.weight", Kind::Parameter, 1.0), ("bn.running_mean", Kind::Buffer, 2.0), ("bn.running_var", Kind::Buffer, 4.0)]
        {
            let entry = Entry::new(vec![2], kind, Tensor::full(shape, value));
            set.file_mut("net").insert(name, entry);
        }
        set
    }

    #[test]
    fn running_statistics_move_by_a_tenth() {
        let mut set = set();
        let update = StatisticsUpdate {
            layer: "net:bn".into(),
            mean: Tensor::from_vec(Shape::new(1, 2, 1, 1), vec![12.0, 2.0]),
            variance: Tensor::from_vec(Shape::new(1, 2, 1, 1), vec![4.0, 14.0]),
        };
        set.apply_statistics(&[update]);
        let of = |path: &str| set.get(path).unwrap().tensor().to_vec();
        assert_eq!(of("net:bn.running_mean"), [3.0, 2.0]);
        assert_eq!(of("net:bn.running_var"), [4.0, 5.0]);
    }

    #[test]
    fn trainable_leaves_buffers_and_frozen_parameters_out() {
        let mut set = set();
        let frozen = Entry::new(vec![3], Kind::Frozen, Tensor::full(Shape::new(1, 3, 1, 1), 1.0));
        set.file_mut("net").insert("conv.weight", frozen);
        assert_eq!(set.len(), 4);
        assert_eq!(set.parameter_count(), 5);
        let paths: Vec<String> = set.trainable().map(|(path, _)| path).collect();
        assert_eq!(paths, ["net:bn.weight"]);
    }
}
