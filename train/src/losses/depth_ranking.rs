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

use dimode_autodiff::{Scalar, Shape, Tensor, Var, rng};

/// Ratio of pseudo-depths from which on an order is trusted.
const RATIO: f64 = 1.15;
/// Share of the pixels that are in the random mask of the global pairs.
const MASKED: f64 = 0.1;
/// Share of the pixels that count as unreliable.
const UNRELIABLE: f64 = 0.2;

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
    let losses = (0..shape.n()).filter_map(|n| {
        let order = pseudo.plane(n, 0);
        let mut kept = trusted(order, global, |ratio| ratio > RATIO);
        kept.extend(dynamic.get(n).into_iter().flat_map(|pairs| trusted(order, pairs, |ratio| ratio >= RATIO)));
        (!kept.is_empty()).then(|| violations(depth.slice(0, n, 1), &kept))
    });
    let losses: Vec<_> = losses.collect();
    if losses.is_empty() {
        return depth.scale(0.0).sum();
    }
    Var::concat(&losses, 3).mean()
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

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

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
