//! Instance normalisation: every plane to mean 0 and variance 1, without scale, shift or running statistics.
//!
//! y = (x - m) / sqrt(v + eps), m and v the mean and the biased variance of the plane.
//! vjp: gx = (g - mean(g) - y mean(g y)) / sqrt(v + eps).  Kinks: none.  Keeps: the input, m and 1/sqrt(v + eps).
//! A plane of one element, or a constant one, gives zeros and passes a gradient of (g - mean g) / sqrt(eps).

use super::norm::{Denormalise, Normalise, PassBack, moments};
use super::planes::for_each_plane;
use crate::activation::Identity;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{Scalar, Var, par};

fn backward_plane<T: Scalar>(g: &[T], x: &[T], gx: &mut [T], mean: T, inverse: T) {
    let (total, moment) = PassBack { g, x, y: x, centre: mean, activation: Identity, out: gx }.run();
    let count = x.len() as f64;
    let inv = inverse.to_f64();
    let offset = T::from_f64(total / count);
    let slope = T::from_f64(moment / count * inv * inv);
    Denormalise { g: gx, x, mean, offset, slope, scale: inverse }.run();
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Normalises every plane to mean 0 and variance 1.
    ///
    /// **Formula**: (x - mean) / sqrt(biased variance + eps) per sample and channel. **Shapes**: (N, C, H, W) to the same.
    /// **Gradient**: through the mean and the variance as well. The usual eps is 1e-5.
    /// **Panics** when `eps` is not positive.
    #[track_caller]
    pub fn instance_norm(self, eps: f64) -> Var<'t, T> {
        let shape = self.shape();
        assert!(eps > 0.0, "instance_norm: input {shape} with eps {eps}; the rule: positive");
        let plane = shape.plane();
        let x = self.value();
        let statistics: Vec<(T, T)> = par::map_indices(shape.planes(), |i| {
            let (mean, variance) = moments(std::iter::once(&x.data()[i * plane..][..plane]));
            (T::from_f64(mean), T::from_f64(1.0 / (variance + eps).sqrt()))
        });
        let mut y = self.tape().scratch(shape.len());
        for_each_plane(&mut y, plane, |i, out| {
            let (mean, inverse) = statistics[i];
            let x = &x.data()[i * plane..][..plane];
            Normalise { x, skip: None, y: out, mean, scale: inverse, shift: T::ZERO, activation: Identity }.run();
        });
        let y = self.tape().tensor(shape, y);
        self.tape().push("instance_norm", y, &[self], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|gx| {
                    for_each_plane(gx, plane, |i, out| {
                        let (mean, inverse) = statistics[i];
                        let at = i * plane..(i + 1) * plane;
                        backward_plane(&g.data()[at.clone()], &x.data()[at], out, mean, inverse);
                    });
                });
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct InstanceNorm(f64);

impl Twin for InstanceNorm {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].instance_norm(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        x[0].standardised(x[0].shape.with_plane(1, 1), self.0)
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("instance_norm");
    let mut cases = Vec::new();
    for shape in shapes(&mut draw) {
        let eps = if shape.plane() > 4 { 1e-5 } else { 0.1 };
        cases.push(Case::new(InstanceNorm(eps), [draw.uniform(shape, -2.0, 3.0)]));
    }
    Proof::new("instance_norm", cases)
}

#[cfg(test)]
mod tests {
    use crate::gradcheck::random;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{check, close};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn worked_numbers() {
        // Mean 3, variance (4 + 0 + 0 + 4)/4 = 2; with eps 2 the divisor is 2.
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 2, 2, 2], &[1.0, 3.0, 3.0, 5.0, 10.0, 30.0, 30.0, 50.0]));
        let y = x.instance_norm(2.0);
        close(&y.value().data()[..4], &[-1.0, 0.0, 0.0, 1.0]);
        let wide = 20.0 / 202.0_f64.sqrt();
        close(&y.value().data()[4..], &[-wide, 0.0, 0.0, wide]);
        // Gradient of the first output: g - mean g = (3, -1, -1, -1)/4, mean(g y) = -1/4; all over 2.
        let first = y.mul(tape.constant(tensor([1, 2, 2, 2], &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])));
        close(&tape.backward(first.sum()).wrt(x).data()[..4], &[0.25, -0.125, -0.125, 0.0]);
    }

    #[test]
    fn planes_come_out_with_mean_zero_and_variance_one() {
        let tape = Tape::new();
        let x: Tensor<f32> = random(2, Shape::new(3, 2, 37, 41), 100.0, 101.0);
        let y = tape.constant(x).instance_norm(1e-5).value();
        for i in 0..6 {
            let plane: Vec<f64> = y.plane(i / 2, i % 2).iter().map(|&v| f64::from(v)).collect();
            let mean = plane.iter().sum::<f64>() / plane.len() as f64;
            let variance = plane.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / plane.len() as f64;
            assert!(mean.abs() < 1e-4 && (variance - 1.0).abs() < 1e-3, "plane {i}: {mean} {variance}");
        }
    }

    #[test]
    fn constant_planes_give_zeros() {
        let tape = Tape::new();
        let y = tape.constant(Tensor::full(Shape::new(1, 2, 3, 1), 4.0)).instance_norm(1e-5);
        close(y.value().data(), &[0.0; 6]);
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for sizes in [[2, 2, 3, 5], [1, 3, 1, 4], [2, 1, 7, 2]] {
            check(&[noise(4, sizes)], |v| v[0].instance_norm(1e-2));
        }
    }

    #[test]
    #[should_panic(expected = "with eps 0; the rule: positive")]
    fn rejects_eps_zero() {
        let tape = Tape::new();
        tape.constant(noise(1, [2, 1, 2, 3])).instance_norm(0.0);
    }
}
