//! Which snippets make up the batch of a step: a function of the seed and the step alone, so a resumed run sees the same data.

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Snippets of a dataset in random order, shuffled anew for each pass over the data.
#[derive(Clone, Debug)]
pub struct Sampler {
    lengths: Vec<usize>,
    seed: u64,
    batch: usize,
    cached: Option<(u64, Vec<(usize, usize)>)>,
}

impl Sampler {
    /// A sampler over sequences of the given lengths in frames.
    ///
    /// # Panics
    /// When no sequence has three frames, or `batch` is 0.
    pub fn new(lengths: Vec<usize>, seed: u64, batch: usize) -> Self {
        assert!(lengths.iter().any(|&l| l >= 3), "sampler: no sequence has three frames");
        assert!(batch > 0, "sampler: an empty batch");
        Sampler { lengths, seed, batch, cached: None }
    }

    /// Snippets in one pass over the data.
    pub fn snippets(&self) -> usize {
        self.lengths.iter().map(|l| l.saturating_sub(2)).sum()
    }

    /// The snippets `(sequence, target frame)` of a step.
    pub fn batch(&mut self, step: usize) -> Vec<(usize, usize)> {
        let per_pass = self.snippets();
        (step * self.batch..(step + 1) * self.batch)
            .map(|i| {
                let (pass, at) = ((i / per_pass) as u64, i % per_pass);
                self.order(pass)[at]
            })
            .collect()
    }

    /// Number of the pass over the data that a step's first sample belongs to.
    pub fn pass(&self, step: usize) -> usize {
        step * self.batch / self.snippets()
    }

    fn order(&mut self, pass: u64) -> &[(usize, usize)] {
        if self.cached.as_ref().is_none_or(|c| c.0 != pass) {
            let order = self.shuffled(pass);
            self.cached = Some((pass, order));
        }
        &self.cached.as_ref().expect("just filled").1
    }

    fn shuffled(&self, pass: u64) -> Vec<(usize, usize)> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(pass);
        let targets = |s: usize| 1..self.lengths[s].max(2) - 1;
        let mut order: Vec<_> = (0..self.lengths.len()).flat_map(|s| targets(s).map(move |f| (s, f))).collect();
        order.shuffle(&mut rng);
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pass_visits_every_snippet_once() {
        let mut sampler = Sampler::new(vec![5, 3, 2, 8], 1, 5);
        assert_eq!(sampler.snippets(), 3 + 1 + 6);
        let mut seen: Vec<_> = (0..2).flat_map(|step| sampler.batch(step)).collect();
        seen.sort();
        let want: Vec<_> = [(0, 3), (1, 1), (3, 6)].iter().flat_map(|&(s, n)| (1..=n).map(move |f| (s, f))).collect();
        assert_eq!(seen, want);
    }

    #[test]
    fn a_batch_depends_on_seed_and_step_only() {
        let new = |seed| Sampler::new(vec![10; 20], seed, 6);
        let mut walked = new(3);
        (0..50).for_each(|s| drop(walked.batch(s)));
        assert_eq!(walked.batch(7), new(3).batch(7));
        assert_ne!(new(3).batch(7), new(4).batch(7));
    }
}
