//! Weights in a checkpoint, and a trained run taken out of it.

use std::path::Path;

use anyhow::Result;
use dimode_autodiff::Tensor;
use dimode_geometry::Se3;
use dimode_nets::ParamSet;

use super::RunFolder;
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::config::Config;
use crate::data::{Frame, Map};
use crate::model::{Model, Weights, stack};

/// One tensor of a checkpoint: name, stored dimensions, values.
pub type NamedTensor = (String, Vec<usize>, Tensor<f32>);

/// The weights of the three networks as tensors of a checkpoint, named `depth/<file>:<name>` and so on.
pub fn weight_tensors(weights: &Weights) -> Vec<NamedTensor> {
    let sets = [("depth", &weights.depth), ("pose", &weights.pose), ("flow", &weights.flow)];
    let tensors = sets.into_iter().flat_map(|(network, set)| {
        set.iter().map(move |(path, entry)| (format!("{network}/{path}"), entry.dims().to_vec(), entry.tensor().clone()))
    });
    tensors.collect()
}

/// Puts the tensors that [`weight_tensors`] named into `weights`; other tensors are left alone.
///
/// **Errors** [`CheckpointError::Format`] when a tensor of a network is missing or has other dimensions; `path` is named.
pub fn restore_weights(weights: &mut Weights, tensors: &[NamedTensor], path: &Path) -> Result<(), CheckpointError> {
    restore("depth", &mut weights.depth, tensors, path)?;
    restore("pose", &mut weights.pose, tensors, path)?;
    restore("flow", &mut weights.flow, tensors, path)
}

fn restore(network: &str, set: &mut ParamSet<f32>, tensors: &[NamedTensor], path: &Path) -> Result<(), CheckpointError> {
    for (inner, entry) in set.iter_mut() {
        let name = format!("{network}/{inner}");
        let found = tensors.iter().find(|tensor| tensor.0 == name);
        let reason = match found {
            Some((_, dims, tensor)) if dims == entry.dims() => {
                entry.set(tensor.clone());
                continue;
            }
            Some((_, dims, _)) => format!("'{name}' is {dims:?}, the network needs {:?}", entry.dims()),
            None => format!("'{name}' is missing"),
        };
        return Err(CheckpointError::Format { path: path.to_owned(), reason });
    }
    Ok(())
}

/// Networks with the weights of a run.
pub struct TrainedModel {
    /// Settings of the run.
    pub config: Config,
    /// The networks.
    pub model: Model,
    /// Their weights.
    pub weights: Weights,
}

impl TrainedModel {
    /// Reads the last checkpoint of a run folder.
    ///
    /// **Errors** [`super::RunError`], [`crate::config::ConfigError`] or [`CheckpointError`].
    pub fn load(run: &Path) -> Result<Self> {
        let folder = RunFolder::open(run)?;
        let config = folder.read_config()?;
        let model = Model::new(&config.nets);
        let mut weights = model.init(config.seed);
        let path = folder.checkpoint();
        restore_weights(&mut weights, &Checkpoint::read(&path)?.tensors, &path)?;
        Ok(Self { config, model, weights })
    }

    /// Depth of frames of one size, in the unit of the training run.
    pub fn depth(&self, frames: &[&Frame]) -> Vec<Map> {
        let depth = self.model.predict_depth(&self.weights, &stack(frames.iter().map(|frame| &frame.image)));
        let (height, width) = (depth.shape().h(), depth.shape().w());
        depth.data().chunks(height * width).map(|plane| Map::from_vec(height, width, plane.to_vec())).collect()
    }

    /// Motions `next_from_first` between neighbours: one fewer than frames, in the order of time.
    pub fn motions(&self, frames: &[&Frame]) -> Vec<Se3> {
        if frames.len() < 2 {
            return Vec::new();
        }
        let images = |part: &[&Frame]| stack(part.iter().map(|frame| &frame.image));
        let (first, second) = (images(&frames[..frames.len() - 1]), images(&frames[1..]));
        let cameras: Vec<_> = frames[..frames.len() - 1].iter().map(|frame| frame.intrinsics).collect();
        self.model.predict_motion(&self.weights, &first, &second, &cameras)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_survive_the_checkpoint() {
        let model = Model::new(&Config::default().nets);
        let weights = model.init(3);
        let tensors = weight_tensors(&weights);
        let mut other = model.init(4);
        let path = Path::new("c");
        restore_weights(&mut other, &tensors, path).unwrap();
        for (a, b) in weight_tensors(&other).iter().zip(&tensors) {
            assert_eq!((&a.0, &a.1, a.2.data()), (&b.0, &b.1, b.2.data()));
        }
        let message = restore_weights(&mut other, &tensors[1..], path).unwrap_err().to_string();
        assert!(message.contains("is missing"), "{message}");
    }
}
