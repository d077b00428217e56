//! `y = (Σ w |a − b|) / (Σ w + guard)`, one number for the whole batch; a weight stands for its pixel in every channel and is
//! counted once. Vector-Jacobian product: `g w sign(a − b) / (Σ w + guard)` to `a`, the opposite to `b`; 0 at the kink `a = b`.
//! Keeps: operands and weights; the weights take no gradient.
//!
//! One pass over the maps each way, where `select`, `sub`, `abs`, `mul` and `sum` take ten and keep four maps. Entries of weight 0
//! may be NaN or infinite: they reach neither the value nor the gradient. Sums of short blocks are added in `f64` in a fixed
//! order.

use pulp::{Arch, Simd, WithSimd};

use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, indices, shapes, total};
use crate::shape::assert_same;
use crate::simd::{Truths, Wide};
use crate::{GradSink, Scalar, Shape, Tensor, Var, par};

/// Elements that are summed in `T` before the sum goes on in `f64`.
const BLOCK: usize = 1024;

/// `Σ w |a − b|` of a piece of one channel.
struct Distances<'a, T> {
    a: &'a [T],
    b: &'a [T],
    weights: &'a [T],
}

impl<T: Scalar> WithSimd for Distances<'_, T> {
    type Output = f64;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let (lanes, mut total) = (Wide::<S, T>::lanes(), 0.0);
        for ((a, b), weights) in self.a.chunks(BLOCK).zip(self.b.chunks(BLOCK)).zip(self.weights.chunks(BLOCK)) {
            let mut sums = [Wide::splat(simd, T::ZERO); 2];
            let whole = a.len() - a.len() % lanes;
            for i in (0..whole).step_by(lanes) {
                let read = [a, b, weights].map(|x| Wide::load(simd, &x[i..i + lanes]));
                // By turns: an addition waits for the one before it.
                sums = [sums[1], sums[0] + distance(read)];
            }
            if whole < a.len() {
                sums[0] = sums[0] + distance([a, b, weights].map(|x| Wide::load_part(simd, &x[whole..])));
            }
            total += (sums[0] + sums[1]).sum().to_f64();
        }
        total
    }
}

#[inline(always)]
fn distance<S: Simd, T: Scalar>([a, b, weight]: [Wide<S, T>; 3]) -> Wide<S, T> {
    is_zero(weight).choose(weight.like(T::ZERO), weight * (a - b).abs())
}

#[inline(always)]
fn is_zero<S: Simd, T: Scalar>(x: Wide<S, T>) -> Truths<S, T> {
    let zero = x.like(T::ZERO);
    x.at_most(zero) & zero.at_most(x)
}

/// `Σ w` of a piece.
struct Total<'a, T>(&'a [T]);

impl<T: Scalar> WithSimd for Total<'_, T> {
    type Output = f64;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let (lanes, mut total) = (Wide::<S, T>::lanes(), 0.0);
        for weights in self.0.chunks(BLOCK) {
            let mut sum = Wide::splat(simd, T::ZERO);
            let groups = weights.chunks_exact(lanes);
            let rest = groups.remainder();
            for group in groups {
                sum = sum + Wide::load(simd, group);
            }
            total += (sum + Wide::load_part(simd, rest)).sum().to_f64();
        }
        total
    }
}

/// `share sign(a − b)` times the weight, of a piece of one channel, and the opposite; where one is not wanted its slice is empty.
struct Slopes<'a, T> {
    a: &'a [T],
    b: &'a [T],
    weights: &'a [T],
    share: T,
    to_a: &'a mut [T],
    to_b: &'a mut [T],
}

impl<T: Scalar> WithSimd for Slopes<'_, T> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (lanes, len) = (Wide::<S, T>::lanes(), self.a.len());
        let (to_a, to_b) = (!self.to_a.is_empty(), !self.to_b.is_empty());
        let whole = len - len % lanes;
        for i in (0..whole).step_by(lanes) {
            let read = [self.a, self.b, self.weights].map(|x| Wide::load(simd, &x[i..i + lanes]));
            let slope = slope(read, self.share);
            if to_a {
                slope.store(&mut self.to_a[i..i + lanes]);
            }
            if to_b {
                (-slope).store(&mut self.to_b[i..i + lanes]);
            }
        }
        if whole < len {
            let slope = slope([self.a, self.b, self.weights].map(|x| Wide::load_part(simd, &x[whole..])), self.share);
            if to_a {
                slope.store_part(&mut self.to_a[whole..]);
            }
            if to_b {
                (-slope).store_part(&mut self.to_b[whole..]);
            }
        }
    }
}

#[inline(always)]
fn slope<S: Simd, T: Scalar>([a, b, weight]: [Wide<S, T>; 3], share: T) -> Wide<S, T> {
    let (zero, size) = (a.like(T::ZERO), weight * a.like(share));
    let difference = a - b;
    let slope = difference.greater(zero).choose(size, difference.less(zero).choose(-size, zero));
    // Also where the share is not finite.
    is_zero(weight).choose(zero, slope)
}

/// `[Σ w |a − b|, Σ w]`, piece by piece of every plane.
fn sums<T: Scalar>(a: &Tensor<T>, b: &Tensor<T>, weights: &Tensor<T>) -> [f64; 2] {
    let (shape, plane) = (a.shape(), a.shape().plane());
    let per_plane = plane.div_ceil(par::CHUNK);
    let parts = par::map_indices(shape.n() * per_plane, |i| {
        let (n, start) = (i / per_plane, i % per_plane * par::CHUNK);
        let piece = start..(start + par::CHUNK).min(plane);
        let weights = &weights.plane(n, 0)[piece.clone()];
        let mut distance = 0.0;
        for c in 0..shape.c() {
            let [a, b] = [a, b].map(|x| &x.plane(n, c)[piece.clone()]);
            distance += Arch::new().dispatch(Distances { a, b, weights });
        }
        [distance, Arch::new().dispatch(Total(weights))]
    });
    parts.iter().fold([0.0; 2], |[distance, weight], part| [distance + part[0], weight + part[1]])
}

/// Writes the gradients that are wanted, both in one pass.
fn backward<T: Scalar>([a, b, weights]: [&Tensor<T>; 3], share: T, to_a: Option<&mut [T]>, to_b: Option<&mut [T]>) {
    let (channels, plane) = (a.shape().c(), a.shape().plane());
    let per_plane = plane.div_ceil(par::CHUNK);
    let [mut to_a, mut to_b] = [to_a, to_b].map(|out| out.into_iter().flat_map(|out| cut(out, plane)));
    let items = (0..a.shape().n() * channels * per_plane).map(|i| (i, [to_a.next(), to_b.next()].map(Option::unwrap_or_default)));
    let mut items: Vec<_> = items.collect();
    // What was read last on the way there may still be in a cache.
    items.reverse();
    par::for_each_item(items, |_, (i, [to_a, to_b])| {
        let (n, c, start) = (i / per_plane / channels, i / per_plane % channels, i % per_plane * par::CHUNK);
        let piece = start..(start + par::CHUNK).min(plane);
        let [a, b, weights] = [a.plane(n, c), b.plane(n, c), weights.plane(n, 0)].map(|x| &x[piece.clone()]);
        Arch::new().dispatch(Slopes { a, b, weights, share, to_a, to_b });
    });
}

/// The pieces of all planes of a buffer.
fn cut<T>(out: &mut [T], plane: usize) -> impl Iterator<Item = &mut [T]> {
    out.chunks_mut(plane).flat_map(|plane| plane.chunks_mut(par::CHUNK))
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Weighted mean absolute difference, `(Σ w |self − other|) / (Σ w + guard)`; one number.
    ///
    /// **Shapes**: operands `[n, c, h, w]`, weights `[n, 1, h, w]`. A weight holds for its pixel in every channel and is counted
    /// once, so that differences are summed over channels and averaged over pixels. Without any weight the value is 0.
    ///
    /// **Gradient**: `g w sign(self − other) / (Σ w + guard)` to `self`, the opposite to `other`; 0 where they are equal, exactly 0
    /// where the weight is 0, whatever is there; none to the weights.
    ///
    /// **Panics** when the shapes differ or `guard` is negative.
    #[track_caller]
    pub fn weighted_l1(self, other: Var<'t, T>, weights: &Tensor<T>, guard: f64) -> Var<'t, T> {
        let shape = self.shape();
        assert_same("weighted_l1", shape, other.shape());
        assert_same("weighted_l1 (weights)", shape.with_c(1), weights.shape());
        assert!(guard >= 0.0, "weighted_l1: the guard is not negative, got {guard}");
        let (a, b, weights) = (self.value(), other.value(), weights.clone());
        let [distance, weight] = sums(&a, &b, &weights);
        let inverse = if weight + guard == 0.0 { 0.0 } else { 1.0 / (weight + guard) };
        let y = Tensor::scalar(T::from_f64(distance * inverse));
        self.tape().push("weighted_l1", y, &[self, other], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
            let share = T::from_f64(g.item().to_f64() * inverse);
            let [mut to_a, mut to_b] = [0, 1].map(|k| grads.needs(k).then(|| grads.scratch(shape.len())));
            backward([&a, &b, &weights], share, to_a.as_deref_mut(), to_b.as_deref_mut());
            for (k, gradient) in [to_a, to_b].into_iter().enumerate() {
                if let (Some(mut slot), Some(gradient)) = (grads.slot(k), gradient) {
                    slot.add_fresh(gradient);
                }
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct WeightedL1(f64);

impl Twin for WeightedL1 {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].weighted_l1(v[1], &v[2].value(), self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let weight = |[n, _, h, w]: [usize; 4]| x[2].at([n, 0, h, w]);
        let chosen = || indices(x[0].shape).filter(|&i| weight(i).value() != 0.0);
        let size = |d: N| if d.value() < 0.0 { -d } else { d };
        let distance = total(chosen().map(|i| weight(i) * size(x[0].at(i) - x[1].at(i))));
        let weights: f64 = indices(x[2].shape).map(|i| x[2].at(i).value()).sum();
        let divisor = weights + self.0;
        Plain::from_fn(Shape::SCALAR, |_| if divisor == 0.0 { N::zero() } else { distance / N::constant(divisor) })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("weighted_l1");
    let mut cases = Vec::new();
    for (i, shape) in shapes(&mut draw).into_iter().enumerate() {
        let [a, b] = draw.apart(shape);
        let thirds = draw.whole(shape.with_c(1), 4);
        // One pixel counts at least.
        let weights = thirds.data().iter().enumerate().map(|(k, x)| if k == 0 { 1.0 } else { x / 3.0 }).collect();
        let case = Case::new(WeightedL1([0.0, 1e-3, 0.5][i % 3]), [a, b, Tensor::from_vec(thirds.shape(), weights)]);
        cases.push(match i {
            6 => case.constant(2).constant(0),
            7 => case.constant(2).constant(1),
            _ => case.constant(2),
        });
    }
    Proof::new("weighted_l1", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::ops::testing::{self, close, random, row};
    use crate::{Shape, Tape, Tensor, Var, par};

    #[test]
    fn value_and_slopes_are_known_and_a_pixel_counts_once() {
        let tape = Tape::new();
        let map = |x: &[f64]| tape.leaf(Tensor::from_vec(Shape::new(1, 2, 1, 3), x.to_vec()));
        let (a, b) = (map(&[1.0, 2.0, f64::NAN, 0.0, 5.0, f64::INFINITY]), map(&[3.0, 2.0, 0.0, -1.0, 4.0, 0.0]));
        let y = a.weighted_l1(b, &row(&[1.0, 0.5, 0.0]), 0.5);
        close(y.value().data(), &[(2.0 + 1.0 + 0.5) / 2.0]);
        let grads = tape.backward(y.scale(4.0));
        assert_eq!(grads.wrt(a).data(), [-2.0, 0.0, 0.0, 2.0, 1.0, 0.0]);
        assert_eq!(grads.wrt(b).data(), [2.0, 0.0, 0.0, -2.0, -1.0, 0.0]);
    }

    #[test]
    fn without_weights_there_is_nothing_and_chosen_nan_shows() {
        let tape = Tape::new();
        let (a, b) = (tape.leaf(row(&[1.0, f64::NAN])), tape.leaf(row(&[3.0, 2.0])));
        let nothing = a.weighted_l1(b, &row(&[0.0, 0.0]), 0.0);
        assert_eq!(nothing.value().item(), 0.0);
        assert_eq!(tape.backward(nothing).wrt(a).data(), [0.0, 0.0]);
        assert!(a.weighted_l1(b, &row(&[0.0, 1.0]), 0.0).value().item().is_nan());
    }

    #[test]
    #[should_panic(expected = "weighted_l1 (weights): operands must have equal shapes, got [1, 1, 4, 5] and [1, 2, 4, 5]")]
    fn weights_for_every_channel_are_refused() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::zeros(Shape::new(1, 2, 4, 5)));
        x.weighted_l1(x, &Tensor::zeros(x.shape()), 0.0);
    }

    /// The loss as one operation or as many.
    type Form = for<'t> fn(Var<'t, f64>, Var<'t, f64>, &Tensor<f64>, f64) -> Var<'t, f64>;

    /// The same of small operations.
    fn composed<'t>(a: Var<'t, f64>, b: Var<'t, f64>, weights: &Tensor<f64>, guard: f64) -> Var<'t, f64> {
        let spread = a.tape().constant(weights.clone()).broadcast_to(a.shape());
        let count: f64 = weights.data().iter().sum();
        a.sub(b).abs().mul(spread).sum().scale(1.0 / (count + guard))
    }

    #[test]
    fn it_equals_the_composed_form_over_several_pieces() {
        let shape = Shape::new(2, 3, 173, 199);
        let plane = shape.plane();
        assert!(plane > 2 * par::CHUNK && !plane.is_multiple_of(8));
        let inputs = [1, 2].map(|seed| random::<f64>(seed, shape, -1.0, 1.0));
        let weights = random::<f64>(3, shape.with_c(1), -0.5, 1.0);
        let weights = Tensor::from_vec(weights.shape(), weights.data().iter().map(|x| x.max(0.0)).collect());
        let run = |form: Form| {
            let tape = Tape::new();
            let [a, b] = inputs.each_ref().map(|x| tape.leaf(x.clone()));
            let y = form(a, b, &weights, 1e-3).square();
            let grads = tape.backward(y);
            [y.value(), grads.wrt(a), grads.wrt(b)]
        };
        for (fused, composed) in run(|a, b, w, guard| a.weighted_l1(b, w, guard)).iter().zip(&run(composed)) {
            for (f, c) in fused.data().iter().zip(composed.data()) {
                assert!((f - c).abs() <= 1e-10 * c.abs(), "{f} and {c}");
            }
        }
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(shape in testing::shapes(), seed in any::<u64>()) {
            let (a, gap) = (random::<f64>(seed, shape, -1.0, 1.0), random::<f64>(seed ^ 1, shape, -1.0, 1.0));
            let apart = a.data().iter().zip(gap.data()).map(|(a, gap)| a + gap + 0.5_f64.copysign(*gap)).collect();
            let weights = random(seed ^ 2, shape.with_c(1), 0.1, 1.0);
            testing::check(&[a, Tensor::from_vec(shape, apart)], |v| v[0].weighted_l1(v[1], &weights, 0.1));
        }
    }
}
