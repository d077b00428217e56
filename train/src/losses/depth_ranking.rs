//! Confident depth ranking: where the pseudo-depth says clearly which of two pixels is farther, the depth must agree
//! (SC-DepthV3; JiawangBian/sc_depth_pl, `losses/mask_ranking_loss.py`).
//!
//! **Formula**: for a pair of pixels, `l = 1` when `D*_a / D*_b > 1.15`, `l = -1` when `D*_b / D*_a > 1.15`, else the pair is
//! dropped; its loss is `ln(1 + exp(-l (D_a - D_b)))` of the raw depths. Global pairs are the same for every sample of a batch:
//! the `k`-th pixel of a random mask with the `k`-th pixel of its permutation. Dynamic pairs combine every unreliable pixel, one
//! of the fifth with the lowest static weight, with a random reliable one; there the first comparison is `>= 1.15`. The loss is
//! the sum over all pairs that are kept divided by their number, 0 when there are none.
//!
//! **Gradient**: to the depth only; bounded by 1 a pair.
//!
//! One fused operation: value and slopes come from one pass over the pairs, since the gradient of a mean is known up to a factor
//! beforehand; only the slopes are kept.

use dimode_autodiff::ops::kernel;
use dimode_autodiff::{GradSink, Scalar, Shape, Tensor, Var, par, rng};
use pulp::{Arch, Simd, WithSimd};

/// Ratio of pseudo-depths from which on an order is trusted.
const RATIO: f64 = 1.15;
/// Share of the pixels that are in the random mask of the global pairs.
const MASKED: f64 = 0.1;
/// Share of the pixels that count as unreliable.
const UNRELIABLE: f64 = 0.2;

/// Pairs that are worked on together.
const BLOCK: usize = 256;
/// Partial sums of a block.
const LANES: usize = 8;

/// Two flat pixel indices.
pub type Pair = [usize; 2];

/// Global pairs of a mask in reading order with its permutation `permuted[i] = mask[permutation[i]]`.
///
/// # Panics
/// When a position lies outside of the mask.
#[must_use]
#[track_caller]
pub fn global_pairs(mask: &[bool], permutation: &[usize]) -> Vec<Pair> {
    let first = (0..mask.len()).filter(|&i| mask[i]);
    let second = (0..permutation.len()).filter(|&i| mask[permutation[i]]);
    first.zip(second).map(|(a, b)| [a, b]).collect()
}

/// Global pairs in a map of `pixels` pixels from a seed: a tenth of them against as many others.
#[must_use]
pub fn random_global_pairs(pixels: usize, seed: u64) -> Vec<Pair> {
    let numbers = rng::uniform::<f64>(seed, Shape::new(1, 1, 2, pixels.max(1)), 0.0, 1.0);
    let (chosen, keys) = numbers.data().split_at(pixels.max(1));
    let mask: Vec<bool> = chosen[..pixels].iter().map(|&x| x < MASKED).collect();
    let mut permutation: Vec<usize> = (0..pixels).collect();
    permutation.sort_by(|&a, &b| keys[a].total_cmp(&keys[b]));
    global_pairs(&mask, &permutation)
}

/// The lowest fifth of the static weights of a sample, rounded down in number; of equal ones the first.
#[must_use]
pub fn unreliable<T: Scalar>(weights: &[T]) -> Vec<bool> {
    let mut order: Vec<usize> = (0..weights.len()).collect();
    order.sort_by(|&a, &b| weights[a].to_f64().total_cmp(&weights[b].to_f64()));
    let mut low = vec![false; weights.len()];
    for &i in &order[..(UNRELIABLE * weights.len() as f64) as usize] {
        low[i] = true;
    }
    low
}

/// Every unreliable pixel with a reliable one: `picks` are places in the list of the reliable pixels in reading order.
///
/// # Panics
/// When a pick lies beyond that list.
#[must_use]
#[track_caller]
pub fn dynamic_pairs(unreliable: &[bool], picks: &[usize]) -> Vec<Pair> {
    let which = |low: bool| (0..unreliable.len()).filter(move |&i| unreliable[i] == low);
    let reliable: Vec<usize> = which(false).collect();
    which(true).zip(picks).map(|(a, &pick)| [a, reliable[pick]]).collect()
}

/// Dynamic pairs of every sample of static weights `[n, 1, h, w]` from a seed.
#[must_use]
pub fn random_dynamic_pairs<T: Scalar>(weights: &Tensor<T>, seed: u64) -> Vec<Vec<Pair>> {
    let sample = |n: usize| {
        let low = unreliable(weights.plane(n, 0));
        let count = low.iter().filter(|&&x| x).count();
        let reliable = low.len() - count;
        let numbers = rng::uniform::<f64>(rng::splitmix64(seed, n as u64), Shape::new(1, 1, 1, count.max(1)), 0.0, 1.0);
        let pick = |&x: &f64| ((x * reliable as f64) as usize).min(reliable - 1);
        dynamic_pairs(&low, &numbers.data()[..count].iter().map(pick).collect::<Vec<_>>())
    };
    (0..weights.shape().n()).map(sample).collect()
}

/// The loss of depth `[n, 1, h, w]` against pseudo-depth of that shape; `global` pairs go with every sample, `dynamic` ones are
/// one list a sample (or none at all).
///
/// # Panics
/// When shapes differ or a pair lies outside of the map.
#[track_caller]
pub fn depth_ranking<'t, T: Scalar>(depth: Var<'t, T>, pseudo: &Tensor<T>, global: &[Pair], dynamic: &[Vec<Pair>]) -> Var<'t, T> {
    let shape = depth.shape();
    assert!(shape == pseudo.shape() && shape.c() == 1, "depth_ranking: depth {shape}, pseudo-depth {}", pseudo.shape());
    assert!(dynamic.is_empty() || dynamic.len() == shape.n(), "depth_ranking: {} lists for {shape}", dynamic.len());
    let (tape, depths, plane) = (depth.tape(), depth.value(), shape.plane());
    // Sums of the slopes of a pixel over its pairs.
    let mut slopes = tape.buffer(shape.len());
    let mut sums = vec![Sums::default(); shape.n()];
    par::for_each_item(slopes.chunks_mut(plane).zip(&mut sums).collect(), |n, (slopes, sums)| {
        let [depth, pseudo] = [depths.plane(n, 0), pseudo.plane(n, 0)];
        let dynamic = dynamic.get(n).map_or(&[][..], |pairs| pairs);
        for (pairs, limit_counts) in [(global, false), (dynamic, true)] {
            let part = Arch::new().dispatch(Ranking { pairs, limit_counts, depth, pseudo, slopes: &mut *slopes });
            *sums = Sums { loss: sums.loss + part.loss, pairs: sums.pairs + part.pairs };
        }
    });
    let slopes = tape.tensor(shape, slopes);
    let pairs: f64 = sums.iter().map(|sums| sums.pairs).sum();
    let inverse = if pairs == 0.0 { 0.0 } else { 1.0 / pairs };
    let value = sums.iter().map(|sums| sums.loss).sum::<f64>() * inverse;
    tape.push("depth_ranking", Tensor::scalar(T::from_f64(value)), &[depth], move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        let share = T::from_f64(g.item().to_f64() * inverse);
        if let Some(mut slot) = grads.slot(0) {
            slot.write(|out| match share == T::ZERO {
                true => out.fill(T::ZERO),
                false => kernel::map(out, slopes.data(), move |slope| {
                    let scaled = share * slope;
                    // A pixel without pairs has none, whatever comes in.
                    if slope == T::ZERO { T::ZERO } else { scaled }
                }),
            });
        }
    })
}

/// Sum of the losses of the pairs that are kept, and how many they are.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    loss: f64,
    pairs: f64,
}

/// Pairs of one sample: adds up their losses, and their slopes pixel by pixel.
struct Ranking<'a, T> {
    pairs: &'a [Pair],
    /// Whether a first ratio of exactly the limit counts.
    limit_counts: bool,
    depth: &'a [T],
    pseudo: &'a [T],
    slopes: &'a mut [T],
}

impl<T: Scalar> WithSimd for Ranking<'_, T> {
    type Output = Sums;
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Sums {
        let (mut loss, mut kept) = ([0.0; LANES], [0.0; LANES]);
        let mut depths = [[T::ZERO; BLOCK]; 2];
        let mut pseudo = [[T::ONE; BLOCK]; 2];
        let mut slopes = [T::ZERO; BLOCK];
        for pairs in self.pairs.chunks(BLOCK) {
            for (k, &[a, b]) in pairs.iter().enumerate() {
                depths[0][k] = self.depth[a];
                depths[1][k] = self.depth[b];
                pseudo[0][k] = self.pseudo[a];
                pseudo[1][k] = self.pseudo[b];
            }
            // Behind the last pair stand equal pseudo-depths, which nothing is made of.
            pseudo[0][pairs.len()..].fill(T::ONE);
            pseudo[1][pairs.len()..].fill(T::ONE);
            let [a, b] = &depths;
            for k in (0..BLOCK).step_by(LANES) {
                for l in 0..LANES {
                    let order = farther(pseudo[0][k + l].to_f64(), pseudo[1][k + l].to_f64(), self.limit_counts);
                    let sign = T::from_f64(order);
                    let [value, slope] = violation(sign * (b[k + l] - a[k + l]));
                    // What is dropped may hold anything.
                    loss[l] += if order == 0.0 { 0.0 } else { value.to_f64() };
                    kept[l] += order * order;
                    slopes[k + l] = if order == 0.0 { T::ZERO } else { sign * slope };
                }
            }
            for (&[a, b], &slope) in pairs.iter().zip(&slopes) {
                self.slopes[a] += -slope;
                self.slopes[b] += slope;
            }
        }
        Sums { loss: loss.iter().sum(), pairs: kept.iter().sum() }
    }
}

/// 1 where pseudo-depth `a` is clearly larger than `b`, -1 the other way, else 0.
#[inline(always)]
fn farther(a: f64, b: f64, limit_counts: bool) -> f64 {
    let (first, second) = (a / b, b / a);
    let otherwise = if second > RATIO { -1.0 } else { 0.0 };
    if (first > RATIO) | (limit_counts & (first == RATIO)) { 1.0 } else { otherwise }
}

/// `ln(1 + e^x)` and its slope `1 / (1 + e^-x)`; NaN stays NaN.
///
/// With `q = e^-|x|` in [0, 1] and `s = q / (2 + q)`, `ln(1 + q) = 2 (s + s^3 / 3 + s^5 / 5 + ..)`, where `s <= 1/3`: exact to
/// rounding, free of branches.
#[inline(always)]
fn violation<T: Scalar>(x: T) -> [T; 2] {
    let two = T::ONE + T::ONE;
    let q = (-x.abs()).exp();
    let s = q / (two + q);
    let square = s * s;
    let terms = if T::EPSILON.to_f64() > 1e-10 { 8 } else { 18 };
    let mut series = T::ZERO;
    for k in (0..terms).rev() {
        series = series * square + T::from_f64(1.0 / (2 * k + 1) as f64);
    }
    let rest = two * s * series;
    let inverse = T::ONE / (T::ONE + q);
    if x > T::ZERO { [x + rest, inverse] } else { [rest, q * inverse] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    /// The loss as one operation or as many.
    type Form = for<'t> fn(Var<'t, f64>, &Tensor<f64>, &[Pair], &[Vec<Pair>]) -> Var<'t, f64>;

    /// The formula in small operations.
    fn composed<'t>(depth: Var<'t, f64>, pseudo: &Tensor<f64>, global: &[Pair], dynamic: &[Vec<Pair>]) -> Var<'t, f64> {
        let losses = (0..depth.shape().n()).filter_map(|n| {
            let order = pseudo.plane(n, 0);
            let mut kept = trusted(order, global, |ratio| ratio > RATIO);
            kept.extend(dynamic.get(n).into_iter().flat_map(|pairs| trusted(order, pairs, |ratio| ratio >= RATIO)));
            (!kept.is_empty()).then(|| violations(depth.slice(0, n, 1), &kept))
        });
        Var::concat(&losses.collect::<Vec<_>>(), 3).mean()
    }

    /// The pairs whose order the pseudo-depth is sure of, the farther pixel first.
    fn trusted<T: Scalar>(pseudo: &[T], pairs: &[Pair], farther: fn(f64) -> bool) -> Vec<Pair> {
        let ratio = |a: usize, b: usize| pseudo[a].to_f64() / pseudo[b].to_f64();
        let order = |&[a, b]: &Pair| match () {
            () if farther(ratio(a, b)) => Some([a, b]),
            () if ratio(b, a) > RATIO => Some([b, a]),
            () => None,
        };
        pairs.iter().filter_map(order).collect()
    }

    /// `ln(1 + exp(D_near - D_far))` of pairs (far, near), `[1, 1, 1, k]`.
    #[track_caller]
    fn violations<'t, T: Scalar>(depth: Var<'t, T>, pairs: &[Pair]) -> Var<'t, T> {
        let flat = depth.reshape(Shape::new(1, 1, 1, depth.shape().len()));
        let at = |k: usize| {
            let index = pairs.iter().map(|pair| T::from_usize(pair[k])).collect();
            flat.gather(3, &Tensor::from_vec(Shape::new(1, 1, 1, pairs.len()), index))
        };
        at(1).sub(at(0)).log1p_exp()
    }

    #[test]
    fn it_equals_the_composed_form() {
        let shape = Shape::new(3, 1, 40, 53);
        let (depth, pseudo) = (random(1, shape, -4.0, 9.0), random::<f64>(2, shape, 1.0, 1.6));
        let global = random_global_pairs(shape.plane(), 3);
        let dynamic = random_dynamic_pairs(&random::<f64>(4, shape, 0.0, 1.0), 5);
        assert!(!global.len().is_multiple_of(BLOCK) && dynamic[0].len() > BLOCK);
        let run = |form: Form| {
            let tape = Tape::new();
            let leaf = tape.leaf(depth.clone());
            let loss = form(leaf, &pseudo, &global, &dynamic).scale(3.0);
            [loss.value(), tape.backward(loss).wrt(leaf)]
        };
        for (fused, composed) in run(depth_ranking).iter().zip(&run(composed)) {
            let signal = composed.data().iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            for (f, c) in fused.data().iter().zip(composed.data()) {
                assert!((f - c).abs() <= 1e-12 * signal, "{f} and {c}");
            }
        }
    }

    #[test]
    fn violations_are_exact_in_both_types_and_nan_shows() {
        for x in (-400..=400).map(|i| f64::from(i) * 0.1) {
            let wanted = [x.max(0.0) + (-x.abs()).exp().ln_1p(), 1.0 / (1.0 + (-x).exp())];
            let single = f64::from(x as f32);
            let wanted_single = [single.max(0.0) + (-single.abs()).exp().ln_1p(), 1.0 / (1.0 + (-single).exp())];
            for k in 0..2 {
                assert!((violation(x)[k] / wanted[k] - 1.0).abs() < 1e-14, "{x}");
                assert!((f64::from(violation(x as f32)[k]) / wanted_single[k] - 1.0).abs() < 5e-7, "{x}");
            }
        }
        assert!(violation(f64::NAN).iter().all(|x| x.is_nan()));
    }

    #[test]
    fn dropped_pairs_may_hold_anything() {
        let row = |x: &[f64]| Tensor::from_vec(Shape::new(1, 1, 1, 4), x.to_vec());
        let tape = Tape::new();
        let depth = tape.leaf(row(&[1.0, 3.0, f64::NAN, f64::INFINITY]));
        let loss = depth_ranking(depth, &row(&[2.0, 1.0, 1.0, 1.0]), &[[0, 1], [1, 2], [2, 3]], &[]);
        assert!((loss.value().item() - 2.0_f64.exp().ln_1p()).abs() < 1e-14);
        assert_eq!(tape.backward(loss).wrt(depth).data()[2..], [0.0, 0.0]);
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let shape = Shape::new(3, 1, 40, 53);
        let (depth, pseudo) = (random::<f32>(1, shape, 1.0, 9.0), random(2, shape, 1.0, 1.6));
        let global = random_global_pairs(shape.plane(), 3);
        let run = |threads| {
            par::with_threads(threads, || {
                let tape = Tape::new();
                let leaf = tape.leaf(depth.clone());
                let loss = depth_ranking(leaf, &pseudo, &global, &[]);
                (loss.value().item().to_bits(), tape.backward(loss).wrt(leaf).to_vec())
            })
        };
        assert!((2..5).all(|threads| run(threads) == run(1)));
    }

    #[test]
    fn worked_value_with_a_dropped_pair() {
        let row = |x: &[f64]| Tensor::from_vec(Shape::new(1, 1, 1, 4), x.to_vec());
        let tape = Tape::new();
        let depth = tape.leaf(row(&[1.0, 3.0, 2.0, 9.0]));
        let pseudo = row(&[2.0, 1.0, 2.2, 8.0]);
        // (0, 1): farther says 0, the depth says 1: ln(1 + e^2). (0, 2): ratio 1.1, dropped. (2, 3): ln(1 + e^-7).
        let loss = depth_ranking(depth, &pseudo, &[[0, 1], [0, 2]], &[vec![[2, 3]]]);
        let expected = (2.0_f64.exp().ln_1p() + (-7.0_f64).exp().ln_1p()) / 2.0;
        assert!((loss.value().item() - expected).abs() < 1e-14);
        let slope = 0.5 / (1.0 + (-2.0_f64).exp());
        let grad = tape.backward(loss).wrt(depth);
        assert!((grad.data()[1] - slope).abs() < 1e-14 && (grad.data()[0] + slope).abs() < 1e-14);
    }

    #[test]
    fn the_limit_itself_counts_in_dynamic_pairs_only() {
        let (far, near) = (RATIO, 1.0);
        assert_eq!([false, true].map(|counts| farther(far, near, counts)), [0.0, 1.0]);
        assert_eq!([false, true].map(|counts| farther(near, far, counts)), [0.0, 0.0]);
        assert_eq!([farther(1.2, near, false), farther(near, 1.2, true)], [1.0, -1.0]);
        let pseudo = [RATIO, 1.0];
        assert_eq!(trusted(&pseudo, &[[0, 1]], |ratio| ratio > RATIO), Vec::<Pair>::new());
        assert_eq!(trusted(&pseudo, &[[0, 1]], |ratio| ratio >= RATIO), [[0, 1]]);
        assert_eq!(trusted(&pseudo, &[[1, 0]], |ratio| ratio >= RATIO), Vec::<Pair>::new());
    }

    #[test]
    fn no_trusted_pair_costs_nothing() {
        let tape = Tape::<f64>::new();
        let depth = tape.leaf(random(1, Shape::new(2, 1, 3, 4), 1.0, 2.0));
        let flat = Tensor::full(depth.shape(), 3.0);
        let loss = depth_ranking(depth, &flat, &[[0, 1], [5, 7]], &[]);
        assert_eq!(loss.value().item(), 0.0);
        assert!(tape.backward(loss).wrt(depth).data().iter().all(|&g| g == 0.0));
    }

    #[test]
    fn gradient_matches_finite_differences_and_other_pixels_get_none() {
        let depth = random(1, Shape::new(2, 1, 5, 6), 1.0, 3.0);
        let pseudo = random::<f64>(2, Shape::new(2, 1, 5, 6), 1.0, 3.0);
        let weights = random::<f64>(3, Shape::new(2, 1, 5, 6), 0.0, 1.0);
        let global = [[1, 9], [12, 4], [3, 28]];
        let dynamic = random_dynamic_pairs(&weights, 5);
        gradcheck(std::slice::from_ref(&depth), |_, v| depth_ranking(v[0], &pseudo, &global, &dynamic), GradCheck::default())
            .assert_ok();
        let tape = Tape::new();
        let leaf = tape.leaf(depth);
        let grad = tape.backward(depth_ranking(leaf, &pseudo, &global, &[])).wrt(leaf);
        let touched: Vec<usize> = global.concat();
        assert!((0..30).all(|i| touched.contains(&i) || grad.plane(0, 0)[i] == 0.0));
    }

    #[test]
    fn masks_pair_with_their_permutation_and_the_lowest_fifth_is_unreliable() {
        let mask = [true, false, true, false, false];
        assert_eq!(global_pairs(&mask, &[4, 2, 1, 3, 0]), [[0, 1], [2, 4]]);
        let low = unreliable(&[0.5, 0.1, 0.9, 0.2, 0.3, 0.8, 0.7, 0.6, 0.1, 0.4]);
        assert_eq!(low.iter().enumerate().filter(|(_, l)| **l).map(|(i, _)| i).collect::<Vec<_>>(), [1, 8]);
        assert_eq!(dynamic_pairs(&low, &[0, 7]), [[1, 0], [8, 9]]);
    }

    #[test]
    fn seeds_decide_the_pairs() {
        let pairs = random_global_pairs(1000, 1);
        assert_eq!(pairs, random_global_pairs(1000, 1));
        assert_ne!(pairs, random_global_pairs(1000, 2));
        assert!((60..140).contains(&pairs.len()) && pairs.iter().flatten().all(|&i| i < 1000));
        let weights = random::<f32>(3, Shape::new(2, 1, 10, 10), 0.0, 1.0);
        let dynamic = random_dynamic_pairs(&weights, 1);
        assert!(dynamic.iter().all(|d| d.len() == 20) && dynamic[0] != dynamic[1]);
        assert_eq!(dynamic, random_dynamic_pairs(&weights, 1));
    }
}
