//! Random depth: a residual branch left out for whole samples in training.

use dimode_autodiff::ops::drop_path::keep_mask;
use dimode_autodiff::{Scalar, Var};

use crate::Binder;

/// Drops a branch for each sample with a probability, and divides what is kept by the probability of keeping it.
///
/// At rest unless the binder is [random](Binder::random) and in training. What is dropped depends on the seed and step of the
/// binder, on the path and on the place in the batch, so all passes of one step drop alike.
#[derive(Clone, Debug, PartialEq)]
pub struct DropPath {
    path: String,
    rate: f64,
}

impl DropPath {
    /// The layer with a path of its own and the probability to drop, from 0 to below 1.
    pub fn new(path: impl Into<String>, rate: f64) -> Self {
        Self { path: path.into(), rate }
    }

    /// (N, C, H, W) -> the same; gives up the value of `x` where it drops.
    ///
    /// # Panics
    /// When the rate is not from 0 to below 1.
    #[track_caller]
    pub fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        match binder.randomness(&self.path).filter(|_| self.rate > 0.0) {
            None => x,
            Some((seed, step)) => {
                let keep = keep_mask(x.shape().n(), self.rate, seed, step);
                x.last_use(|x| x.drop_path(&keep, self.rate))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Mode, ParamSet};
    use dimode_autodiff::{Shape, Tape, Tensor};

    const SAMPLES: usize = 2000;

    /// Ones through the layer.
    fn run(layer: &DropPath, mode: Mode, randomness: Option<(u64, u64)>) -> Vec<f64> {
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &ParamSet::new(), mode);
        if let Some((seed, step)) = randomness {
            binder = binder.random(seed, step);
        }
        let x = tape.constant(Tensor::full(Shape::new(SAMPLES, 1, 1, 1), 1.0));
        layer.forward(&binder, x).value().to_vec()
    }

    #[test]
    fn keeps_its_share_and_the_mean() {
        let values = run(&DropPath::new("net:a", 0.2), Mode::Train, Some((7, 3)));
        let dropped = values.iter().filter(|&&v| v == 0.0).count();
        assert!((340..460).contains(&dropped), "{dropped} of {SAMPLES}");
        assert!(values.iter().all(|&v| v == 0.0 || v == 1.25));
    }

    #[test]
    fn seed_step_and_path_decide_alone() {
        let of = |path: &str, seed, step| run(&DropPath::new(path, 0.5), Mode::Train, Some((seed, step)));
        let base = of("net:a", 1, 1);
        assert_eq!(base, of("net:a", 1, 1));
        for other in [of("net:b", 1, 1), of("net:a", 2, 1), of("net:a", 1, 2)] {
            assert_ne!(base, other);
        }
    }

    #[test]
    fn rests_in_evaluation_without_a_seed_and_at_rate_zero() {
        let layer = DropPath::new("net:a", 0.5);
        let kept = vec![1.0; SAMPLES];
        assert_eq!(run(&layer, Mode::Eval, Some((1, 1))), kept);
        assert_eq!(run(&layer, Mode::Train, None), kept);
        assert_eq!(run(&DropPath::new("net:a", 0.0), Mode::Train, Some((1, 1))), kept);
    }
}
