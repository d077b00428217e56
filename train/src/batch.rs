//! Snippets as tensors: plain images for the losses, augmented ones for the networks.

use dimode_autodiff::{Shape, Tensor, par};
use dimode_geometry::Intrinsics;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::config::TrainConfig;
use crate::data::{Augmentation, DataError, Dataset, Image, Map, snippet};
use crate::model::stack;
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
    /// Loads and augments the snippets `(sequence, target frame)` of a step. Sample `i` of step `s` draws from stream
    /// `s * n + i` of the seed.
    ///
    /// # Errors
    /// When a frame or its pseudo-depth cannot be read.
    pub fn load(
        dataset: &dyn Dataset,
        items: &[(usize, usize)],
        (config, teacher): (&TrainConfig, &Teacher),
        seed: u64,
        step: u64,
    ) -> Result<Batch, DataError> {
        let samples = par::map_indices(items.len(), |i| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6175_676d);
            rng.set_stream(step * items.len() as u64 + i as u64);
            sample(dataset, items[i], (config, teacher), &mut rng)
        });
        let samples = samples.into_iter().collect::<Result<Vec<_>, _>>()?;
        let images = |pick: fn(&Sample) -> &[Image; 3]| Images {
            previous: stack(samples.iter().map(|s| &pick(s)[0])),
            target: stack(samples.iter().map(|s| &pick(s)[1])),
            next: stack(samples.iter().map(|s| &pick(s)[2])),
        };
        Ok(Batch {
            names: samples.iter().map(|s| s.name.clone()).collect(),
            snippets: items.to_vec(),
            flipped: samples.iter().map(|s| s.flipped).collect(),
            plain: images(|s| &s.plain),
            seen: images(|s| &s.seen),
            intrinsics: samples.iter().map(|s| s.intrinsics).collect(),
            pseudo_depth: pseudo_depth(&samples),
        })
    }
}

struct Sample {
    name: String,
    flipped: bool,
    plain: [Image; 3],
    seen: [Image; 3],
    intrinsics: Intrinsics,
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
    let found = snippet(dataset, sequence, frame)?;
    let pseudo_depth = teacher.map(dataset, (sequence, frame), &found.target)?;
    let pseudo_depth = pseudo_depth.map(|map| if change.flip { map.flip_horizontal() } else { map });
    let taken = change.geometry(&found);
    let plain = [&taken.sources[0], &taken.target, &taken.sources[1]].map(|f| f.image.clone());
    let seen = plain.each_ref().map(|image| change.colours(image));
    Ok(Sample { name: taken.name, flipped: change.flip, plain, seen, intrinsics: taken.target.intrinsics, pseudo_depth })
}

/// The maps of all samples, when they have one.
fn pseudo_depth(samples: &[Sample]) -> Option<Tensor<f32>> {
    let maps: Option<Vec<&Map>> = samples.iter().map(|s| s.pseudo_depth.as_ref()).collect();
    let maps = maps.filter(|maps| !maps.is_empty())?;
    let shape = Shape::new(maps.len(), 1, maps[0].height, maps[0].width);
    Some(Tensor::from_vec(shape, maps.iter().flat_map(|map| map.data.iter().copied()).collect()))
}

/// Tensors joined along the samples.
///
/// # Panics
/// When there is none or shapes differ beyond the first axis.
pub fn join(parts: &[&Tensor<f32>]) -> Tensor<f32> {
    let mut shape = parts[0].shape();
    shape.0[0] = parts.iter().map(|p| p.shape().n()).sum();
    Tensor::from_vec(shape, parts.iter().flat_map(|p| p.data().iter().copied()).collect())
}

/// The first `count` samples.
pub fn first_samples(of: &Tensor<f32>, count: usize) -> Tensor<f32> {
    let mut shape = of.shape();
    shape.0[0] = count;
    Tensor::from_vec(shape, of.data()[..shape.len()].to_vec())
}
