//! Batch normalisation with running statistics.

use dimode_autodiff::{Activation, Scalar, Tensor, Var};

use crate::{Binder, Blueprint, Init, Mode, StatisticsUpdate};

/// Added to the variance before the square root.
const EPSILON: f64 = 1e-5;

/// Statistics that a batch normalisation takes in [`Mode::Train`]; in [`Mode::Eval`] it takes the running ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrainingStatistics {
    /// Those of the batch, which also move the running ones.
    #[default]
    Batch,
    /// The running ones, which stay as they are: a frozen layer, whose scale and offset still learn.
    Running,
}

/// Batch normalisation over N, H and W: `path.weight`, `.bias`, `.running_mean`, `.running_var`,
/// all of dimension (channels).
///
/// In [`Mode::Train`] the biased variance of the batch normalises and the unbiased one is handed
/// to the binder for the running value; in [`Mode::Eval`], and always with [`TrainingStatistics::Running`], the running values
/// are used.
#[derive(Clone, Debug, PartialEq)]
pub struct BatchNorm {
    path: String,
    channels: usize,
    statistics: TrainingStatistics,
}

impl BatchNorm {
    /// The layer stored at `path`.
    pub fn new(path: impl Into<String>, channels: usize) -> Self {
        Self { path: path.into(), channels, statistics: TrainingStatistics::Batch }
    }

    /// With the given statistics in training.
    #[must_use]
    pub fn statistics(mut self, statistics: TrainingStatistics) -> Self {
        self.statistics = statistics;
        self
    }

    fn part(&self, part: &str) -> String {
        format!("{}.{part}", self.path)
    }

    /// Adds scale, offset and running statistics to the list.
    pub fn declare(&self, blueprint: &mut Blueprint) {
        let dims = [self.channels];
        blueprint.parameter(self.part("weight"), &dims, Init::Constant(1.0));
        blueprint.parameter(self.part("bias"), &dims, Init::Constant(0.0));
        blueprint.buffer(self.part("running_mean"), &dims, Init::Constant(0.0));
        blueprint.buffer(self.part("running_var"), &dims, Init::Constant(1.0));
    }

    /// (N, C, H, W) -> the same.
    pub fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        self.activated(binder, x, None, Activation::Identity)
    }

    /// The same, then `skip` is added and the activation taken, in one operation.
    pub fn activated<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        x: Var<'t, T>,
        skip: Option<Var<'t, T>>,
        activation: Activation,
    ) -> Var<'t, T> {
        let gamma = binder.param(&self.part("weight"));
        let beta = binder.param(&self.part("bias"));
        match (binder.mode(), self.statistics) {
            (Mode::Eval, _) | (_, TrainingStatistics::Running) => {
                let statistics = ["running_mean", "running_var"].map(|part| binder.buffer(&self.part(part)));
                x.batch_norm_eval_activated(gamma, beta, statistics, EPSILON, skip, activation)
            }
            (Mode::Train, TrainingStatistics::Batch) => {
                let out = x.batch_norm_train_activated(gamma, beta, EPSILON, skip, activation);
                let count = x.shape().n() * x.shape().plane();
                binder.record_statistics(StatisticsUpdate {
                    layer: self.path.clone(),
                    mean: out.mean,
                    variance: unbiased(&out.var, count),
                });
                out.y
            }
        }
    }
}

/// Bessel's correction; a single value keeps its variance of zero.
fn unbiased<T: Scalar>(biased: &Tensor<T>, count: usize) -> Tensor<T> {
    let factor = T::from_f64(count as f64 / count.saturating_sub(1).max(1) as f64);
    let values = biased.data().iter().map(|&v| v * factor).collect();
    Tensor::from_vec(biased.shape(), values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape};

    #[test]
    fn running_statistics_use_the_unbiased_variance() {
        let layer = BatchNorm::new("net:bn", 1);
        let mut blueprint = Blueprint::new();
        layer.declare(&mut blueprint);
        let mut params = blueprint.init::<f64>(0);
        let tape = Tape::new();
        let mut binder = Binder::new(&tape, &params, Mode::Train);
        let x = tape.constant(Tensor::from_vec(Shape::new(2, 1, 1, 2), vec![1.0, 2.0, 3.0, 6.0]));
        let y = layer.forward(&mut binder, x).value();
        // Mean 3, biased variance 3.5, unbiased 14/3.
        assert!((y.data()[0] + 2.0 / (3.5f64 + 1e-5).sqrt()).abs() < 1e-12);
        params.apply_statistics(&binder.into_statistics());
        let of = |path: &str| params.get(path).unwrap().tensor().item();
        assert!((of("net:bn.running_mean") - 0.3).abs() < 1e-12);
        assert!((of("net:bn.running_var") - (0.9 + 0.1 * 14.0 / 3.0)).abs() < 1e-12);
    }

    #[test]
    fn running_statistics_normalise_and_stay_in_evaluation_and_where_they_are_frozen() {
        let layer = BatchNorm::new("net:bn", 1);
        let mut blueprint = Blueprint::new();
        layer.declare(&mut blueprint);
        let params = blueprint.init::<f64>(0);
        let frozen = layer.clone().statistics(TrainingStatistics::Running);
        for (layer, mode) in [(&layer, Mode::Eval), (&frozen, Mode::Eval), (&frozen, Mode::Train)] {
            let tape = Tape::new();
            let mut binder = Binder::new(&tape, &params, mode);
            let x = tape.constant(Tensor::full(Shape::new(1, 1, 1, 2), 2.0));
            let y = layer.forward(&mut binder, x).value();
            assert!((y.data()[0] - 2.0 / (1.0f64 + 1e-5).sqrt()).abs() < 1e-12);
            assert!(binder.statistics().is_empty());
        }
    }
}
