//! Deterministic test values for parameters: a number made from the name and the position.
//!
//! The golden tensors were computed with these values, so no weights have to be stored. A value
//! `v` in [-1, 1) comes from the FNV-1a hash of the name and splitmix64; the role of the tensor,
//! read from the last part of its name, decides scale and offset. Values are rounded once to f32.

use dimode_autodiff::rng::splitmix64;

use crate::hash::fnv1a64;

/// The raw number in [-1, 1) for element `index` of the tensor called `name`.
pub fn unit(name: &str, index: usize) -> f64 {
    unit_from(fnv1a64(name), index)
}

fn unit_from(seed: u64, index: usize) -> f64 {
    (splitmix64(seed, index as u64) >> 11) as f64 * (1.0 / (1u64 << 52) as f64) - 1.0
}

/// All values of one tensor, row-major, rounded to f32 and widened.
///
/// * `name`: name inside its checkpoint file, without the file part.
/// * `dims`: dimensions as in the checkpoint file.
/// * `gain`: the variance gain of weights with two or more axes.
pub fn values(name: &str, dims: &[usize], gain: f64) -> Vec<f64> {
    let seed = fnv1a64(name);
    let rule = rule(name, dims, gain);
    (0..dims.iter().product()).map(|i| f64::from(rule.apply(unit_from(seed, i)) as f32)).collect()
}

/// `offset + scale * v`, or with the magnitude of `v`.
struct Rule {
    offset: f64,
    scale: f64,
    magnitude: bool,
}

impl Rule {
    fn apply(&self, v: f64) -> f64 {
        self.offset + self.scale * if self.magnitude { v.abs() } else { v }
    }
}

fn rule(name: &str, dims: &[usize], gain: f64) -> Rule {
    let role = name.rsplit('.').next().unwrap_or(name);
    let (offset, scale, magnitude) = match role {
        "running_mean" => (0.0, 0.1, false),
        "running_var" => (1.0, 0.1, true),
        "gamma" | "gamma_xca" | "alpha" => (0.5, 0.25, false),
        "temperature" => (2.0, 0.5, false),
        "bias" => (0.0, 0.1, false),
        "num_batches_tracked" => (0.0, 0.0, false),
        _ if dims.len() >= 2 => {
            let fan_in = dims[1..].iter().product::<usize>() as f64;
            (0.0, (3.0 * gain / fan_in).sqrt(), false)
        }
        _ => (1.0, 0.1, false),
    };
    Rule { offset, scale, magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_values_match_the_rule() {
        let expected = [-0.156_364_214_822_970_47, 0.878_075_377_120_829_2, 0.268_311_784_652_361_05, -0.887_764_791_932_398_1];
        for (i, e) in expected.into_iter().enumerate() {
            assert_eq!(unit("loss.disp0", i), e);
        }
    }

    #[test]
    fn roles_have_their_ranges() {
        let range = |name: &str, dims: &[usize]| {
            let v = values(name, dims, 1.0);
            let low = v.iter().copied().fold(f64::INFINITY, f64::min);
            let high = v.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            (low, high)
        };
        let near = |a: (f64, f64), b: (f64, f64), tol: f64| {
            assert!((a.0 - b.0).abs() < tol && (a.1 - b.1).abs() < tol, "{a:?}");
        };
        near(range("x.bias", &[500]), (-0.1, 0.1), 0.01);
        near(range("x.weight", &[500]), (0.9, 1.1), 0.01);
        near(range("x.running_var", &[500]), (1.0, 1.1), 0.01);
        let bound = (3.0f64 / 36.0).sqrt();
        near(range("x.weight", &[16, 4, 3, 3]), (-bound, bound), 0.01);
    }
}
