//! Optical flow as the flow network sees it between the frames of a snippet, kept while the network is frozen.
//!
//! The flow of a snippet depends on its frames and the flow network alone: it is found on the frames as they were taken, one
//! snippet at a time, and mirrored afterwards where the batch is mirrored. What is kept from an earlier visit is therefore what
//! would be found again, bit by bit.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use dimode_autodiff::{Pool, Shape, Tape, Tensor, par};
use dimode_nets::{Binder, FlowOptions, ParamSet};

use crate::batch::{Batch, Images, join, join_in};
use crate::mirror::{mirror_flow, mirrored};
use crate::model::Model;

/// Bytes of flow that are kept.
const BYTES: usize = 512 << 20;

/// Flow by snippet (sequence, target frame): towards the previous and the next frame, `[2, 2, h, w]`, pixels; where both ways are
/// known also from them, `[4, 2, h, w]`.
type Kept = BTreeMap<(usize, usize), Arc<Tensor<f32>>>;

/// Optical flow between the targets of a batch and both sources, `[2 n, 2, h, w]`, pixels, previous sources first.
#[derive(Clone, Debug, PartialEq)]
pub struct BatchFlow {
    /// From target to source.
    pub forward: Tensor<f32>,
    /// From source to target, where it was asked for.
    pub backward: Option<Tensor<f32>>,
}

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

    /// Flow of a batch, without gradient; with `both_ways` also the flow back.
    pub fn of(
        &self,
        (model, weights): (&Model, &ParamSet<f32>),
        batch: &Batch,
        both_ways: bool,
        pool: &Arc<Pool<f32>>,
    ) -> BatchFlow {
        let maps = if both_ways { 4 } else { 2 };
        let flows = par::map_indices(batch.snippets.len(), |i| {
            let key = batch.snippets[i];
            if let Some(known) = self.lock().get(&key).filter(|known| known.shape().n() >= maps) {
                return Arc::clone(known);
            }
            let found = Arc::new(snippet_flow((model, weights), batch, i, both_ways, pool));
            let mut kept = self.lock();
            if (kept.len() + 1) * found.shape().len() * size_of::<f32>() <= BYTES {
                kept.insert(key, Arc::clone(&found));
            }
            found
        });
        let towards = |first| in_batch_order(batch, &flows, first);
        BatchFlow { forward: towards(0), backward: both_ways.then(|| towards(2)) }
    }
}

/// Flow of one snippet as it was taken, `[2, 2, h, w]`, or `[4, 2, h, w]` both ways.
fn snippet_flow(
    (model, weights): (&Model, &ParamSet<f32>),
    batch: &Batch,
    i: usize,
    both_ways: bool,
    pool: &Arc<Pool<f32>>,
) -> Tensor<f32> {
    let Images { target, previous, next } = &batch.plain;
    let [target, previous, next] = [target, previous, next].map(|images| {
        let shape = Shape::new(1, 3, images.shape().h(), images.shape().w());
        let mut image = pool.take(shape.len());
        image.copy_from_slice(&images.data()[i * shape.len()..][..shape.len()]);
        let image = Tensor::pooled(shape, image, pool);
        if batch.flipped[i] { mirrored(&image) } else { image }
    });
    let (targets, sources) = (join_in(pool, &[&target, &target]), join_in(pool, &[&previous, &next]));
    let flow = |first: &Tensor<f32>, second: &Tensor<f32>| {
        let tape = Tape::with_pool(pool.clone());
        let mut net = Binder::frozen(&tape, weights);
        let options = FlowOptions { iterations: Some(model.flow_iterations), last_only: true, ..FlowOptions::default() };
        let [first, second] = [first, second].map(|images| tape.constant(images.clone()));
        model.flow.trace(&mut net, first, second, &options).flows[0].value()
    };
    let there = flow(&targets, &sources);
    if both_ways { join(&[&there, &flow(&sources, &targets)]) } else { there }
}

/// Maps `first` and `first + 1` of every snippet as those of the batch: mirrored where it is, those of the previous frames first.
fn in_batch_order(batch: &Batch, flows: &[Arc<Tensor<f32>>], first: usize) -> Tensor<f32> {
    let map = flows[0].shape();
    let (size, shape) = (map.len() / map.n(), Shape::new(2 * flows.len(), map.c(), map.h(), map.w()));
    flows[0].beside(shape, |out| {
        let maps = [first, first + 1].into_iter().flat_map(|k| (0..flows.len()).map(move |i| (i, k)));
        for ((i, k), place) in maps.zip(out.chunks_exact_mut(size)) {
            place.copy_from_slice(&flows[i].data()[k * size..][..size]);
            if batch.flipped[i] {
                mirror_flow(place, map.w());
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::mirror::mirrored_flow;
    use crate::run::training_frames;
    use crate::teacher::Teacher;

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
            let batch =
                Batch::load(frames.as_ref(), &[(0, 1), (1, 2), (0, 3)], (&config.train, &Teacher::None), 3, step, &Pool::new())
                    .unwrap();
            // Some snippets are met one way first, and all are met again.
            let both_ways = step % 3 == 1;
            let found = ObservedFlow::default().of((&model, &weights), &batch, both_ways, &pool);
            assert_eq!(kept.of((&model, &weights), &batch, both_ways, &pool), found, "step {step}");
            assert_eq!(found.backward.is_some(), both_ways);
            let fresh = found.forward;
            let shape = fresh.shape();
            assert_eq!((shape.n(), shape.c()), (6, 2));
            // Towards the next frame of the second snippet, on the frames as they were taken.
            let own = snippet_flow((&model, &weights), &batch, 1, false, &pool);
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
