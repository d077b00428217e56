//! What all networks have in common: they can say which tensors they need.

use dimode_autodiff::Scalar;

use crate::{Blueprint, ParamSet};

/// A network description without numbers.
pub trait Network {
    /// Every parameter and buffer of the network: path, dimensions, start value, in the order of
    /// the modules. A path is `file:name`, the checkpoint file and the name inside it.
    fn blueprint(&self) -> Blueprint;

    /// Fresh start values from a seed. The value of a tensor depends on the seed and its path
    /// only, so tensors added later do not change the others.
    fn init<T: Scalar>(&self, seed: u64) -> ParamSet<T>
    where
        Self: Sized,
    {
        self.blueprint().init(seed)
    }
}
