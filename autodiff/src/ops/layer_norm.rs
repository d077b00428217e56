//! Layer normalisation: the channels of every pixel to mean 0 and variance 1, then one scale and one shift for each channel.
//!
//! `y = w h + b`, `h = (x - m) / √(v + eps)`, `m` and `v` the mean and the biased variance over the channels of a pixel.
//! Vector-Jacobian products: `gx = (w g - mean(w g) - h mean(w g h)) / √(v + eps)` with means over channels,
//! `gw = Σ g h` and `gb = Σ g` over samples and pixels. No kinks. Keeps: the input and two numbers for each pixel.
//!
//! Sums are taken in `f64` in a fixed order. A pixel with equal channels gives the shift. NaN spoils its pixel.

use super::axis::{Lines, rounded};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{GradSink, Scalar, Shape, Tensor, Var, par};

/// Mean and `1 / √(variance + eps)` of every line.
fn statistics<T: Scalar>(x: &[T], lines: Lines, eps: f64) -> [Vec<T>; 2] {
    let count = lines.len as f64;
    let mut moments = vec![(0.0, 0.0); lines.count()];
    lines.fold(&mut moments, [x], |(total, _), _, [x]| (total + x.to_f64(), 0.0));
    moments.iter_mut().for_each(|(total, _)| *total /= count);
    lines.fold(&mut moments, [x], |(mean, squares), _, [x]| {
        let deviation = x.to_f64() - mean;
        (mean, squares + deviation * deviation)
    });
    [rounded(&moments, |m| m.0), rounded(&moments, |m| 1.0 / (m.1 / count + eps).sqrt())]
}

/// What the backward pass needs.
struct Saved<T: Scalar> {
    x: Tensor<T>,
    weight: Tensor<T>,
    means: Vec<T>,
    inverses: Vec<T>,
    lines: Lines,
}

impl<T: Scalar> Saved<T> {
    fn backward_input(&self, grad_y: &[T], grad_x: &mut [T]) {
        let (lines, weight, count) = (self.lines, self.weight.data(), self.lines.len as f64);
        let mut sums: Vec<_> = self.means.iter().map(|&mean| (mean, 0.0, 0.0)).collect();
        lines.fold(&mut sums, [self.x.data(), grad_y], |(mean, total, moment), c, [x, g]| {
            let share = (g * weight[c]).to_f64();
            (mean, total + share, moment + share * (x - mean).to_f64())
        });
        let (offsets, moments) = (rounded(&sums, |s| s.1 / count), rounded(&sums, |s| s.2 / count));
        let numbers = [&self.means[..], &self.inverses, &offsets, &moments];
        lines.update(grad_x, [self.x.data(), grad_y], numbers, |c, _, [x, g], [mean, inverse, offset, moment]| {
            let normalised = (x - mean) * inverse;
            (g * weight[c] - offset - normalised * (moment * inverse)) * inverse
        });
    }

    /// Sums of `g h` and of `g` for every channel.
    fn channel_sums(&self, grad_y: &[T]) -> Vec<(f64, f64)> {
        let Lines { outer, len, inner } = self.lines;
        par::map_indices(len, |c| {
            let (mut scale, mut shift) = (0.0, 0.0);
            for n in 0..outer {
                let (pixels, plane) = (n * inner..(n + 1) * inner, (n * len + c) * inner);
                let entries = grad_y[plane..][..inner].iter().zip(&self.x.data()[plane..][..inner]);
                let numbers = self.means[pixels.clone()].iter().zip(&self.inverses[pixels]);
                for ((&g, &x), (&mean, &inverse)) in entries.zip(numbers) {
                    scale += (g * ((x - mean) * inverse)).to_f64();
                    shift += g.to_f64();
                }
            }
            (scale, shift)
        })
    }

    fn backward(&self, g: &Tensor<T>, grads: &mut GradSink<'_, T>) {
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| self.backward_input(g.data(), out));
        }
        if grads.needs(1) || grads.needs(2) {
            let sums = self.channel_sums(g.data());
            if let Some(mut slot) = grads.slot(1) {
                slot.accumulate(|c| T::from_f64(sums[c].0));
            }
            if let Some(mut slot) = grads.slot(2) {
                slot.accumulate(|c| T::from_f64(sums[c].1));
            }
        }
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Normalises the channels of every pixel, then scales and shifts every channel.
    ///
    /// **Formula**: `weight (x - mean) / √(biased variance + eps) + bias`, statistics over the channels.
    ///
    /// **Shapes**: input `[n, c, h, w]`, `weight` and `bias` `[1, c, 1, 1]`.
    ///
    /// **Gradient**: to the input (through the statistics as well), weight and bias. The usual `eps` is 1e-6.
    ///
    /// **Panics** when shapes disagree, there is no channel or `eps` is not positive. Equals PyTorch's `layer_norm` over the last
    /// axis of the channels-last permutation.
    #[track_caller]
    pub fn layer_norm(self, weight: Var<'t, T>, bias: Var<'t, T>, eps: f64) -> Var<'t, T> {
        let shape = self.shape();
        let vector = Shape::new(1, shape.c(), 1, 1);
        for (name, got) in [("weight", weight.shape()), ("bias", bias.shape())] {
            assert!(got == vector, "layer_norm: input {shape} needs {name} of shape {vector}, got {got}");
        }
        assert!(shape.c() > 0, "layer_norm: input {shape}; the rule: at least one channel");
        assert!(eps > 0.0, "layer_norm: eps {eps} for input {shape}; the rule: positive");
        let lines = Lines::along(shape, 1);
        let (x, scale, shift) = (self.value(), weight.value(), bias.value());
        let [means, inverses] = statistics(x.data(), lines, eps);
        let mut y = self.tape().scratch(shape.len());
        let (scales, shifts) = (scale.data(), shift.data());
        lines.update(&mut y, [x.data()], [&means, &inverses], |c, _, [x], [mean, inverse]| {
            (x - mean) * inverse * scales[c] + shifts[c]
        });
        let y = self.tape().tensor(shape, y);
        let saved = Saved { x, weight: scale, means, inverses, lines };
        self.tape().push("layer_norm", y, &[self, weight, bias], move |g, grads| saved.backward(g, grads))
    }
}

#[derive(Clone, Copy, Debug)]
struct LayerNorm(f64);

impl Twin for LayerNorm {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].layer_norm(v[1], v[2], self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let standard = x[0].standardised(x[0].shape.with_c(1), self.0);
        Plain::from_fn(x[0].shape, |i| x[1].repeated(i) * standard.at(i) + x[2].repeated(i))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("layer_norm");
    let mut cases = Vec::new();
    let more = [Shape::new(1, 9, 2, 3), Shape::new(2, 17, 3, 1), Shape::new(1, 8, 1, 5), Shape::new(2, 6, 2, 2)];
    for (i, shape) in shapes(&mut draw).into_iter().chain(more).enumerate() {
        let eps = if shape.c() > 4 { 1e-6 } else { 0.1 };
        let vector = Shape::new(1, shape.c(), 1, 1);
        let case = Case::new(LayerNorm(eps), [draw.uniform(shape, -2.0, 3.0), draw.weights(vector), draw.weights(vector)]);
        cases.push(if i >= 13 { case.constant(i - 13) } else { case });
    }
    Proof::new("layer_norm", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::gradcheck::random;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{self, check, close};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn worked_numbers() {
        // Pixel 0 has channels 1 3 3 5: mean 3, variance 2, with eps 2 the divisor is 2. Pixel 1 is constant.
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 4, 1, 2], &[1.0, 7.0, 3.0, 7.0, 3.0, 7.0, 5.0, 7.0]));
        let weight = tape.leaf(tensor([1, 4, 1, 1], &[3.0, 1.0, 1.0, 10.0]));
        let bias = tape.leaf(tensor([1, 4, 1, 1], &[0.5, 1.0, 2.0, -1.0]));
        let y = x.layer_norm(weight, bias, 2.0);
        close(y.value().data(), &[-2.5, 0.5, 1.0, 1.0, 2.0, 2.0, 9.0, -1.0]);
        // g = 1 at channel 0 of pixel 0: w g = (3, 0, 0, 0), its mean 3/4, mean of w g h = -3/4, h = (-1, 0, 0, 1).
        let mut first = [0.0; 8];
        first[0] = 1.0;
        let grads = tape.backward(y.mul(tape.constant(tensor([1, 4, 1, 2], &first))).sum());
        close(grads.wrt(x).data(), &[0.75, 0.0, -0.375, 0.0, -0.375, 0.0, 0.0, 0.0]);
        close(grads.wrt(weight).data(), &[-1.0, 0.0, 0.0, 0.0]);
        close(grads.wrt(bias).data(), &[1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn pixels_come_out_with_mean_zero_and_variance_one_in_single_precision() {
        let tape = Tape::new();
        let shape = Shape::new(2, 37, 3, 5);
        let x: Tensor<f32> = random(2, shape, 100.0, 101.0);
        let vector = |value| tape.constant(Tensor::full(Shape::new(1, 37, 1, 1), value));
        let y = tape.constant(x).layer_norm(vector(1.0), vector(0.0), 1e-6).value();
        for (n, i) in (0..2).flat_map(|n| (0..15).map(move |i| (n, i))) {
            let pixel: Vec<f64> = (0..37).map(|c| f64::from(y.plane(n, c)[i])).collect();
            let mean = pixel.iter().sum::<f64>() / 37.0;
            let variance = pixel.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 37.0;
            assert!(mean.abs() < 1e-4 && (variance - 1.0).abs() < 1e-3, "pixel {n} {i}: {mean} {variance}");
        }
    }

    #[test]
    fn nan_spoils_its_pixel_and_no_other() {
        let tape = Tape::new();
        let x = tape.constant(tensor([1, 2, 1, 2], &[f64::NAN, 1.0, 2.0, 3.0]));
        let (one, zero) = (Tensor::full(Shape::new(1, 2, 1, 1), 1.0), Tensor::zeros(Shape::new(1, 2, 1, 1)));
        let y = x.layer_norm(tape.constant(one), tape.constant(zero), 1e-6).value();
        assert_eq!(y.data().iter().map(|y| y.is_nan()).collect::<Vec<_>>(), [true, false, true, false]);
    }

    #[test]
    #[should_panic(expected = "layer_norm: input [2, 3, 4, 4] needs weight of shape [1, 3, 1, 1], got [1, 4, 1, 1]")]
    fn another_number_of_channels_is_refused() {
        let tape = Tape::new();
        let weight = tape.constant(noise(1, [1, 4, 1, 1]));
        tape.constant(noise(1, [2, 3, 4, 4])).layer_norm(weight, weight, 1e-6);
    }

    #[test]
    #[should_panic(expected = "layer_norm: eps 0 for input [1, 2, 1, 1]; the rule: positive")]
    fn eps_zero_is_refused() {
        let tape = Tape::new();
        let x = tape.constant(noise(1, [1, 2, 1, 1]));
        x.layer_norm(x, x, 0.0);
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), c in 1..5usize, eps in 1e-2..1e-1, seed in any::<u64>()
        ) {
            let shape = shape.with_c(c);
            let vector = |seed| random(seed, Shape::new(1, c, 1, 1), 0.5, 2.0);
            let inputs = [random(seed, shape, -2.0, 2.0), vector(seed ^ 1), vector(seed ^ 2)];
            check(&inputs, |v| v[0].layer_norm(v[1], v[2], eps));
        }

        #[test]
        fn equals_the_composition_of_simpler_operations(shape in testing::shapes(), c in 1..5usize, seed in any::<u64>()) {
            let tape = Tape::<f64>::new();
            let shape = shape.with_c(c);
            let x = tape.constant(random(seed, shape, -2.0, 2.0));
            let vector = |seed| tape.constant(random(seed, Shape::new(1, c, 1, 1), 0.5, 2.0));
            let (weight, bias) = (vector(seed ^ 1), vector(seed ^ 2));
            let centred = x.sub(x.mean_channels().broadcast_to(shape));
            let deviation = centred.square().mean_channels().add_scalar(1e-6).sqrt().broadcast_to(shape);
            let want = centred.div(deviation).mul(weight.broadcast_to(shape)).add(bias.broadcast_to(shape));
            let got = x.layer_norm(weight, bias, 1e-6).value();
            for (a, b) in got.data().iter().zip(want.value().data()) {
                prop_assert!((a - b).abs() < 1e-9, "{} against {}", a, b);
            }
        }
    }
}
