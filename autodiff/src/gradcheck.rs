//! Gradients against central differences, for any function on the tape.

use std::fmt;

use crate::{Scalar, Tape, Tensor, Var};

/// Inputs to check at: [`uniform`](crate::rng::uniform) numbers.
pub use crate::rng::uniform as random;

/// Settings of [`gradcheck`].
///
/// An entry passes when `|analytic - numeric| <= atol + rtol * max(|analytic|, |numeric|)`.
#[derive(Clone, Copy, Debug)]
pub struct GradCheck {
    /// Step of the differences, relative to `max(1, |x|)`.
    pub step: f64,
    /// Absolute tolerance, of the order of the noise of the difference.
    pub atol: f64,
    /// Relative tolerance.
    pub rtol: f64,
    /// Whether a gradient that is zero everywhere is accepted; by default it fails, since it shows nothing.
    pub allow_zero: bool,
}

impl Default for GradCheck {
    fn default() -> Self {
        GradCheck { step: 1e-4, atol: 1e-9, rtol: 1e-7, allow_zero: false }
    }
}

/// One entry of an input whose gradient was compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Which input.
    pub input: usize,
    /// Flat index into it.
    pub index: usize,
    /// The same as `[n, c, h, w]`.
    pub place: [usize; 4],
    /// Gradient by the tape.
    pub analytic: f64,
    /// Gradient by differences.
    pub numeric: f64,
    /// Error divided by its tolerance; above 1 the entry fails.
    pub excess: f64,
}

/// What [`gradcheck`] found.
#[derive(Clone, Debug)]
pub struct Report {
    /// Entries compared.
    pub entries: usize,
    /// Entries outside the tolerance.
    pub failures: usize,
    /// The worst entries, worst first, at most five.
    pub worst: Vec<Entry>,
    /// Largest absolute gradient met: the signal.
    pub signal: f64,
    /// Largest relative error, `|a - n| / max(|a|, |n|, signal * 1e-3)`.
    pub relative_error: f64,
    settings: GradCheck,
}

impl Report {
    /// Whether every entry passes and there was a signal to check.
    pub fn is_ok(&self) -> bool {
        self.failures == 0 && (self.settings.allow_zero || self.signal >= 100.0 * self.settings.atol)
    }

    /// Panics with the worst entries unless [`Report::is_ok`].
    #[track_caller]
    pub fn assert_ok(&self) {
        assert!(self.is_ok(), "{self}");
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "gradcheck: {} of {} entries outside atol {:e} + rtol {:e}; largest gradient {:e}",
            self.failures, self.entries, self.settings.atol, self.settings.rtol, self.signal
        )?;
        for e in &self.worst {
            writeln!(
                f,
                "  input {} entry {:?}: tape {:+.12e}, differences {:+.12e}, {:.2} x tolerance",
                e.input, e.place, e.analytic, e.numeric, e.excess
            )?;
        }
        Ok(())
    }
}

/// Compares the tape's gradient of the scalar function `f` with central differences (fourth order) at `inputs`.
///
/// ```
/// use dimode_autodiff::{GradCheck, Shape, gradcheck, gradcheck::random};
/// let x = random(1, Shape::new(2, 3, 4, 5), 0.5, 2.0);
/// gradcheck(&[x], |_, v| v[0].mul(v[0]).sum(), GradCheck::default()).assert_ok();
/// ```
///
/// # Panics
/// When `f` does not return a single number, or when an input, a value on the way or a gradient is not finite.
#[track_caller]
pub fn gradcheck(
    inputs: &[Tensor<f64>],
    f: impl for<'t> Fn(&'t Tape<f64>, &[Var<'t, f64>]) -> Var<'t, f64>,
    settings: GradCheck,
) -> Report {
    let tape = Tape::new().refusing_non_finite();
    let vars: Vec<_> = inputs.iter().map(|x| tape.leaf(x.clone())).collect();
    let grads = tape.backward(f(&tape, &vars));
    let eval = |inputs: &[Tensor<f64>]| {
        let tape = Tape::new().refusing_non_finite();
        let vars: Vec<_> = inputs.iter().map(|x| tape.constant(x.clone())).collect();
        f(&tape, &vars).value().item()
    };
    let mut entries = Vec::new();
    for (input, var) in vars.iter().enumerate() {
        let analytic = grads.wrt(*var);
        for (index, &a) in analytic.data().iter().enumerate() {
            let numeric = central_difference(inputs, input, index, settings.step, &eval);
            let tolerance = settings.atol + settings.rtol * a.abs().max(numeric.abs());
            let error = (a - numeric).abs();
            let excess = if error.is_finite() { error / tolerance } else { f64::INFINITY };
            let place = analytic.shape().unravel(index);
            entries.push(Entry { input, index, place, analytic: a, numeric, excess });
        }
    }
    report(entries, settings)
}

/// `(8 (f(x+h) - f(x-h)) - (f(x+2h) - f(x-2h))) / 12 h` along one entry.
fn central_difference(
    inputs: &[Tensor<f64>],
    input: usize,
    index: usize,
    step: f64,
    eval: &impl Fn(&[Tensor<f64>]) -> f64,
) -> f64 {
    let x = inputs[input].data()[index];
    let h = step * x.abs().max(1.0);
    let at = |offset: f64| {
        let mut moved = inputs.to_vec();
        moved[input].make_mut()[index] = x + offset;
        eval(&moved)
    };
    (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h)
}

fn report(mut entries: Vec<Entry>, settings: GradCheck) -> Report {
    let signal = entries.iter().map(|e| e.numeric.abs()).fold(0.0, f64::max);
    let relative_error = entries
        .iter()
        .map(|e| (e.analytic - e.numeric).abs() / e.analytic.abs().max(e.numeric.abs()).max(signal * 1e-3).max(1e-300))
        .fold(0.0, f64::max);
    let failures = entries.iter().filter(|e| e.excess.is_nan() || e.excess > 1.0).count();
    let count = entries.len();
    entries.sort_by(|a, b| b.excess.total_cmp(&a.excess));
    entries.truncate(5);
    Report { entries: count, failures, worst: entries, signal, relative_error, settings }
}

/// A scalar that depends on every element of `x` with a different weight: the test loss of an operation with many outputs.
pub fn weighted_sum<'t, T: Scalar>(x: Var<'t, T>, seed: u64) -> Var<'t, T> {
    let weights = random::<T>(seed, x.shape(), -1.0, 1.0);
    let total = x.value().data().iter().zip(weights.data()).map(|(x, w)| x.to_f64() * w.to_f64()).sum::<f64>();
    x.tape().push("weighted_sum", Tensor::scalar(T::from_f64(total)), &[x], move |g, grads| {
        if let Some(mut slot) = grads.slot(0) {
            let g = g.item();
            slot.accumulate(|i| g * weights.data()[i]);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Shape;

    /// x^3 whose backward pass is off by the factor `1 + error` in one entry.
    fn cube<'t>(x: Var<'t, f64>, error: f64) -> Var<'t, f64> {
        let saved = x.value();
        let y = saved.data().iter().map(|v| v * v * v).collect();
        x.tape().push("cube", Tensor::from_vec(x.shape(), y), &[x], move |g, grads| {
            if let Some(mut slot) = grads.slot(0) {
                slot.accumulate(|i| {
                    let factor = if i == 3 { 1.0 + error } else { 1.0 };
                    factor * 3.0 * saved.data()[i] * saved.data()[i] * g.data()[i]
                });
            }
        })
    }

    fn check_cube(error: f64) -> Report {
        let x = random(3, Shape::new(1, 2, 3, 4), 0.5, 1.5);
        gradcheck(&[x], |_, v| weighted_sum(cube(v[0], error), 7), GradCheck::default())
    }

    #[test]
    fn a_right_gradient_passes() {
        check_cube(0.0).assert_ok();
    }

    #[test]
    fn one_entry_off_by_a_hundred_thousandth_is_caught_and_named() {
        let report = check_cube(1e-5);
        assert_eq!(report.failures, 1);
        assert_eq!((report.worst[0].input, report.worst[0].index), (0, 3));
    }

    #[test]
    fn a_gradient_without_signal_fails_unless_allowed() {
        let x = random(3, Shape::new(1, 1, 2, 2), 0.5, 1.5);
        let report = gradcheck(std::slice::from_ref(&x), |tape, _| tape.constant(Tensor::scalar(1.0)), GradCheck::default());
        assert!(!report.is_ok());
        let lenient = GradCheck { allow_zero: true, ..GradCheck::default() };
        gradcheck(&[x], |tape, _| tape.constant(Tensor::scalar(1.0)), lenient).assert_ok();
    }
}
