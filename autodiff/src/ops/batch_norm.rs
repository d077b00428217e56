//! Batch normalisation over samples and pixels of each channel, with the batch's statistics or with given ones.
//!
//! y = gamma (x - m) / sqrt(v + eps) + beta.
//! Training: m and v are the mean and biased variance over (N, H, W) of the channel. vjp, with h = (x - m)/sqrt(v + eps):
//! ggamma = sum g h, gbeta = sum g, gx = gamma/sqrt(v + eps) (g - mean g - h mean(g h)).
//! Evaluation: m and v are constants; the same ggamma and gbeta, gx = gamma/sqrt(v + eps) g.
//! Kinks: none.  Keeps: the input and two numbers per channel.

use super::norm::{Denormalise, Normalise, PassBack, moments};
use crate::activation::{Activate, with_activation};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Activation, GradSink, Scalar, Shape, Tensor, Var, par};

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

/// What follows the normalisation in the same pass: `activation(normalised + skip)`.
#[derive(Clone, Copy)]
pub(crate) struct Tail<'t, T: Scalar> {
    pub(crate) skip: Option<Var<'t, T>>,
    pub(crate) activation: Activation,
}

impl<T: Scalar> Tail<'_, T> {
    const NONE: Self = Self { skip: None, activation: Activation::Identity };
}

/// Centre and 1/sqrt(v + eps) of each channel.
type Statistics<T> = Vec<(T, T)>;

/// The planes of channel `c`, one for each sample.
fn channel<T: Scalar>(x: &[T], shape: Shape, c: usize) -> impl Iterator<Item = &[T]> + Clone {
    let (stride, plane) = (shape.c() * shape.plane(), shape.plane());
    (0..shape.n()).map(move |n| &x[n * stride + c * plane..][..plane])
}

/// The planes of `out` channel after channel, `shape.n()` of each: one task reads and writes a channel while it is in the cache.
fn by_channel<T: Scalar>(out: &mut [T], shape: Shape) -> Vec<&mut [T]> {
    let mut planes: Vec<&mut [T]> = Vec::new();
    planes.resize_with(shape.planes(), Default::default);
    for (i, plane) in out.chunks_exact_mut(shape.plane()).enumerate() {
        planes[i % shape.c() * shape.n() + i / shape.c()] = plane;
    }
    planes
}

/// Normalises every channel with the statistics that `measure` returns for it, mean and variance.
fn forward<'t, T: Scalar>(
    [x, gamma, beta]: [Var<'t, T>; 3],
    eps: f64,
    (skip, activation): (Option<&Tensor<T>>, impl Activate),
    measure: impl Fn(usize) -> (f64, f64) + Sync + Send,
) -> (Tensor<T>, Vec<(f64, f64)>, Statistics<T>) {
    let (shape, value, gamma, beta) = (x.shape(), x.value(), gamma.value(), beta.value());
    let scaled = |(mean, variance): (f64, f64)| (T::from_f64(mean), T::from_f64(1.0 / (variance + eps).sqrt()));
    let mut measured = vec![(0.0, 0.0); shape.c()];
    let mut y = x.tape().scratch(shape.len());
    let mut planes = by_channel(&mut y, shape);
    let channels = planes.chunks_exact_mut(shape.n()).zip(&mut measured).collect();
    par::for_each_item(channels, |c, (planes, measured)| {
        *measured = measure(c);
        let (mean, inverse) = scaled(*measured);
        let (scale, shift) = (inverse * gamma.data()[c], beta.data()[c]);
        for (n, (y, x)) in planes.iter_mut().zip(channel(value.data(), shape, c)).enumerate() {
            let skip = skip.map(|skip| skip.plane(n, c));
            Normalise { x, skip, y, mean, scale, shift, activation }.run();
        }
    });
    let statistics = measured.iter().copied().map(scaled).collect();
    (x.tape().tensor(shape, y), measured, statistics)
}

/// What the backward pass needs; with `batch` the statistics depend on the input.
struct Saved<T: Scalar> {
    x: Tensor<T>,
    /// The output, which tells the slope of the activation.
    y: Tensor<T>,
    gamma: Tensor<T>,
    statistics: Statistics<T>,
    batch: bool,
}

impl<T: Scalar> Saved<T> {
    /// Parents are input, gamma, beta and perhaps the skip.
    fn backward(&self, activation: impl Activate, g: &Tensor<T>, grads: &mut GradSink<'_, T>) {
        let shape = self.x.shape();
        let mut gx = grads.scratch(shape.len());
        let mut skip = (grads.len() == 4 && grads.needs(3)).then(|| grads.scratch(shape.len()));
        let mut sums = vec![(0.0, 0.0); shape.c()];
        let mut skip_planes = skip.as_mut().map_or_else(Vec::new, |skip| by_channel(skip, shape));
        let mut skips = skip_planes.chunks_exact_mut(shape.n());
        let mut planes = by_channel(&mut gx, shape);
        let channels = planes.chunks_exact_mut(shape.n()).zip(&mut sums);
        let channels = channels.map(|(gx, sums)| (gx, skips.next().unwrap_or_default(), sums)).collect();
        par::for_each_item(channels, |c, (gx, skip, sums)| {
            *sums = self.pass_back(activation, g, c, gx);
            for (skip, gx) in skip.iter_mut().zip(&*gx) {
                skip.copy_from_slice(gx);
            }
            self.input_gradient(c, *sums, gx);
        });
        match grads.slot(0) {
            Some(mut slot) => slot.add_fresh(gx),
            None => grads.give_back(gx),
        }
        if let Some(mut slot) = grads.slot(1) {
            slot.accumulate(|c| T::from_f64(sums[c].1));
        }
        if let Some(mut slot) = grads.slot(2) {
            slot.accumulate(|c| T::from_f64(sums[c].0));
        }
        if let Some(skip) = skip
            && let Some(mut slot) = grads.slot(3)
        {
            slot.add_fresh(skip);
        }
    }

    /// Writes the gradient before the activation of channel `c`: its sum and that of its products with the normalised input.
    fn pass_back(&self, activation: impl Activate, g: &Tensor<T>, c: usize, out: &mut [&mut [T]]) -> (f64, f64) {
        let (centre, inverse) = self.statistics[c];
        let (mut total, mut moment) = (0.0, 0.0);
        for (n, out) in out.iter_mut().enumerate() {
            let (g, x, y) = (g.plane(n, c), self.x.plane(n, c), self.y.plane(n, c));
            let (t, m) = PassBack { g, x, y, centre, activation, out }.run();
            total += t;
            moment += m;
        }
        (total, moment * inverse.to_f64())
    }

    /// Turns the gradient of the normalised channel `c` into that of the input, given the channel's sums.
    fn input_gradient(&self, c: usize, (total, moment): (f64, f64), planes: &mut [&mut [T]]) {
        let shape = self.x.shape();
        let count = (shape.n() * shape.plane()) as f64;
        let (mean, inverse) = self.statistics[c];
        let (total, moment) = if self.batch { (total, moment) } else { (0.0, 0.0) };
        let slope = T::from_f64(moment / count * inverse.to_f64());
        let (offset, scale) = (T::from_f64(total / count), inverse * self.gamma.data()[c]);
        for (g, x) in planes.iter_mut().zip(channel(self.x.data(), shape, c)) {
            Denormalise { g, x, mean, offset, slope, scale }.run();
        }
    }
}

/// Batch normalisation with the batch's statistics and what follows it, as the operation `op`.
#[track_caller]
pub(crate) fn train<'t, T: Scalar>(
    op: &'static str,
    [x, gamma, beta]: [Var<'t, T>; 3],
    eps: f64,
    tail: Tail<'t, T>,
) -> BatchNormOutput<'t, T> {
    let shape = x.shape();
    assert_vector(op, "gamma", gamma.shape(), shape);
    assert_vector(op, "beta", beta.shape(), shape);
    assert!(eps > 0.0, "{op}: input {shape} with eps {eps}; the rule: positive");
    assert!(shape.n() * shape.plane() > 1, "{op}: input {shape}: a channel needs at least two values over samples and pixels");
    let value = x.value();
    let measure = |c| moments(channel(value.data(), shape, c));
    let (y, measured) = record(op, [x, gamma, beta], (eps, true), tail, measure);
    let vector = |values: Vec<T>| Tensor::from_vec(Shape::new(1, shape.c(), 1, 1), values);
    let mean = vector(measured.iter().map(|m| T::from_f64(m.0)).collect());
    let var = vector(measured.iter().map(|m| T::from_f64(m.1)).collect());
    BatchNormOutput { y, mean, var }
}

/// Batch normalisation with given mean and variance and what follows it, as the operation `op`.
#[track_caller]
pub(crate) fn eval<'t, T: Scalar>(
    op: &'static str,
    [x, gamma, beta]: [Var<'t, T>; 3],
    [mean, var]: [&Tensor<T>; 2],
    eps: f64,
    tail: Tail<'t, T>,
) -> Var<'t, T> {
    let shape = x.shape();
    for (name, got) in [("gamma", gamma.shape()), ("beta", beta.shape()), ("mean", mean.shape()), ("var", var.shape())] {
        assert_vector(op, name, got, shape);
    }
    assert!(eps > 0.0, "{op}: input {shape} with eps {eps}; the rule: positive");
    let measure = |c: usize| (mean.data()[c].to_f64(), var.data()[c].to_f64());
    record(op, [x, gamma, beta], (eps, false), tail, measure).0
}

/// Computes and records; returns what was measured of each channel too.
#[track_caller]
fn record<'t, T: Scalar>(
    op: &'static str,
    inputs: [Var<'t, T>; 3],
    (eps, batch): (f64, bool),
    Tail { skip, activation }: Tail<'t, T>,
    measure: impl Fn(usize) -> (f64, f64) + Sync + Send,
) -> (Var<'t, T>, Vec<(f64, f64)>) {
    let [x, gamma, _] = inputs;
    let skipped = skip.map(|skip| {
        assert!(skip.shape() == x.shape(), "{op}: input {} and skip {} differ; the rule: one shape", x.shape(), skip.shape());
        skip.value()
    });
    let parents: Vec<_> = inputs.into_iter().chain(skip).collect();
    with_activation!(activation, |activation| {
        let (y, measured, statistics) = forward(inputs, eps, (skipped.as_ref(), activation), measure);
        let saved = Saved { x: x.value(), y: y.clone(), gamma: gamma.value(), statistics, batch };
        (x.tape().push(op, y, &parents, move |g, grads| saved.backward(activation, g, grads)), measured)
    })
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
        train("batch_norm_train", [self, gamma, beta], eps, Tail::NONE)
    }

    /// Batch normalisation with given statistics.
    ///
    /// **Formula**: gamma (x - mean) / sqrt(var + eps) + beta.
    /// **Shapes**: input (N, C, H, W), all four vectors (1, C, 1, 1).
    /// **Gradient**: to input, gamma and beta; `mean` and `var` are constants.
    /// **Panics** when shapes disagree or `eps` is not positive.
    #[track_caller]
    pub fn batch_norm_eval(self, gamma: Var<'t, T>, beta: Var<'t, T>, mean: &Tensor<T>, var: &Tensor<T>, eps: f64) -> Var<'t, T> {
        eval("batch_norm_eval", [self, gamma, beta], [mean, var], eps, Tail::NONE)
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
