//! The optimiser of these tests.

use std::collections::BTreeMap;

use dimode_nets::{ParamGradient, ParamSet};

/// Adam with its usual moments and a constant rate.
pub struct Adam {
    rate: f32,
    step: i32,
    moments: BTreeMap<String, Vec<[f32; 2]>>,
}

impl Adam {
    pub fn new(rate: f32) -> Self {
        Self { rate, step: 0, moments: BTreeMap::new() }
    }

    pub fn step(&mut self, params: &mut ParamSet<f32>, gradients: Vec<ParamGradient<f32>>) {
        self.step += 1;
        let [first, second] = [0.9f32, 0.999].map(|decay| 1.0 - decay.powi(self.step));
        for item in gradients {
            let values = params.get_mut(&item.path).unwrap().data_mut();
            let moments = self.moments.entry(item.path).or_insert_with(|| vec![[0.0; 2]; values.len()]);
            for ((value, moment), &g) in values.iter_mut().zip(moments).zip(item.gradient.data()) {
                *moment = [0.9 * moment[0] + 0.1 * g, 0.999 * moment[1] + 0.001 * g * g];
                *value -= self.rate * (moment[0] / first) / ((moment[1] / second).sqrt() + 1e-8);
            }
        }
    }
}
