//! L45: what pixel noise costs the axial loss.

use nalgebra::Vector2;

use crate::flow::radial::radial_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::loss_forms::axial;
use crate::noise::{AXIAL_CEILING, axial_angle_mean};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L45",
    slug: "laxi-noise",
    place: "derived from eq. la",
    statement: "With pixel noise sigma the perfect estimate costs L_axi = sqrt(2/pi) sigma E[z' / (r |t'_z|)].",
    verdict: Verdict::FirstOrder,
    condition: Some("the noise is far smaller than the axial flow"),
    formula: "sqrt(2/pi) sigma E[z' / (r |t'_z|)],  z' = z + t'_z",
    derivation: "The angle of a flow of length |f| = |t'_z| r / z' turns by a normal number of deviation sigma / |f|, whose \
                 magnitude has the mean sqrt(2/pi) sigma / |f|.",
    counter_example: Some(
        "Road, 0.5 px: 0.0589 rad for t'_z = -0.8 m, 0.496 for -0.1 m. For -0.01 m the formula says 4.99 rad, while random \
         directions cost pi/2: the loss measures noise.",
    ),
    correction: Some("Leave out pairs whose radial translation is small against the depth."),
    functions: &["noise::axial_angle_mean"],
    taped: &["losses::axial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let road = scenes::road();
    trial.count(road.pixels.len());
    let f = &mut trial.findings;
    let floor = |a_z| axial_angle_mean(&road.offsets(), &road.depths, a_z, 0.5);
    for (a_z, expected) in [(-0.8, 0.0589241912752), (-0.1, 0.496163555349), (0.8, 0.0660013413174)] {
        f.documented("road, 0.5 px, documented", floor(a_z), expected, 1e-11);
    }
    f.gap("floor for t'_z = -0.01 m above that of random directions, rad", floor(-0.01) - AXIAL_CEILING, 3.0);
    f.gap("floor for t'_z = -0.1 m - loss with the same noise, relative", 1.0 - noisy(-0.1, 0.5) / floor(-0.1), 0.2);
    let miss = (1.0 - noisy(-0.8, 1e-3) / floor(-0.8) * 500.0).abs();
    f.bound("t'_z = -0.8 m, 0.001 px: |1 - loss with the same noise / floor|", miss, 1e-4);
}

/// Values of a normal number of deviation 1 with their shares: a fine grid of its positive half.
fn half_normal() -> impl Iterator<Item = (f64, f64)> {
    const STEP: f64 = 0.02;
    let density = |x: f64| (2.0 / std::f64::consts::PI).sqrt() * (-0.5 * x * x).exp();
    (0..400).map(move |i| (f64::from(i) + 0.5) * STEP).map(move |x| (x, density(x) * STEP))
}

/// Mean angle of one exact flow with noise `sigma` across it, which is what turns it.
fn with_noise(flow: &Vector2<f64>, d: &Vector2<f64>, a_z: f64, sigma: f64) -> f64 {
    let across = Vector2::new(-flow.y, flow.x) * (sigma / flow.norm());
    half_normal().map(|(x, share)| share * axial::pose_sign(&[flow + across * x], &[*d], a_z)).sum()
}

/// The sign-aware loss of the road, every flow with normal noise across it.
fn noisy(a_z: f64, sigma: f64) -> f64 {
    let road = scenes::road();
    let offsets = road.offsets();
    let one = |i: usize| {
        let flow = radial_flow(&road.camera, a_z, &road.pixels[i], road.depths[i]).unwrap_or(Vector2::repeat(f64::NAN));
        with_noise(&flow, &offsets[i], a_z, sigma)
    };
    (0..offsets.len()).map(one).sum::<f64>() / offsets.len() as f64
}

fn at(case: &Case, f: &mut Findings) {
    let (a_z, d) = (case.in_target().z, case.offset());
    if a_z.abs() <= 1e-3 * case.depth || d.norm() <= 1.0 {
        return;
    }
    let flow = radial_flow(&case.camera, a_z, &case.pixel, case.depth).unwrap_or(Vector2::repeat(f64::NAN));
    let sigma = 1e-4 * flow.norm();
    let expected = axial_angle_mean(&[d], &[case.depth], a_z, sigma);
    let miss = (with_noise(&flow, &d, a_z, sigma) / expected - 1.0).abs();
    f.bound("noise of 1e-4 of the flow: |mean angle / formula - 1|", miss, 1e-4);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing::{case, holds, limit};

    proptest! {
        #[test]
        fn holds_everywhere(case in case()) {
            holds(|f| at(&case, f))?;
        }

        #[test]
        fn holds_at_the_limits(case in limit()) {
            holds(|f| at(&case, f))?;
        }
    }

    #[test]
    fn the_grid_of_the_normal_density_has_its_moments() {
        let mean = |of: fn(f64) -> f64| half_normal().map(|(x, share)| share * of(x)).sum::<f64>();
        assert!((mean(|_| 1.0) - 1.0).abs() < 1e-12 && (mean(|x| x * x) - 1.0).abs() < 1e-12);
    }
}
