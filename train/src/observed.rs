//! Optical flow as the flow network sees it between the frames of a snippet, kept while the network is frozen.
//!
//! The flow of a snippet depends on its frames and the flow network alone: it is found on the frames as they were taken, one
//! snippet at a time, and mirrored afterwards where the batch is mirrored. What is kept from an earlier visit is therefore what
//! would be found again, bit by bit.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use dimode_autodiff::{Pool, Shape, Tape, Tensor, par};
use dimode_nets::{Binder, FlowOptions, ParamSet};

use crate::batch::{Batch, Images};
use crate::mirror::{mirrored, mirrored_flow};
use crate::model::Model;

/// Bytes of flow that are kept.
const BYTES: usize = 512 << 20;

/// Flow by snippet (sequence, target frame): towards the previous and the next frame, `[2, 2, h, w]`, pixels.
type Kept = BTreeMap<(usize, usize), Arc<Tensor<f32>>>;

/// What was found so far.
#[derive(Default)]
pub struct ObservedFlow {
    kept: Mutex<Kept>,
}

impl ObservedFlow {
    /// Forgets everything: the network has changed.
    pub fn clear(&self) {
        self.lock().clear();
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        // A look-up or an insertion is whole or has not begun, so a panic elsewhere does not spoil the map.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Flow from the targets of a batch to both sources, `[2 n, 2, h, w]`, previous first; no gradient.
    pub fn of(&self, model: &Model, weights: &ParamSet<f32>, batch: &Batch, pool: &Arc<Pool<f32>>) -> Tensor<f32> {
        let flows = par::map_indices(batch.snippets.len(), |i| {
            let key = batch.snippets[i];
            if let Some(known) = self.lock().get(&key) {
                return Arc::clone(known);
            }
            let found = Arc::new(snippet_flow(model, weights, batch, i, pool));
            let mut kept = self.lock();
            if (kept.len() + 1) * found.shape().len() * size_of::<f32>() <= BYTES {
                kept.insert(key, Arc::clone(&found));
            }
            found
        });
        in_batch_order(batch, &flows)
    }
}

/// Flow of one snippet as it was taken, `[2, 2, h, w]`.
fn snippet_flow(model: &Model, weights: &ParamSet<f32>, batch: &Batch, i: usize, pool: &Arc<Pool<f32>>) -> Tensor<f32> {
    let Images { target, previous, next } = &batch.plain;
    let [target, previous, next] = [target, previous, next].map(|images| {
        let shape = Shape::new(1, 3, images.shape().h(), images.shape().w());
        let image = Tensor::from_vec(shape, images.data()[i * shape.len()..][..shape.len()].to_vec());
        if batch.flipped[i] { mirrored(&image) } else { image }
    });
    let tape = Tape::with_pool(pool.clone());
    let net = Binder::frozen(&tape, weights);
    let first = tape.constant(crate::batch::join(&[&target, &target]));
    let second = tape.constant(crate::batch::join(&[&previous, &next]));
    let options = FlowOptions { iterations: Some(model.flow_iterations), last_only: true, ..FlowOptions::default() };
    model.flow.trace(&net, first, second, &options).flows[0].value()
}

/// Flows of snippets as those of the batch: mirrored where it is, towards the previous frames first.
fn in_batch_order(batch: &Batch, flows: &[Arc<Tensor<f32>>]) -> Tensor<f32> {
    let flows: Vec<_> = flows
        .iter()
        .zip(&batch.flipped)
        .map(|(flow, &flipped)| if flipped { mirrored_flow(flow) } else { flow.as_ref().clone() })
        .collect();
    let one = flows[0].shape().len() / 2;
    let mut shape = flows[0].shape();
    shape.0[0] = 2 * flows.len();
    let towards = |k: usize| flows.iter().flat_map(move |f| f.data()[k * one..][..one].iter().copied());
    Tensor::from_vec(shape, towards(0).chain(towards(1)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::run::training_frames;

    #[test]
    fn what_is_kept_is_what_is_found() {
        let mut config = Config::default();
        (config.data.width, config.data.height, config.data.worlds) = (64, 64, 2);
        let frames = training_frames(&config).unwrap();
        let model = Model::new(&config.nets);
        let weights = model.init(5).flow;
        let kept = ObservedFlow::default();
        let pool = Pool::new();
        let mut flips = [false; 2];
        for step in 0..12 {
            let batch = Batch::load(frames.as_ref(), &[(0, 1), (1, 2), (0, 3)], &config.train, 3, step).unwrap();
            let fresh = ObservedFlow::default().of(&model, &weights, &batch, &pool);
            assert_eq!(kept.of(&model, &weights, &batch, &pool).data(), fresh.data(), "step {step}");
            let shape = fresh.shape();
            assert_eq!((shape.n(), shape.c()), (6, 2));
            // Towards the next frame of the second snippet, on the frames as they were taken.
            let own = snippet_flow(&model, &weights, &batch, 1, &pool);
            let seen = Tensor::from_vec(
                Shape::new(1, 2, shape.h(), shape.w()),
                fresh.data()[4 * shape.len() / 6..5 * shape.len() / 6].to_vec(),
            );
            let taken = if batch.flipped[1] { mirrored_flow(&seen) } else { seen };
            assert_eq!(taken.data(), &own.data()[own.shape().len() / 2..]);
            flips[usize::from(batch.flipped[1])] = true;
        }
        assert_eq!(flips, [true; 2], "both kinds were seen");
        assert_eq!(kept.lock().len(), 3);
        kept.clear();
        assert!(kept.lock().is_empty());
    }
}
