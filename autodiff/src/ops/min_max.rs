//! `y = (x - m) / R` over the whole tensor, `m` and `M` its smallest and largest entry, `R = M - m + eps`: values from 0 to almost 1.
//! Vector-Jacobian product: `g / R` to every entry; besides, `(Σ g y - Σ g) / R` to the minimum and `-Σ g y / R` to the maximum.
//! At the kinks, where several entries are extreme, they share this part equally. Keeps: the input, `m` and `M`.
//!
//! Sums are taken in `f64` in a fixed order. A constant tensor gives zeros. NaN anywhere spoils everything, as it hides the extremes.

use super::kernel;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, shapes};
use crate::{GradSink, Scalar, Tensor, Var, par};

/// The better of two entries; NaN where one of them is NaN.
fn better<T: Scalar>(a: T, b: T, first: bool) -> T {
    if a.is_nan() || first { a } else { b }
}

/// Smallest and largest entry.
fn extremes<T: Scalar>(x: &[T]) -> [T; 2] {
    let join = |[low, high]: [T; 2], [a, b]: [T; 2]| [better(low, a, low <= a), better(high, b, high >= b)];
    let piece = |i: usize| {
        let piece = &x[i * par::CHUNK..x.len().min((i + 1) * par::CHUNK)];
        piece.iter().fold([piece[0]; 2], |pair, &x| join(pair, [x; 2]))
    };
    par::map_indices(x.len().div_ceil(par::CHUNK), piece).into_iter().reduce(join).unwrap_or([T::ZERO; 2])
}

fn forward<T: Scalar>(x: &[T], y: &mut [T], [low, high]: [T; 2], eps: T) {
    let range = high - low + eps;
    kernel::map(y, x, |x| (x - low) / range);
}

fn backward<T: Scalar>(x: &[T], grad_y: &[T], grad_x: &mut [T], [low, high]: [T; 2], eps: T) {
    let range = high - low + eps;
    let total = par::sum(x.len(), |piece| grad_y[piece].iter().map(|g| g.to_f64()).sum());
    let moment = par::sum(x.len(), |piece| {
        let pairs = grad_y[piece.clone()].iter().zip(&x[piece]);
        pairs.map(|(&g, &x)| (g * ((x - low) / range)).to_f64()).sum()
    });
    let count = |extreme: T| par::sum(x.len(), |piece| x[piece].iter().filter(|&&x| x == extreme).count() as f64);
    let share = |sum: f64, extreme: T| T::from_f64(sum / range.to_f64() / count(extreme));
    let (to_low, to_high) = (share(moment - total, low), share(-moment, high));
    kernel::zip(grad_x, x, grad_y, |x, g| {
        let low_part = if x == low { to_low } else { T::ZERO };
        let high_part = if x == high { to_high } else { T::ZERO };
        g / range + low_part + high_part
    });
}

impl<'t, T: Scalar> Var<'t, T> {
    /// All entries moved and scaled so that the smallest of the tensor is 0 and the largest almost 1.
    ///
    /// **Formula**: `(x - min) / (max - min + eps)`, over all four axes: the samples of a batch depend on each other.
    ///
    /// **Shapes**: any to the same.
    ///
    /// **Gradient**: through minimum and maximum as well; equal extremes share their part equally. The usual `eps` is 1e-8.
    ///
    /// **Panics** unless `eps` is positive and finite in `T`.
    #[track_caller]
    pub fn min_max(self, eps: f64) -> Var<'t, T> {
        let guard = T::from_f64(eps);
        assert!(
            guard > T::ZERO && guard.is_finite(),
            "min_max: eps {eps} for shape {}; the rule: positive and finite in the scalar type",
            self.shape()
        );
        let x = self.value();
        let pair = extremes(x.data());
        let mut y = self.tape().scratch(self.shape().len());
        forward(x.data(), &mut y, pair, guard);
        let y = self.tape().tensor(self.shape(), y);
        self.tape().push("min_max", y, &[self], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            if let Some(mut slot) = grads.slot(0) {
                slot.write(|out| backward(x.data(), g.data(), out, pair, guard));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct MinMax(f64);

impl Twin for MinMax {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].min_max(self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (first, all) = (x[0].data[0], &x[0].data);
        let (least, most) = (all.iter().fold(first, |m, &x| m.min(x)), all.iter().fold(first, |m, &x| m.max(x)));
        x[0].map(|x| (x - least) / (most - least + N::constant(self.0)))
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("min_max");
    let shapes = shapes(&mut draw).into_iter().enumerate();
    let eps = |i| if i % 2 == 0 { 0.25 } else { 1e-2 };
    Proof::new("min_max", shapes.map(|(i, shape)| Case::new(MinMax(eps(i)), [draw.distinct(shape)])))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::extremes;
    use crate::ops::testing::{self, close, distinct, row, slopes, values};
    use crate::{Shape, Tape, Tensor};

    #[test]
    fn values_and_gradient_are_known() {
        // Range 3 + 1; with g = (1, 2, 4) the sums are Σ g = 7 and Σ g y = 2 / 4 + 4 · 3 / 4 = 3.5.
        let tape = Tape::new();
        let x = tape.leaf(row(&[5.0, 6.0, 8.0]));
        let y = x.min_max(1.0);
        close(y.value().data(), &[0.0, 0.25, 0.75]);
        let loss = y.mul(tape.constant(row(&[1.0, 2.0, 4.0]))).sum();
        close(tape.backward(loss).wrt(x).data(), &[0.25 - 3.5 / 4.0, 0.5, 1.0 - 3.5 / 4.0]);
    }

    #[test]
    fn equal_extremes_share_equally() {
        // Range 2 with eps 1; with g = 1 everywhere: Σ g = 5, Σ g y = 1/2 + 1/2.
        let y = |x: &[f64]| values(x, |x| x.min_max(1.0));
        close(&y(&[3.0, 4.0, 3.0, 4.0, 3.0]), &[0.0, 0.5, 0.0, 0.5, 0.0]);
        let (low, high) = (0.5 - 2.0 / 3.0, 0.5 - 0.25);
        close(&slopes(&[3.0, 4.0, 3.0, 4.0, 3.0], |x| x.min_max(1.0)), &[low, high, low, high, low]);
    }

    #[test]
    fn constant_tensor_gives_zeros_and_passes_the_deviation_of_the_gradient() {
        let tape = Tape::new();
        let x = tape.leaf(row(&[7.0, 7.0]));
        let y = x.min_max(0.5);
        close(y.value().data(), &[0.0, 0.0]);
        let loss = y.mul(tape.constant(row(&[3.0, 1.0]))).sum();
        close(tape.backward(loss).wrt(x).data(), &[2.0, -2.0]);
    }

    #[test]
    fn nan_anywhere_is_not_hidden() {
        for x in [[f64::NAN, 1.0, 2.0], [1.0, f64::NAN, 2.0], [1.0, 2.0, f64::NAN]] {
            assert!(values(&x, |x| x.min_max(1e-8)).iter().all(|y| y.is_nan()), "{x:?}");
        }
    }

    #[test]
    fn extremes_are_found_in_every_piece() {
        let mut x: Vec<f64> = (0..50_000).map(|i| f64::from(i % 100)).collect();
        assert_eq!(extremes(&x), [0.0, 99.0]);
        (x[20_000], x[49_999]) = (-1.0, 100.0);
        assert_eq!(extremes(&x), [-1.0, 100.0]);
        x[40_000] = f64::NAN;
        assert!(extremes(&x).iter().all(|x| x.is_nan()));
        assert_eq!(extremes::<f64>(&[]), [0.0, 0.0]);
    }

    #[test]
    #[should_panic(expected = "min_max: eps 0 for shape [1, 1, 1, 2]; the rule: positive and finite")]
    fn eps_zero_is_refused() {
        values(&[1.0, 2.0], |x| x.min_max(0.0));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), len in 2..5usize, eps in 1e-3..1.0, seed in any::<u64>()) {
            let x = distinct(seed, shape.with_axis(3, len + 1));
            testing::check(&[x], |v| v[0].min_max(eps));
        }

        #[test]
        fn values_run_from_zero_to_one(shape in testing::shapes(), len in 2..5usize, seed in any::<u64>()) {
            let shape: Shape = shape.with_axis(3, len);
            let x: Tensor<f64> = distinct(seed, shape);
            let [low, high] = extremes(Tape::new().constant(x).min_max(1e-13).value().data());
            prop_assert!(low == 0.0 && (high - 1.0).abs() < 1e-12, "{} {}", low, high);
        }
    }
}
