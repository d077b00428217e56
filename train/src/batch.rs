//! Snippets as tensors: plain images for the losses, augmented ones for the networks.

use std::sync::Arc;

use dimode_autodiff::{Pool, Shape, Tensor, par};
use dimode_geometry::Intrinsics;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::config::TrainConfig;
use crate::data::{Augmentation, DataError, Dataset, Map, Snippet, snippet};
use crate::teacher::Teacher;

/// Three images each, `[n, 3, h, w]`, colours in [0, 1].
#[derive(Clone, Debug)]
pub struct Images {
    /// Middle frames.
    pub target: Tensor<f32>,
    /// Frames before.
    pub previous: Tensor<f32>,
    /// Frames after.
    pub next: Tensor<f32>,
}

/// The data of one step.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Name of each sample, for messages.
    pub names: Vec<String>,
    /// Sequence and target frame of each sample.
    pub snippets: Vec<(usize, usize)>,
    /// Whether left and right of each sample are exchanged.
    pub flipped: Vec<bool>,
    /// Images without colour jitter: what the losses compare.
    pub plain: Images,
    /// Images as the depth and pose networks see them.
    pub seen: Images,
    /// Camera of each sample.
    pub intrinsics: Vec<Intrinsics>,
    /// Pseudo-depth of the targets, `[n, 1, h, w]`, where a [`Teacher`] says one.
    pub pseudo_depth: Option<Tensor<f32>>,
}

impl Batch {
    /// Loads and augments the snippets `(sequence, target frame)` of a step into buffers of a pool. Sample `i` of step `s` draws
    /// from stream `s * n + i` of the seed.
    ///
    /// # Errors
    /// When a frame or its pseudo-depth cannot be read.
    ///
    /// # Panics
    /// When there is no snippet or images differ in size.
    pub fn load(
        dataset: &dyn Dataset,
        items: &[(usize, usize)],
        (config, teacher): (&TrainConfig, &Teacher),
        seed: u64,
        step: u64,
        pool: &Arc<Pool<f32>>,
    ) -> Result<Batch, DataError> {
        let samples = par::map_indices(items.len(), |i| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6175_676d);
            rng.set_stream(step * items.len() as u64 + i as u64);
            sample(dataset, items[i], (config, teacher), &mut rng)
        });
        let samples = samples.into_iter().collect::<Result<Vec<_>, _>>()?;
        let first = &samples.first().expect("a batch has at least one snippet").snippet.target.image;
        let shape = Shape::new(items.len(), first.channels, first.height, first.width);
        let mut buffers = [(); 6].map(|()| pool.take(shape.len()));
        let mut places: Vec<Vec<&mut [f32]>> = items.iter().map(|_| Vec::with_capacity(6)).collect();
        for buffer in &mut buffers {
            for (place, images) in places.iter_mut().zip(buffer.chunks_exact_mut(shape.len() / items.len())) {
                place.push(images);
            }
        }
        par::for_each_item(places, |i, mut place| {
            let Sample { snippet, change, .. } = &samples[i];
            let frames = [&snippet.target, &snippet.sources[0], &snippet.sources[1]];
            let (plain, seen) = place.split_at_mut(3);
            for ((frame, plain), seen) in frames.into_iter().zip(plain).zip(seen) {
                change.write_geometry(&frame.image, plain);
                change.write_colours(plain, seen);
            }
        });
        let [target, previous, next, seen_target, seen_previous, seen_next] =
            buffers.map(|buffer| Tensor::pooled(shape, buffer, pool));
        let camera = |s: &Sample| {
            let camera = s.snippet.target.intrinsics;
            if s.change.flip { camera.flipped_horizontal() } else { camera }
        };
        Ok(Batch {
            names: samples.iter().map(|s| s.snippet.name.clone()).collect(),
            snippets: items.to_vec(),
            flipped: samples.iter().map(|s| s.change.flip).collect(),
            plain: Images { target, previous, next },
            seen: Images { target: seen_target, previous: seen_previous, next: seen_next },
            intrinsics: samples.iter().map(camera).collect(),
            pseudo_depth: pseudo_depth(&samples, pool),
        })
    }
}

/// A snippet as it was taken, and what is to happen to it.
struct Sample {
    snippet: Snippet,
    change: Augmentation,
    pseudo_depth: Option<Map>,
}

fn sample(
    dataset: &dyn Dataset,
    (sequence, frame): (usize, usize),
    (config, teacher): (&TrainConfig, &Teacher),
    rng: &mut ChaCha8Rng,
) -> Result<Sample, DataError> {
    // Drawn whether used or not, so that one option does not change the random numbers of another.
    let drawn = Augmentation::draw(rng);
    let change = Augmentation { flip: drawn.flip && config.flip, jitter: drawn.jitter.filter(|_| config.jitter) };
    let snippet = snippet(dataset, sequence, frame)?;
    let pseudo_depth = teacher.map(dataset, (sequence, frame), &snippet.target)?;
    let pseudo_depth = pseudo_depth.map(|map| if change.flip { map.flip_horizontal() } else { map });
    Ok(Sample { snippet, change, pseudo_depth })
}

/// The maps of all samples, when they have one.
fn pseudo_depth(samples: &[Sample], pool: &Arc<Pool<f32>>) -> Option<Tensor<f32>> {
    let maps: Option<Vec<&Map>> = samples.iter().map(|s| s.pseudo_depth.as_ref()).collect();
    let maps = maps.filter(|maps| !maps.is_empty())?;
    let shape = Shape::new(maps.len(), 1, maps[0].height, maps[0].width);
    let mut joined = pool.take(shape.len());
    for (place, map) in joined.chunks_exact_mut(shape.plane()).zip(maps) {
        place.copy_from_slice(&map.data);
    }
    Some(Tensor::pooled(shape, joined, pool))
}

/// Tensors joined along the samples, in a buffer of the first one's pool.
///
/// # Panics
/// When there is none or shapes differ beyond the first axis.
pub fn join(parts: &[&Tensor<f32>]) -> Tensor<f32> {
    parts[0].beside(joined_shape(parts), |joined| fill(joined, parts))
}

/// The same in a buffer of a given pool.
///
/// # Panics
/// As [`join`].
pub fn join_in(pool: &Arc<Pool<f32>>, parts: &[&Tensor<f32>]) -> Tensor<f32> {
    let shape = joined_shape(parts);
    let mut joined = pool.take(shape.len());
    fill(&mut joined, parts);
    Tensor::pooled(shape, joined, pool)
}

fn joined_shape(parts: &[&Tensor<f32>]) -> Shape {
    let mut shape = parts[0].shape();
    assert!(parts.iter().all(|p| p.shape().0[1..] == shape.0[1..]), "join: shapes differ beyond the first axis");
    shape.0[0] = parts.iter().map(|p| p.shape().n()).sum();
    shape
}

fn fill(joined: &mut [f32], parts: &[&Tensor<f32>]) {
    let mut rest = joined;
    for part in parts {
        let (place, behind) = rest.split_at_mut(part.shape().len());
        place.copy_from_slice(part.data());
        rest = behind;
    }
}

/// The first `count` samples.
pub fn first_samples(of: &Tensor<f32>, count: usize) -> Tensor<f32> {
    let mut shape = of.shape();
    shape.0[0] = count;
    Tensor::from_vec(shape, of.data()[..shape.len()].to_vec())
}
