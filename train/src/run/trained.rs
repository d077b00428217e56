//! Weights in a checkpoint, and a trained run taken out of it.

use std::path::Path;
use std::sync::Arc;

use anyhow::Result;
use dimode_autodiff::{Tensor, par};
use dimode_geometry::Se3;
use dimode_nets::ParamSet;

use super::RunFolder;
use crate::batch::first_samples;
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::config::Config;
use crate::data::{Dataset, Frame, Map};
use crate::model::{Model, Weights, stack};
use crate::pose_refinement::Pairs;

/// One tensor of a checkpoint: name, stored dimensions, values.
pub type NamedTensor = (String, Vec<usize>, Tensor<f32>);

/// The weights of the networks as tensors of a checkpoint, named `depth/<file>:<name>` and so on.
pub fn weight_tensors(weights: &Weights) -> Vec<NamedTensor> {
    let tensors = Weights::NAMES.into_iter().zip(weights.sets()).flat_map(|(network, set)| {
        set.iter().map(move |(path, entry)| (format!("{network}/{path}"), entry.dims().to_vec(), entry.tensor().clone()))
    });
    tensors.collect()
}

/// Puts the tensors that [`weight_tensors`] named into `weights`; other tensors are left alone.
///
/// **Errors** [`CheckpointError::Format`] when a tensor of a network is missing or has other dimensions; `path` is named.
pub fn restore_weights(weights: &mut Weights, tensors: &[NamedTensor], path: &Path) -> Result<(), CheckpointError> {
    let mut sets = Weights::NAMES.into_iter().zip(weights.sets_mut());
    sets.try_for_each(|(network, set)| restore(network, set, tensors, path))
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

/// Frames that are predicted at a time.
const CHUNK: usize = 16;

/// What [`TrainedModel::walk`] calls with each frame: its index, the frame, its depth.
pub type Visit<'a> = dyn FnMut(usize, &Arc<Frame>, Map) -> Result<()> + 'a;

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
        let model = Model::of(&config);
        let mut weights = model.init(config.seed);
        let path = folder.checkpoint();
        restore_weights(&mut weights, &Checkpoint::read(&path)?.tensors, &path)?;
        Ok(Self { config, model, weights })
    }

    /// Depth of frames of one size, in the unit of the training run.
    pub fn depth(&self, frames: &[&Frame]) -> Vec<Map> {
        maps(&self.model.predict_depth(&self.weights, &images(frames)))
    }

    fn motions(&self, pairs: &Pairs<'_>) -> Vec<Se3> {
        self.model.predict_motions(&self.weights, pairs, self.config.nets.pose_test_iterations)
    }

    /// Goes through a sequence with a few frames in memory at a time, shows each frame with its index and its predicted depth,
    /// in the unit of the training run, and gives the motions `next_from_this` between neighbours: one fewer than frames.
    ///
    /// **Errors** when a frame cannot be read, and those of `visit`.
    pub fn walk(&self, dataset: &dyn Dataset, sequence: usize, visit: &mut Visit<'_>) -> Result<Vec<Se3>> {
        let len = dataset.sequence_len(sequence);
        let mut steps = Vec::with_capacity(len);
        for start in (0..len).step_by(CHUNK) {
            // One frame more than is shown: the motion into the next chunk.
            let count = (CHUNK + 1).min(len - start);
            let frames = par::map_indices(count, |k| dataset.frame(sequence, start + k));
            let frames = frames.into_iter().collect::<Result<Vec<_>, _>>()?;
            let views: Vec<&Frame> = frames.iter().map(Arc::as_ref).collect();
            let shown = CHUNK.min(count);
            let depth = self.model.predict_depth(&self.weights, &images(&views[..shown]));
            if count > 1 {
                let first = &views[..count - 1];
                let cameras: Vec<_> = first.iter().map(|frame| frame.intrinsics).collect();
                let pairs = Pairs {
                    target: &images(first),
                    source: &images(&views[1..]),
                    earlier: 0,
                    depth: Some(&first_samples(&depth, count - 1)),
                    cameras: &cameras,
                };
                steps.extend(self.motions(&pairs));
            }
            for (k, (frame, depth)) in frames.iter().zip(maps(&depth)).enumerate() {
                visit(start + k, frame, depth)?;
            }
        }
        Ok(steps)
    }
}

fn images(frames: &[&Frame]) -> Tensor<f32> {
    stack(frames.iter().map(|frame| &frame.image))
}

/// The samples of a tensor `[n, 1, h, w]`.
fn maps(depth: &Tensor<f32>) -> Vec<Map> {
    let (height, width) = (depth.shape().h(), depth.shape().w());
    depth.data().chunks(height * width).map(|plane| Map::from_vec(height, width, plane.to_vec())).collect()
}

#[cfg(test)]
mod tests {
    use dimode_autodiff::Shape;

    use super::*;
    use crate::config::NetsConfig;
    use crate::run::held_out_worlds;

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

    /// A sequence that takes two chunks, frame by frame and pair by pair.
    #[test]
    fn a_walk_sees_every_frame_and_moves_by_the_depth_of_the_first_of_two() {
        let mut config = Config::default();
        config.nets = NetsConfig { pose_test_iterations: 2, rotation_scale: 500.0, tangential_scale: 100.0, ..config.nets };
        (config.data.width, config.data.height) = (64, 64);
        (config.eval.worlds, config.eval.frames) = (1, CHUNK + 2);
        let model = Model::new(&config.nets);
        let weights = model.init(3);
        let dataset = held_out_worlds(&config).unwrap();
        let trained = TrainedModel { config, model, weights };
        let mut seen = Vec::new();
        let steps = trained.walk(&dataset, 0, &mut |index, frame, depth| {
            seen.push((index, frame.clone(), depth));
            Ok(())
        });
        let steps = steps.unwrap();
        assert_eq!((seen.len(), steps.len()), (CHUNK + 2, CHUNK + 1));
        for (k, (index, frame, depth)) in seen.iter().enumerate() {
            assert_eq!((*index, &frame.name), (k, &dataset.frame(0, k).unwrap().name));
            assert_eq!(depth, &trained.depth(&[frame])[0], "frame {k}");
        }
        for (k, (pair, step)) in seen.windows(2).zip(&steps).enumerate() {
            let with = |depth: &Map| {
                let depth = Tensor::from_vec(Shape::new(1, 1, 64, 64), depth.data.clone());
                let [target, source] = [0, 1].map(|i: usize| images(&[&*pair[i].1]));
                let cameras = [pair[0].1.intrinsics];
                let depth = Some(&depth);
                trained.motions(&Pairs { target: &target, source: &source, earlier: 0, depth, cameras: &cameras })[0]
            };
            let gap = |other: Se3| (step.rotation - other.rotation).norm() + (step.translation - other.translation).norm();
            assert!(gap(with(&pair[0].2)) < 1e-6, "step {k}");
            assert!(gap(with(&pair[1].2)) > 1e-5, "step {k}: the depth of the other image says the same");
        }
    }
}
