//! L57: the pixel terms of the ratio losses under flow noise.

use crate::ledger::{Claim, Findings, Trial, Verdict};
use crate::ratio_bias::{
    CUT, PixelError, mean_error_beyond, mean_error_growth, mean_ratio, mean_ratio_second_order, median_offset_second_order,
    truncated_mean, truncated_variance,
};

pub(super) static CLAIM: Claim = Claim {
    id: "L57",
    slug: "ratio-bias",
    place: "eqs. lt, lr, first terms",
    statement: "The mean of |rho t - z| / z over the pixels measures how well depth and translation agree.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "a = rho t = z f / (f + n);  E[|a - z| / z; |f + n| > tau] = 2 |f| p(-f) ln(1 / tau) + O(1),  p the density of the \
              noise n",
    derivation: "The density of f + n is positive at 0, where |a / z - 1| grows as |f| / |f + n|; both sides of the pole add \
                 |f| p(-f) ln(1 / tau). The reciprocal of a Gaussian has no mean. With the noise truncated at 3 sigma, E[a / z] \
                 = 1 + sigma^2 / f^2 to second order (Jensen: above 1), and setting the derivative of E[|a - z| / z] to zero \
                 makes the best z the a-weighted median of a: above the truth.",
    counter_example: Some(
        "f = 0.5 px, sigma = 0.5 px: cut-offs of 1e-2, 1e-4, 1e-6 px give 1.912, 4.141, 6.369. Truncated at 3 sigma, f = 2 px: \
         E[a / z] = 1.0755, and the z that minimises the printed term is 1.0752 times the truth.",
    ),
    correction: Some(
        "E[|1/z - 1/a|] is unbiased: 1/a is linear in the flow, its median is the truth. Normalising by a instead of z errs the \
         other way, 0.9429 times the truth at f = 2 px.",
    ),
    functions: &[
        "ratio_bias::mean_ratio",
        "ratio_bias::mean_error_beyond",
        "ratio_bias::mean_error_growth",
        "ratio_bias::weighted_median_noise",
        "ratio_bias::median_offset_second_order",
        "ratio_bias::PixelError::minimiser",
    ],
    taped: &["losses::tangential", "losses::radial"],
    missing_way: None,
    check,
};

const ALL: [PixelError; 3] = [PixelError::OverPrediction, PixelError::OverRatio, PixelError::InverseDepth];

fn check(trial: &mut Trial) {
    for _ in 0..(trial.samples / 20).max(10) {
        let (sigma, quotient) = (trial.draw.log_uniform(0.05, 2.0), trial.draw.log_uniform(3.5, 40.0));
        truncated(sigma, quotient, &mut trial.findings);
        let quotient = trial.draw.log_uniform(0.3, 4.0);
        heavy_tail(sigma, quotient, &mut trial.findings);
        trial.count(2);
    }
    documented(&mut trial.findings);
}

fn documented(f: &mut Findings) {
    let tails = [
        (0.5, 1e-2, 1.912086655),
        (0.5, 1e-4, 4.1406226141),
        (0.5, 1e-6, 6.3692553373),
        (2.0, 1e-2, 0.237861852477),
        (2.0, 1e-4, 0.242793732095),
    ];
    for (flow, cut_off, expected) in tails {
        f.documented("E[|a / z - 1|] over a cut-off, documented", mean_error_beyond(flow, 0.5, cut_off), expected, 1e-10);
    }
    f.documented("E[a / z], f = 2 px, sigma = 0.5 px, documented", mean_ratio(2.0, 0.5), 1.07554977467, 1e-11);
    let [printed, over_ratio, inverse] = ALL.map(|error| error.minimiser(2.0, 0.5));
    f.documented("minimisers of the pixel terms, f = 2 px, documented", printed, 1.07517188805, 1e-11);
    f.documented("minimisers of the pixel terms, f = 2 px, documented", over_ratio, 0.942875929874, 1e-11);
    f.documented("minimisers of the pixel terms, f = 2 px, documented", inverse, 1.0, 1e-11);
    f.gap("E[a / z] - 1 at f = 4 sigma", mean_ratio(2.0, 0.5) - 1.0, 0.9 * 0.0755);
    f.gap("best prediction of the printed term over the truth, - 1, at f = 4 sigma", printed - 1.0, 0.9 * 0.0752);
    let growth = mean_error_beyond(0.5, 0.5, 1e-6) - mean_error_beyond(0.5, 0.5, 1e-2);
    f.gap("what the expectation gains from cut-off 1e-2 to 1e-6 px", growth, 0.9 * 4.457);
}

/// Noise truncated at 3 sigma, flow of `quotient` sigma.
fn truncated(sigma: f64, quotient: f64, f: &mut Findings) {
    let flow = quotient * sigma;
    let mean = mean_ratio(flow, sigma);
    // f / (f + n) = 1 - n/f + ... + (n/f)^(2K) f / (f + n) - odd powers, exactly; the odd ones vanish in the mean.
    let even: f64 = (0..4).map(|k| truncated_mean(sigma, |n| (n / flow).powi(2 * k))).sum();
    let rest = truncated_mean(sigma, |n| (n / flow).powi(8) * flow / (flow + n));
    f.residual("E[a / z] - its finite expansion with remainder, relative", (even + rest) / mean - 1.0, 1e-12);
    let second = truncated_variance(sigma) / (flow * flow);
    f.floor("Jensen: E[a / z] - 1 - v / f^2", mean - 1.0 - second, 0.0);
    if quotient > 10.0 {
        // Truncation takes 2.7 % of the variance, the fourth moment adds 3 / quotient^2.
        let relative = (mean - 1.0) / (mean_ratio_second_order(flow, sigma) - 1.0) - 1.0;
        f.bound("from 10 sigma on: |bias over sigma^2 / f^2 - 1|", relative.abs(), 0.03);
    }
    minimisers(sigma, flow, f);
}

/// The minimisers stay what they are when the prediction moves to either side, and lie where the weights say.
fn minimisers(sigma: f64, flow: f64, f: &mut Findings) {
    let [printed, over_ratio, inverse] = ALL.map(|error| {
        let z = error.minimiser(flow, sigma);
        // The expectation is cut at its kink, n = f / z - f; a smooth function on either side.
        let expected = |z: f64| expectation(error, sigma, flow, z);
        let (least, step) = (expected(z), 0.02 * sigma / flow);
        let beside = expected(z - step).min(expected(z + step));
        f.floor("expected error beside the minimiser - at it, relative", (beside - least) / least, 0.0);
        z
    });
    f.residual("E[|1/z - 1/a|]: minimiser - truth", inverse - 1.0, 1e-12);
    // sigma^2 / f^2 is 6.25e-4 for the longest flows, of 40 sigma.
    f.floor("best prediction with the weight a over the truth, - 1", printed - 1.0, 6e-4);
    f.floor("1 - best prediction with the weight 1/a over the truth", 1.0 - over_ratio, 6e-4);
    if flow > 10.0 * sigma {
        let offset = median_offset_second_order(flow, sigma);
        let [above, below] = [printed - 1.0, 1.0 - over_ratio].map(|x| (x / offset - 1.0).abs());
        f.bound("from 10 sigma on: |offset of the a-weighted median over its second order - 1|", above, 0.03);
        f.bound("from 10 sigma on: |offset of the 1/a-weighted median over its second order - 1|", below, 0.03);
    }
}

fn expectation(error: PixelError, sigma: f64, flow: f64, z: f64) -> f64 {
    let rule = crate::quadrature::GaussLegendre::new();
    let weighted = |n: f64| error.at(flow / (flow + n), z) * (-0.5 * (n / sigma).powi(2)).exp();
    let (end, kink) = (CUT * sigma, flow / z - flow);
    rule.integral(-end, kink, 8, weighted) + rule.integral(kink, end, 8, weighted)
}

/// Whole Gaussian noise, flow of `quotient` sigma: each factor of ten in the cut-off adds the same.
fn heavy_tail(sigma: f64, quotient: f64, f: &mut Findings) {
    let flow = quotient * sigma;
    let [coarse, fine] = [1e-5, 1e-6].map(|cut| mean_error_beyond(flow, sigma, cut * sigma));
    let growth = mean_error_growth(flow, sigma) * 10f64.ln();
    let miss = ((fine - coarse) / growth - 1.0).abs();
    f.bound("cut-offs of 1e-5 and 1e-6 sigma: |gain over 2 |f| p(-f) ln 10 - 1|", miss, 1e-8);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::holds;

    proptest! {
        #[test]
        fn truncated_noise_is_biased(sigma in 0.05f64..2.0, quotient in 3.5f64..40.0) {
            holds(|f| truncated(sigma, quotient, f))?;
        }

        #[test]
        fn whole_noise_has_no_mean(sigma in 0.05f64..2.0, quotient in 0.3f64..4.0) {
            holds(|f| heavy_tail(sigma, quotient, f))?;
        }
    }
}
