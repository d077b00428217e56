//! Adam with decoupled weight decay (Loshchilov and Hutter 2019).
//!
//! `m <- b1 m + (1 - b1) g`, `v <- b2 v + (1 - b2) g^2`, `w <- w - lr (decay w + m^ / (sqrt(v^) + eps))` with bias-corrected
//! `m^ = m / (1 - b1^t)`, `v^ = v / (1 - b2^t)`.
//!
//! Numbers below 1e-30 become 0: moments of a weight without gradient decay into subnormal numbers otherwise, which slow every
//! later step.

use std::collections::BTreeMap;

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

/// Moments of all parameters, by path.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State(pub BTreeMap<String, Moments>);

impl AdamW {
    /// One step of the parameter at `path`: the new values. `gradient` is multiplied by `scale` first (clipping).
    ///
    /// # Panics
    /// When shapes differ.
    pub fn step(
        &self,
        state: &mut State,
        path: &str,
        value: &Tensor<f32>,
        gradient: &Tensor<f32>,
        learning_rate: f64,
        scale: f64,
    ) -> Tensor<f32> {
        let shape = value.shape();
        assert!(gradient.shape() == shape, "adamw: {path} has shape {shape}, its gradient {}", gradient.shape());
        let old = state.0.get(path);
        let steps = old.map_or(0, |m| m.steps) + 1;
        let mut first = old.map_or_else(|| vec![0.0; shape.len()], |m| m.first.to_vec());
        let mut second = old.map_or_else(|| vec![0.0; shape.len()], |m| m.second.to_vec());
        let mut next = value.to_vec();
        let kernel = Kernel::new(self, steps, learning_rate, scale);
        let rows: Vec<_> = first
            .chunks_mut(par::CHUNK)
            .zip(second.chunks_mut(par::CHUNK))
            .zip(next.chunks_mut(par::CHUNK).zip(gradient.data().chunks(par::CHUNK)))
            .collect();
        par::for_each_item(rows, |_, ((m, v), (w, g))| {
            for (((m, v), w), &g) in m.iter_mut().zip(v).zip(w).zip(g) {
                kernel.update(m, v, w, g);
            }
        });
        let moments = Moments { steps, first: Tensor::from_vec(shape, first), second: Tensor::from_vec(shape, second) };
        state.0.insert(path.to_string(), moments);
        Tensor::from_vec(shape, next)
    }
}

struct Kernel {
    scale: f32,
    b1: f32,
    b2: f32,
    rate: f32,
    keep: f32,
    root: f32,
    epsilon: f32,
}

impl Kernel {
    fn new(settings: &AdamW, steps: u64, learning_rate: f64, scale: f64) -> Self {
        let [b1, b2] = settings.betas;
        let power = steps.min(i32::MAX as u64) as i32;
        Kernel {
            scale: scale as f32,
            b1: b1 as f32,
            b2: b2 as f32,
            rate: (learning_rate / (1.0 - b1.powi(power))) as f32,
            keep: (1.0 - learning_rate * settings.weight_decay) as f32,
            root: (1.0 / (1.0 - b2.powi(power))) as f32,
            epsilon: settings.epsilon as f32,
        }
    }

    #[inline(always)]
    fn update(&self, m: &mut f32, v: &mut f32, w: &mut f32, g: f32) {
        let g = g * self.scale;
        *m = flush(self.b1 * *m + (1.0 - self.b1) * g);
        *v = flush(self.b2 * *v + (1.0 - self.b2) * g * g);
        *w = flush(*w * self.keep - self.rate * *m / ((*v * self.root).sqrt() + self.epsilon));
    }
}

#[inline(always)]
fn flush(x: f32) -> f32 {
    if x.abs() < 1e-30 { 0.0 } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;

    fn run(gradients: &[f32], settings: AdamW, rate: f64) -> (f32, State) {
        let mut state = State::default();
        let mut w = Tensor::full(Shape::SCALAR, 1.0);
        for &g in gradients {
            w = settings.step(&mut state, "w", &w, &Tensor::full(Shape::SCALAR, g), rate, 1.0);
        }
        (w.item(), state)
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
