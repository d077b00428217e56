//! Batch normalisation over samples and pixels of each channel, with the batch's statistics or with given ones.
//!
//! y = gamma (x - m) / sqrt(v + eps) + beta.
//! Training: m and v are the mean and biased variance over (N, H, W) of the channel. vjp, with h = (x - m)/sqrt(v + eps):
//! ggamma = sum g h, gbeta = sum g, gx = gamma/sqrt(v + eps) (g - mean g - h mean(g h)).
//! Evaluation: m and v are constants; the same ggamma and gbeta, gx = gamma/sqrt(v + eps) g.
//! Kinks: none.  Keeps: the input and two numbers per channel.

use super::instance_norm::{denormalise, moments, normalise};
use super::planes::sum_and_moment;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{GradSink, Scalar, Shape, Tensor, Var, par};

/// What [`Var::batch_norm_train`] returns: the output and the statistics of the batch for the running averages.
#[derive(Clone, Debug)]
pub struct BatchNormOutput<'t, T: Scalar> {
    /// The normalised activations, of the input's shape.
    pub y: Var<'t, T>,
    /// Mean of each channel, (1, C, 1, 1).
    pub mean: Tensor<T>,
    /// Biased variance of each channel, (1, C, 1, 1); times n/(n - 1), n = N H W, for the usual running variance.
    pub var: Tensor<T>,
}

/// Centre and 1/sqrt(v + eps) of each channel.
type Statistics<T> = Vec<(T, T)>;

/// The planes of channel `c`, one for each sample.
fn channel<T: Scalar>(x: &[T], shape: Shape, c: usize) -> impl Iterator<Item = &[T]> + Clone {
    let (stride, plane) = (shape.c() * shape.plane(), shape.plane());
    (0..shape.n()).map(move |n| &x[n * stride + c * plane..][..plane])
}

/// The planes of `out` by channel: one task reads and writes a channel while it is in the cache.
fn by_channel<T: Scalar>(out: &mut [T], shape: Shape) -> Vec<Vec<&mut [T]>> {
    let mut groups: Vec<Vec<&mut [T]>> = (0..shape.c()).map(|_| Vec::with_capacity(shape.n())).collect();
    for (i, plane) in out.chunks_exact_mut(shape.plane().max(1)).enumerate() {
        groups[i % shape.c()].push(plane);
    }
    groups
}

/// Normalises every channel with the statistics that `measure` returns for it, mean and variance.
fn forward<'t, T: Scalar>(
    [x, gamma, beta]: [Var<'t, T>; 3],
    eps: f64,
    measure: impl Fn(usize) -> (f64, f64) + Sync + Send,
) -> (Tensor<T>, Vec<(f64, f64)>, Statistics<T>) {
    let (shape, value, gamma, beta) = (x.shape(), x.value(), gamma.value(), beta.value());
    let scaled = |(mean, variance): (f64, f64)| (T::from_f64(mean), T::from_f64(1.0 / (variance + eps).sqrt()));
    let mut measured = vec![(0.0, 0.0); shape.c()];
    let mut y = x.tape().scratch(shape.len());
    let channels = by_channel(&mut y, shape).into_iter().zip(&mut measured).collect();
    par::for_each_item(channels, |c, (planes, measured)| {
        *measured = measure(c);
        let (mean, inverse) = scaled(*measured);
        let scale = inverse * gamma.data()[c];
        for (out, x) in planes.into_iter().zip(channel(value.data(), shape, c)) {
            normalise(x, out, mean, scale, beta.data()[c]);
        }
    });
    let statistics = measured.iter().copied().map(scaled).collect();
    (x.tape().tensor(shape, y), measured, statistics)
}

/// What the backward pass needs; with `batch` the statistics depend on the input.
struct Saved<T: Scalar> {
    x: Tensor<T>,
    gamma: Tensor<T>,
    statistics: Statistics<T>,
    batch: bool,
}

impl<T: Scalar> Saved<T> {
    /// Sums of g and of g h over channel `c`.
    fn sums(&self, g: &[T], c: usize) -> (f64, f64) {
        let shape = self.x.shape();
        let (mean, inverse) = self.statistics[c];
        let (mut total, mut moment) = (0.0, 0.0);
        for (g, x) in channel(g, shape, c).zip(channel(self.x.data(), shape, c)) {
            let (t, m) = sum_and_moment(g, x, mean);
            total += t;
            moment += m;
        }
        (total, moment * inverse.to_f64())
    }

    /// Writes the gradient of channel `c` of the input, given the channel's sums.
    fn input_gradient(&self, g: &[T], c: usize, (total, moment): (f64, f64), planes: Vec<&mut [T]>) {
        let shape = self.x.shape();
        let count = (shape.n() * shape.plane()) as f64;
        let (mean, inverse) = self.statistics[c];
        let (total, moment) = if self.batch { (total, moment) } else { (0.0, 0.0) };
        let slope = T::from_f64(moment / count * inverse.to_f64());
        let terms = [T::from_f64(total / count), slope, inverse * self.gamma.data()[c]];
        let operands = channel(g, shape, c).zip(channel(self.x.data(), shape, c));
        for (out, (g, x)) in planes.into_iter().zip(operands) {
            denormalise(g, x, out, mean, terms);
        }
    }

    fn backward(&self, g: &Tensor<T>, grads: &mut GradSink<'_, T>) {
        let (shape, g) = (self.x.shape(), g.data());
        let wants_sums = self.batch || grads.needs(1) || grads.needs(2);
        let measure = |c| {
            if wants_sums { self.sums(g, c) } else { (0.0, 0.0) }
        };
        let sums = match grads.slot(0) {
            None => par::map_indices(shape.c(), measure),
            Some(mut slot) => {
                let mut sums = vec![(0.0, 0.0); shape.c()];
                slot.write(|gx| {
                    let channels = by_channel(gx, shape).into_iter().zip(&mut sums).collect();
                    par::for_each_item(channels, |c, (planes, sums)| {
                        *sums = measure(c);
                        self.input_gradient(g, c, *sums, planes);
                    });
                });
                sums
            }
        };
        if let Some(mut slot) = grads.slot(1) {
            slot.accumulate(|c| T::from_f64(sums[c].1));
        }
        if let Some(mut slot) = grads.slot(2) {
            slot.accumulate(|c| T::from_f64(sums[c].0));
        }
    }
}

#[track_caller]
fn assert_vector(op: &str, name: &str, got: Shape, input: Shape) {
    let expected = Shape::new(1, input.c(), 1, 1);
    assert!(got == expected, "{op}: input {input} needs {name} of shape {expected}, got {got}");
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Batch normalisation with the statistics of the batch.
    ///
    /// **Formula**: gamma (x - mean) / sqrt(biased variance + eps) + beta, statistics over (N, H, W).
    /// **Shapes**: input (N, C, H, W), `gamma` and `beta` (1, C, 1, 1).
    /// **Gradient**: to input (through the statistics as well), gamma and beta.
    /// **Panics** when shapes disagree, a channel has fewer than two values (its variance means nothing) or `eps` is not
    /// positive. Equals PyTorch's `batch_norm(training=True)` apart from the running averages, which the caller keeps.
    #[track_caller]
    pub fn batch_norm_train(self, gamma: Var<'t, T>, beta: Var<'t, T>, eps: f64) -> BatchNormOutput<'t, T> {
        let shape = self.shape();
        assert_vector("batch_norm_train", "gamma", gamma.shape(), shape);
        assert_vector("batch_norm_train", "beta", beta.shape(), shape);
        assert!(eps > 0.0, "batch_norm_train: input {shape} with eps {eps}; the rule: positive");
        assert!(
            shape.n() * shape.plane() > 1,
            "batch_norm_train: input {shape}: a channel needs at least two values over samples and pixels"
        );
        let x = self.value();
        let measure = |c| moments(channel(x.data(), shape, c));
        let (y, measured, statistics) = forward([self, gamma, beta], eps, measure);
        let vector = |values: Vec<T>| Tensor::from_vec(Shape::new(1, shape.c(), 1, 1), values);
        let mean = vector(measured.iter().map(|m| T::from_f64(m.0)).collect());
        let var = vector(measured.iter().map(|m| T::from_f64(m.1)).collect());
        let saved = Saved { x, gamma: gamma.value(), statistics, batch: true };
        let parents = [self, gamma, beta];
        let y = self.tape().push("batch_norm_train", y, &parents, move |g, grads| saved.backward(g, grads));
        BatchNormOutput { y, mean, var }
    }

    /// Batch normalisation with given statistics.
    ///
    /// **Formula**: gamma (x - mean) / sqrt(var + eps) + beta.
    /// **Shapes**: input (N, C, H, W), all four vectors (1, C, 1, 1).
    /// **Gradient**: to input, gamma and beta; `mean` and `var` are constants.
    /// **Panics** when shapes disagree or `eps` is not positive.
    #[track_caller]
    pub fn batch_norm_eval(self, gamma: Var<'t, T>, beta: Var<'t, T>, mean: &Tensor<T>, var: &Tensor<T>, eps: f64) -> Var<'t, T> {
        let shape = self.shape();
        for (name, got) in [("gamma", gamma.shape()), ("beta", beta.shape()), ("mean", mean.shape()), ("var", var.shape())] {
            assert_vector("batch_norm_eval", name, got, shape);
        }
        assert!(eps > 0.0, "batch_norm_eval: input {} with eps {eps}; the rule: positive", self.shape());
        let measure = |c: usize| (mean.data()[c].to_f64(), var.data()[c].to_f64());
        let parents = [self, gamma, beta];
        let (y, _, statistics) = forward(parents, eps, measure);
        let saved = Saved { x: self.value(), gamma: gamma.value(), statistics, batch: false };
        self.tape().push("batch_norm_eval", y, &parents, move |g, grads| saved.backward(g, grads))
    }
}

#[derive(Clone, Copy, Debug)]
struct BatchNormTrain(f64);

impl Twin for BatchNormTrain {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].batch_norm_train(v[1], v[2], self.0).y
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let standard = x[0].standardised(Shape::new(1, x[0].shape.c(), 1, 1), self.0);
        Plain::from_fn(x[0].shape, |i| x[1].repeated(i) * standard.at(i) + x[2].repeated(i))
    }
}

#[derive(Clone, Copy, Debug)]
struct BatchNormEval(f64);

impl Twin for BatchNormEval {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].batch_norm_eval(v[1], v[2], &v[3].value(), &v[4].value(), self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        Plain::from_fn(x[0].shape, |i| {
            let deviation = (x[4].repeated(i) + N::constant(self.0)).sqrt();
            x[1].repeated(i) * (x[0].at(i) - x[3].repeated(i)) / deviation + x[2].repeated(i)
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("batch_norm_train");
    let mut cases = Vec::new();
    let several = |shape: &Shape| shape.n() * shape.plane() > 1;
    let more = [Shape::new(5, 3, 1, 1), Shape::new(2, 4, 3, 1), Shape::new(1, 2, 2, 5), Shape::new(3, 1, 2, 2)];
    for (i, shape) in more.into_iter().chain(shapes(&mut draw).into_iter().filter(several)).enumerate() {
        let eps = if shape.n() * shape.plane() > 4 { 1e-5 } else { 0.1 };
        let vector = Shape::new(1, shape.c(), 1, 1);
        let case = Case::new(BatchNormTrain(eps), [draw.uniform(shape, -2.0, 3.0), draw.weights(vector), draw.weights(vector)]);
        cases.push(if (1..4).contains(&i) { case.constant(i - 1) } else { case });
    }
    Proof::new("batch_norm_train", cases)
}

pub(crate) fn eval_proof() -> Proof {
    let mut draw = Draw::new("batch_norm_eval");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let vector = Shape::new(1, shape.c(), 1, 1);
        let statistics = [draw.uniform(vector, -1.0, 1.0), draw.uniform(vector, 0.2, 3.0)];
        let [mean, var] = statistics;
        let inputs = [draw.uniform(shape, -2.0, 3.0), draw.weights(vector), draw.weights(vector), mean, var];
        let case = Case::new(BatchNormEval(1e-5), inputs).constant(3).constant(4);
        cases.push(if (7..10).contains(&i) { case.constant(i - 7) } else { case });
    }
    Proof::new("batch_norm_eval", cases)
}

#[cfg(test)]
mod tests {
    use crate::gradcheck::random;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, close};
    use crate::{Shape, Tape, Tensor};

    fn vector(values: &[f64]) -> Tensor<f64> {
        tensor([1, values.len(), 1, 1], values)
    }

    #[test]
    fn worked_numbers_of_a_batch() {
        // Channel 0 holds 1 3 | 3 5 over two samples: mean 3, variance 2; channel 1 holds 0 8 | 0 8: mean 4, variance 16.
        let tape = Tape::new();
        let x = tape.constant(tensor([2, 2, 1, 2], &[1.0, 3.0, 0.0, 8.0, 3.0, 5.0, 0.0, 8.0]));
        let (gamma, beta) = (tape.constant(vector(&[3.0, 10.0])), tape.constant(vector(&[1.0, -1.0])));
        let out = x.batch_norm_train(gamma, beta, 2.0);
        let wide = 40.0 / 18.0_f64.sqrt();
        close(out.y.value().data(), &[-2.0, 1.0, -wide - 1.0, wide - 1.0, 1.0, 4.0, -wide - 1.0, wide - 1.0]);
        close(out.mean.data(), &[3.0, 4.0]);
        close(out.var.data(), &[2.0, 16.0]);
    }

    #[test]
    fn worked_gradients_of_a_batch() {
        // h = -1 0 0 1 with eps 2; g = 1 0 0 0: sum g h = -1, gx = 3/2 (g - 1/4 - h (-1/4)).
        let tape = Tape::new();
        let x = tape.leaf(tensor([2, 1, 1, 2], &[1.0, 3.0, 3.0, 5.0]));
        let (gamma, beta) = (tape.leaf(vector(&[3.0])), tape.leaf(vector(&[1.0])));
        let y = x.batch_norm_train(gamma, beta, 2.0).y;
        let grads = tape.backward(y.mul(tape.constant(tensor([2, 1, 1, 2], &[1.0, 0.0, 0.0, 0.0]))).sum());
        close(grads.wrt(x).data(), &[0.75, -0.375, -0.375, 0.0]);
        close(grads.wrt(gamma).data(), &[-1.0]);
        close(grads.wrt(beta).data(), &[1.0]);
    }

    #[test]
    fn given_statistics_make_it_affine() {
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 1, 1, 3], &[1.0, 2.0, 5.0]));
        let (gamma, beta) = (tape.leaf(vector(&[4.0])), tape.leaf(vector(&[0.5])));
        let y = x.batch_norm_eval(gamma, beta, &vector(&[1.0]), &vector(&[3.0]), 1.0);
        close(y.value().data(), &[0.5, 2.5, 8.5]);
        let grads = tape.backward(y.sum());
        close(grads.wrt(x).data(), &[2.0; 3]);
        close(grads.wrt(gamma).data(), &[2.5]);
        close(grads.wrt(beta).data(), &[3.0]);
    }

    #[test]
    fn the_batch_statistics_given_back_reproduce_the_output() {
        let tape = Tape::new();
        let x = tape.constant(noise(2, [3, 4, 5, 3]));
        let (gamma, beta) = (tape.constant(noise(3, [1, 4, 1, 1])), tape.constant(noise(4, [1, 4, 1, 1])));
        let out = x.batch_norm_train(gamma, beta, 1e-5);
        let again = x.batch_norm_eval(gamma, beta, &out.mean, &out.var, 1e-5);
        close(again.value().data(), out.y.value().data());
    }

    #[test]
    fn a_large_mean_does_not_spoil_single_precision() {
        let tape = Tape::new();
        let x: Tensor<f32> = random(5, Shape::new(4, 1, 33, 35), 1000.0, 1001.0);
        let exact = tape_statistics(&x.cast());
        let one = tape.constant(Tensor::full(Shape::SCALAR, 1.0));
        let zero = tape.constant(Tensor::full(Shape::SCALAR, 0.0));
        let out = tape.constant(x).batch_norm_train(one, zero, 1e-5);
        assert!((f64::from(out.var.item()) - exact).abs() < 1e-5 * exact);
    }

    fn tape_statistics(x: &Tensor<f64>) -> f64 {
        let count = x.data().len() as f64;
        let mean = x.data().iter().sum::<f64>() / count;
        x.data().iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for sizes in [[2, 3, 3, 2], [1, 2, 5, 1], [4, 1, 1, 1]] {
            let c = sizes[1];
            let inputs = [noise(6, sizes), noise(7, [1, c, 1, 1]), noise(8, [1, c, 1, 1])];
            check(&inputs, |v| v[0].batch_norm_train(v[1], v[2], 1e-2).y.square());
            let (mean, var) = (noise(9, [1, c, 1, 1]), random(10, Shape::new(1, c, 1, 1), 0.5, 2.0));
            check(&inputs, |v| v[0].batch_norm_eval(v[1], v[2], &mean, &var, 1e-5).square());
        }
    }

    #[test]
    #[should_panic(expected = "batch_norm_train: input [2, 3, 4, 4] needs gamma of shape [1, 3, 1, 1], got [1, 4, 1, 1]")]
    fn rejects_another_number_of_channels() {
        let tape = Tape::new();
        let gamma = tape.constant(noise(1, [1, 4, 1, 1]));
        tape.constant(noise(1, [2, 3, 4, 4])).batch_norm_train(gamma, gamma, 1e-5);
    }

    #[test]
    #[should_panic(expected = "a channel needs at least two values")]
    fn rejects_a_single_value_per_channel() {
        let tape = Tape::new();
        let gamma = tape.constant(noise(1, [1, 3, 1, 1]));
        tape.constant(noise(1, [1, 3, 1, 1])).batch_norm_train(gamma, gamma, 1e-5);
    }
}
