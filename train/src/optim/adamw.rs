//! Adam with decoupled weight decay (Loshchilov and Hutter 2019).
//!
//! `m <- b1 m + (1 - b1) g`, `v <- b2 v + (1 - b2) g^2`, `w <- w - lr (decay w + m^ / (sqrt(v^) + eps))` with bias-corrected
//! `m^ = m / (1 - b1^t)`, `v^ = v / (1 - b2^t)`.
//!
//! Numbers below 1e-30 become 0: moments of a weight without gradient decay into subnormal numbers otherwise, which slow every
//! later step.
//!
//! Weights and moments change in place. [`AdamW::keeps_usable`] says beforehand whether they will be of use; where
//! [`AdamW::surely_keeps_usable`] says so from the sizes that the last step left, nothing has to be read for it.

use std::collections::BTreeMap;

use dimode_autodiff::simd::{Arch, Simd, Wide, WithSimd};
use dimode_autodiff::{Tensor, par};

/// Settings; the defaults are those of the paper's optimiser (PyTorch's betas and epsilon).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamW {
    /// Decay of the two moments.
    pub betas: [f64; 2],
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Decoupled weight decay.
    pub weight_decay: f64,
}

impl Default for AdamW {
    fn default() -> Self {
        AdamW { betas: [0.9, 0.999], epsilon: 1e-8, weight_decay: 1e-2 }
    }
}

/// Moments of one parameter tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Steps taken.
    pub steps: u64,
    /// First moment.
    pub first: Tensor<f32>,
    /// Second moment.
    pub second: Tensor<f32>,
}

/// Largest magnitudes of a parameter and of its first moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Largest {
    /// Of the weights.
    pub weight: f32,
    /// Of the first moment.
    pub first: f32,
}

/// Moments of all parameters, by path.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State(pub BTreeMap<String, Moments>);

/// Weights up to this size are of use, and far from those that are not.
const TAME: f64 = 1e18;

/// What moments are before the first step.
static ZEROS: [f32; par::CHUNK] = [0.0; par::CHUNK];

impl AdamW {
    /// Takes one step of the parameter at `path`. `gradient` is multiplied by `scale` first (clipping). Returns the sizes after it.
    ///
    /// # Panics
    /// When sizes differ.
    pub fn step(
        &self,
        state: &mut State,
        path: &str,
        value: &mut [f32],
        gradient: &Tensor<f32>,
        learning_rate: f64,
        scale: f64,
    ) -> Largest {
        assert_size(path, value, gradient);
        let zeros = || Tensor::zeros(gradient.shape());
        if !state.0.contains_key(path) {
            state.0.insert(path.to_owned(), Moments { steps: 0, first: zeros(), second: zeros() });
        }
        let moments = state.0.get_mut(path).expect("just put there");
        moments.steps += 1;
        let rule = Rule::new(self, moments.steps, learning_rate, scale);
        let (first, second) = (moments.first.make_mut(), moments.second.make_mut());
        if value.len() <= par::CHUNK {
            return Arch::new().dispatch(Update { rule, m: first, v: second, w: value, g: gradient.data() });
        }
        let rows: Vec<_> = first
            .chunks_mut(par::CHUNK)
            .zip(second.chunks_mut(par::CHUNK))
            .zip(value.chunks_mut(par::CHUNK).zip(gradient.data().chunks(par::CHUNK)))
            .collect();
        let mut largest = vec![Largest { weight: 0.0, first: 0.0 }; rows.len()];
        let rows = rows.into_iter().zip(&mut largest).collect();
        par::for_each_item(rows, |_, (((m, v), (w, g)), largest)| {
            *largest = Arch::new().dispatch(Update { rule, m, v, w, g });
        });
        let join = |a: Largest, b: Largest| Largest { weight: a.weight.max(b.weight), first: a.first.max(b.first) };
        largest.into_iter().reduce(join).unwrap_or(Largest { weight: 0.0, first: 0.0 })
    }

    /// Whether a step must leave weights with finite squares, by sizes alone: those that the last of `steps` steps left, which was
    /// [usable](AdamW::keeps_usable), and a bound of all entries of the gradient. `false` says nothing.
    pub fn surely_keeps_usable(&self, largest: Largest, steps: u64, gradient: f64, learning_rate: f64) -> bool {
        let rule = Rule::new(self, steps + 1, learning_rate, 1.0);
        // The second moment is not negative after a usable step, so the divisor is epsilon at least.
        let first = f64::from(largest.first) + gradient;
        let moved = f64::from(rule.rate).abs() * first / self.epsilon;
        f64::from(largest.weight) * f64::from(rule.keep).abs() + moved <= TAME
    }

    /// Whether after the same step every weight has a finite square, without which nothing can be computed with it. Changes
    /// nothing.
    ///
    /// # Panics
    /// When sizes differ.
    pub fn keeps_usable(
        &self,
        state: &State,
        path: &str,
        value: &[f32],
        gradient: &Tensor<f32>,
        learning_rate: f64,
        scale: f64,
    ) -> bool {
        assert_size(path, value, gradient);
        let old = state.0.get(path);
        let rule = Rule::new(self, old.map_or(0, |m| m.steps) + 1, learning_rate, scale);
        let parts = par::map_indices(value.len().div_ceil(par::CHUNK), |i| {
            let part = i * par::CHUNK..value.len().min((i + 1) * par::CHUNK);
            let moment = |of: fn(&Moments) -> &Tensor<f32>| match old {
                Some(moments) => &of(moments).data()[part.clone()],
                None => &ZEROS[..part.len()],
            };
            let (m, v) = (moment(|m| &m.first), moment(|m| &m.second));
            Arch::new().dispatch(Look { rule, m, v, w: &value[part.clone()], g: &gradient.data()[part.clone()] })
        });
        parts.into_iter().all(|usable| usable)
    }
}

/// Whether all numbers can be squared.
pub fn has_finite_squares(numbers: &[f32]) -> bool {
    numbers.iter().all(|x| (x * x).is_finite())
}

#[track_caller]
fn assert_size(path: &str, value: &[f32], gradient: &Tensor<f32>) {
    let shape = gradient.shape();
    assert!(shape.len() == value.len(), "adamw: {path} has {} entries, its gradient {shape}", value.len());
}

/// The numbers of one step.
#[derive(Clone, Copy)]
struct Rule {
    scale: f32,
    b1: f32,
    b2: f32,
    rate: f32,
    keep: f32,
    root: f32,
    epsilon: f32,
}

impl Rule {
    fn new(settings: &AdamW, steps: u64, learning_rate: f64, scale: f64) -> Self {
        let [b1, b2] = settings.betas;
        let power = steps.min(i32::MAX as u64) as i32;
        Rule {
            scale: scale as f32,
            b1: b1 as f32,
            b2: b2 as f32,
            rate: (learning_rate / (1.0 - b1.powi(power))) as f32,
            keep: (1.0 - learning_rate * settings.weight_decay) as f32,
            root: (1.0 / (1.0 - b2.powi(power))) as f32,
            epsilon: settings.epsilon as f32,
        }
    }

    /// Moments and weight after the step. Nothing is fused: the bits are the same for every instruction set.
    #[inline(always)]
    fn next<S: Simd>(self, [m, v, w, g]: [Wide<S, f32>; 4]) -> [Wide<S, f32>; 3] {
        let g = g * w.like(self.scale);
        let m = flush(w.like(self.b1) * m + w.like(1.0 - self.b1) * g);
        let v = flush(w.like(self.b2) * v + w.like(1.0 - self.b2) * g * g);
        let divisor = (v * w.like(self.root)).sqrt() + w.like(self.epsilon);
        [m, v, flush(w * w.like(self.keep) - w.like(self.rate) * m / divisor)]
    }
}

/// 0 in place of what is on its way to the subnormal numbers.
#[inline(always)]
fn flush<S: Simd>(x: Wide<S, f32>) -> Wide<S, f32> {
    x.abs().less(x.like(1e-30)).choose(x.like(0.0), x)
}

/// The start of all four slices, at most one register of each.
#[inline(always)]
fn load<S: Simd>(simd: S, x: [&[f32]; 4], at: usize) -> [Wide<S, f32>; 4] {
    let [m, v, w, g] = x;
    if at + Wide::<S, f32>::lanes() <= g.len() {
        [Wide::load(simd, &m[at..]), Wide::load(simd, &v[at..]), Wide::load(simd, &w[at..]), Wide::load(simd, &g[at..])]
    } else {
        [
            Wide::load_part(simd, &m[at..]),
            Wide::load_part(simd, &v[at..]),
            Wide::load_part(simd, &w[at..]),
            Wide::load_part(simd, &g[at..]),
        ]
    }
}

/// A step of some weights.
struct Update<'a> {
    rule: Rule,
    m: &'a mut [f32],
    v: &'a mut [f32],
    w: &'a mut [f32],
    g: &'a [f32],
}

impl WithSimd for Update<'_> {
    type Output = Largest;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Largest {
        let Self { rule, m, v, w, g } = self;
        let (lanes, len) = (Wide::<S, f32>::lanes(), g.len());
        let mut largest = [Wide::splat(simd, 0.0_f32); 2];
        for at in (0..len).step_by(lanes) {
            let [next_m, next_v, next_w] = rule.next(load(simd, [m, v, w, g], at));
            largest = [largest[0].max(next_w.abs()), largest[1].max(next_m.abs())];
            if at + lanes <= len {
                next_m.store(&mut m[at..]);
                next_v.store(&mut v[at..]);
                next_w.store(&mut w[at..]);
            } else {
                next_m.store_part(&mut m[at..]);
                next_v.store_part(&mut v[at..]);
                next_w.store_part(&mut w[at..]);
            }
        }
        let [weight, first] = largest.map(most);
        Largest { weight, first }
    }
}

/// The largest of some lanes that are not negative.
#[inline(always)]
fn most<S: Simd>(x: Wide<S, f32>) -> f32 {
    let mut lanes = [0.0; 64];
    x.store(&mut lanes);
    lanes.into_iter().fold(0.0, f32::max)
}

/// Whether a step of some weights leaves finite squares.
struct Look<'a> {
    rule: Rule,
    m: &'a [f32],
    v: &'a [f32],
    w: &'a [f32],
    g: &'a [f32],
}

impl WithSimd for Look<'_> {
    type Output = bool;
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let Self { rule, m, v, w, g } = self;
        let (lanes, len) = (Wide::<S, f32>::lanes(), g.len());
        let mut failed = Wide::splat(simd, 0.0_f32);
        let mut last = [0.0; 64];
        for at in (0..len).step_by(lanes) {
            let [_, _, w] = rule.next(load(simd, [m, v, w, g], at));
            if at + lanes <= len {
                // Neither infinity nor NaN is at most the largest number.
                failed = (w * w).at_most(w.like(f32::MAX)).choose(failed, w.like(1.0));
            } else {
                w.store_part(&mut last[..len - at]);
            }
        }
        failed.sum() == 0.0 && has_finite_squares(&last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;

    fn run(gradients: &[f32], settings: AdamW, rate: f64) -> (f32, State) {
        let mut state = State::default();
        let mut w = [1.0];
        for &g in gradients {
            settings.step(&mut state, "w", &mut w, &Tensor::full(Shape::SCALAR, g), rate, 1.0);
        }
        (w[0], state)
    }

    #[test]
    fn two_worked_steps() {
        // By hand, in f64: m = 0.05, 0.055...; the first step moves by lr * (decay + 1).
        let (after_one, _) = run(&[0.5], AdamW::default(), 0.1);
        assert!((after_one - (1.0 - 0.1 * 0.01 - 0.1)).abs() < 1e-6, "{after_one}");
        let (after_two, _) = run(&[0.5, -0.25], AdamW::default(), 0.1);
        let w = 0.899_f64;
        let m: f64 = (0.9 * 0.05 - 0.1 * 0.25) / (1.0 - 0.81);
        let v: f64 = (0.999 * 0.00025 + 0.001 * 0.0625) / (1.0 - 0.999 * 0.999);
        let want = w * (1.0 - 0.001) - 0.1 * m / (v.sqrt() + 1e-8);
        assert!((f64::from(after_two) - want).abs() < 1e-6, "{after_two} against {want}");
    }

    /// The rule for one number, as the formulas have it.
    fn one(settings: &AdamW, steps: u64, [m, v, w, g]: [f32; 4], rate: f64) -> [f32; 3] {
        let rule = Rule::new(settings, steps, rate, 0.5);
        let flush = |x: f32| if x.abs() < 1e-30 { 0.0 } else { x };
        let g = g * rule.scale;
        let m = flush(rule.b1 * m + (1.0 - rule.b1) * g);
        let v = flush(rule.b2 * v + (1.0 - rule.b2) * g * g);
        [m, v, flush(w * rule.keep - rule.rate * m / ((v * rule.root).sqrt() + rule.epsilon))]
    }

    #[test]
    fn every_weight_moves_by_the_rule_on_any_number_of_threads() {
        let shape = Shape::new(1, 1, 1, par::CHUNK + 45);
        let settings = AdamW { epsilon: 0.0, ..AdamW::default() };
        let start: Tensor<f32> = dimode_autodiff::rng::uniform(1, shape, -1.0, 1.0);
        let gradients = [2, 3].map(|seed| dimode_autodiff::rng::uniform::<f32>(seed, shape, -1.0, 1.0));
        let after = |threads: usize| {
            let (mut state, mut w) = (State::default(), start.to_vec());
            par::with_threads(threads, || {
                for gradient in &gradients {
                    assert!(settings.keeps_usable(&state, "w", &w, gradient, 0.01, 0.5));
                    settings.step(&mut state, "w", &mut w, gradient, 0.01, 0.5);
                }
            });
            let Moments { first, second, .. } = &state.0["w"];
            [first.to_vec(), second.to_vec(), w]
        };
        let found = after(1);
        for threads in 2..5 {
            assert_eq!(after(threads), found);
        }
        let [first, second, weights] = &found;
        for (i, ((m, v), w)) in first.iter().zip(second).zip(weights).enumerate() {
            let [m1, v1, w1] = one(&settings, 1, [0.0, 0.0, start.data()[i], gradients[0].data()[i]], 0.01);
            let want = one(&settings, 2, [m1, v1, w1, gradients[1].data()[i]], 0.01);
            assert_eq!([*m, *v, *w].map(f32::to_bits), want.map(f32::to_bits), "entry {i}");
        }
    }

    #[test]
    fn one_weight_beyond_use_is_found_wherever_it_is() {
        let (settings, len) = (AdamW::default(), par::CHUNK + 45);
        for i in [0, 17, par::CHUNK - 1, par::CHUNK + 3, len - 1] {
            for bad in [1e30, f32::NAN, f32::NEG_INFINITY] {
                let mut w = vec![0.5; len];
                w[i] = bad;
                let gradient = Tensor::full(Shape::new(1, 1, 1, len), 0.1);
                assert!(!settings.keeps_usable(&State::default(), "w", &w, &gradient, 0.1, 1.0), "{bad} at {i}");
                let (w, mut steep) = (vec![0.5; len], vec![0.1; len]);
                steep[i] = bad;
                let steep = Tensor::from_vec(gradient.shape(), steep);
                let usable = settings.keeps_usable(&State::default(), "w", &w, &steep, 0.1, 1.0);
                assert_eq!(usable, bad == 1e30, "a gradient of {bad} at {i}");
            }
        }
    }

    /// Steep and flat gradients, small and large rates, weight decay that grows weights: what is promised is always kept.
    #[test]
    fn what_sizes_alone_promise_holds_and_is_promised_in_ordinary_training() {
        let (shape, seeds) = (Shape::new(1, 1, 1, 45), 0..400);
        let (mut sure, mut broken) = (0, 0);
        for seed in seeds {
            let draw = |k: u64| dimode_autodiff::rng::uniform::<f32>(10 * seed + k, shape, -1.0, 1.0);
            let power = |k: u64, reach: f64| 10_f64.powf(reach * f64::from(draw(k).data()[0]));
            let settings = AdamW { epsilon: power(1, 12.0), weight_decay: power(2, 3.0), ..AdamW::default() };
            let (mut state, mut w) = (State::default(), draw(3).to_vec());
            let mut largest = None;
            for k in 0..3 {
                let size = power(4 + k, 20.0) as f32;
                let gradient = Tensor::from_fn(shape, |_, _, _, j| size * draw(7).data()[j]);
                let (rate, bound) = (power(8, 20.0), f64::from(size));
                let kept = settings.keeps_usable(&state, "w", &w, &gradient, rate, 1.0);
                let promised = largest.is_some_and(|largest| settings.surely_keeps_usable(largest, k, bound, rate));
                assert!(kept || !promised, "seed {seed}, step {k}: {largest:?}");
                sure += usize::from(promised);
                broken += usize::from(!kept);
                if !kept {
                    break;
                }
                let found = settings.step(&mut state, "w", &mut w, &gradient, rate, 1.0);
                let most = |x: &[f32]| x.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
                assert_eq!(found, Largest { weight: most(&w), first: most(state.0["w"].first.data()) });
                largest = Some(found);
            }
        }
        assert!(sure > 50 && broken > 50, "{sure} promises, {broken} steps beyond use");
        // Small weights and a small first moment, but a steep gradient at a huge rate.
        let settings = AdamW { weight_decay: 0.0, ..AdamW::default() };
        let (mut state, mut w) = (State::default(), [0.5]);
        let [flat, steep] = [1e-20, 1.0].map(|g| Tensor::full(Shape::SCALAR, g));
        assert!(settings.keeps_usable(&state, "w", &w, &flat, 1e20, 1.0));
        let largest = settings.step(&mut state, "w", &mut w, &flat, 1e20, 1.0);
        assert!(f64::from(largest.weight) < 1e9 && !settings.keeps_usable(&state, "w", &w, &steep, 1e20, 1.0));
        assert!(!settings.surely_keeps_usable(largest, 1, 1.0, 1e20));
        // Weights that decay to many times their size.
        let growing = AdamW { weight_decay: 1e6, ..AdamW::default() };
        assert!(!growing.surely_keeps_usable(Largest { weight: 1e10, first: 0.0 }, 1, 0.0, 1e10));
        let usual = Largest { weight: 30.0, first: 1e3 };
        assert!(AdamW::default().surely_keeps_usable(usual, 7, 1e4, 1e-2));
    }

    #[test]
    fn moments_without_gradient_never_become_subnormal() {
        let mut gradients = vec![0.0; 3000];
        gradients[0] = 1e-3;
        let (_, state) = run(&gradients, AdamW::default(), 1e-3);
        let moments = &state.0["w"];
        for x in [moments.first.item(), moments.second.item()] {
            assert!(x == 0.0 || x.is_normal(), "{x:e}");
        }
        assert_eq!(moments.first.item(), 0.0);
    }
}
