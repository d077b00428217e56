//! L40: what pixel noise costs the planar loss.

use nalgebra::{Vector2, Vector3};

use crate::flow::tangential::{focal_scaled, tangential_flow};
use crate::ledger::{Case, Claim, Draw, Findings, Trial, Verdict};
use crate::loss_forms::planar;
use crate::noise::{CIRCULAR_CEILING, PRINTED_CEILING, planar_angle_variance};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L40",
    slug: "lpla-noise",
    place: "derived from eq. lp",
    statement: "With pixel noise sigma the perfect estimate costs L_pla = E[sigma^2 z^2 / |f o t'_tan|^2].",
    verdict: Verdict::Conditional,
    condition: Some("the noise is far smaller than the tangential flow; otherwise the loss stays at its ceiling"),
    formula: "E[sigma^2 z^2 / |f o t'_tan|^2]; directions of pure noise cost pi^2/12 (printed) and 2 (circular)",
    derivation: "The angle of a flow f turns by n x f / |f|^2 for a small n: with independent components of n of variance \
                 sigma^2 the angle has the variance sigma^2 / |f|^2, f = f o t'_tan / z. Without tangential motion the flow is \
                 the noise itself, its direction uniform: |theta| is uniform on [0, pi], of variance pi^2/12, and the mean \
                 unit vector is 0.",
    counter_example: Some(
        "Road, 0.5 px, t'_tan = (0.02, -0.01) m, as in straight driving: the formula says 1.846 rad^2, more than random \
         directions cost (0.822): the loss measures noise.",
    ),
    correction: Some("Leave out pairs whose predicted tangential flow is short against the noise."),
    functions: &["noise::planar_angle_variance"],
    taped: &["losses::planar"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    floors(&mut trial.findings);
    pure_noise(&mut trial.findings);
    drawn_noise(&mut trial.draw, &mut trial.findings);
    trial.count(scenes::road().pixels.len());
}

fn floors(f: &mut Findings) {
    let road = scenes::road();
    let floor = |x, y| planar_angle_variance(&road.camera, &Vector3::new(x, y, 0.0), &road.depths, 0.5);
    f.documented("road, 0.5 px, t'_tan = (0.02, -0.01), documented", floor(0.02, -0.01), 1.84629, 1e-5);
    f.documented("road, 0.5 px, t'_tan = (0.1, 0.02), documented", floor(0.1, 0.02), 0.088567, 1e-6);
    f.documented("road, 0.5 px, t'_tan = (0.5, 0), documented", floor(0.5, 0.0), 0.00368244, 1e-6);
    f.documented("ceiling of the printed form, documented", PRINTED_CEILING, 0.822467033424, 1e-12);
    f.gap("floor of straight driving above the ceiling, rad^2", floor(0.02, -0.01) - PRINTED_CEILING, 0.92);
}

/// Directions of flows that are nothing but noise: evenly around the circle.
fn pure_noise(f: &mut Findings) {
    const N: usize = 2000;
    let flow = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * (i as f64 + 0.5) / N as f64).sin_cos();
        Vector2::new(cos, sin)
    };
    let flows: Vec<_> = (0..N).map(flow).collect();
    // Every magnitude of an angle comes twice: N / 2 evenly spaced values have the variance of the uniform density times
    // 1 - (2/N)^2.
    let printed = PRINTED_CEILING * (1.0 - (2.0 / N as f64).powi(2));
    f.residual("printed loss of even directions - pi^2/12, rad^2", planar::printed(&flows) - printed, 1e-12);
    f.residual("circular loss of even directions - 2", planar::circular(&flows) - CIRCULAR_CEILING, 1e-12);
    f.residual("weighted loss of even directions - 2", planar::weighted(&flows) - CIRCULAR_CEILING, 1e-12);
}

/// Normal noise on the flows of the room, seen by the loss itself.
fn drawn_noise(draw: &mut Draw, f: &mut Findings) {
    let (room, a, sigma) = (scenes::room(), Vector3::new(0.25, 0.18, 0.0), 0.1);
    let expected = planar_angle_variance(&room.camera, &a, &room.depths, sigma);
    let mut total = 0.0;
    for _ in 0..20 {
        let flows: Vec<_> = room.depths.iter().map(|&z| tangential_flow(&room.camera, &a, z) + normal(draw) * sigma).collect();
        total += planar::circular(&flows) / 20.0;
    }
    // 20 x 576 squares of normal numbers, weighted with z^2: their mean scatters by about 2 %.
    f.bound("room with drawn noise of 0.1 px: |circular loss / formula - 1|", (total / expected - 1.0).abs(), 0.1);
}

/// Two independent normal numbers.
fn normal(draw: &mut Draw) -> Vector2<f64> {
    let (length, turn) = ((-2.0 * (1.0 - draw.unit()).ln()).sqrt(), std::f64::consts::TAU * draw.unit());
    Vector2::new(length * turn.cos(), length * turn.sin())
}

/// One flow with the four noises `sqrt(2) sigma` along and across: mean 0 and covariance `sigma^2`, as the formula asks for.
fn at(case: &Case, f: &mut Findings) {
    let (a, z) = (case.in_target(), case.depth);
    let flow = tangential_flow(&case.camera, &a, z);
    if focal_scaled(&case.camera, &a).norm() < 1e-3 * z {
        return;
    }
    let sigma = 1e-4 * flow.norm();
    let expected = planar_angle_variance(&case.camera, &a, &[z], sigma);
    let noise = |k: u32| nalgebra::Rotation2::new(case.extra(0, 0.0, 6.0) + std::f64::consts::FRAC_PI_2 * f64::from(k));
    let flows: Vec<_> = (0..4).map(|k| flow + noise(k) * Vector2::new(2f64.sqrt() * sigma, 0.0)).collect();
    let [variance, circular] = [planar::wrapped(&flows), planar::circular(&flows)].map(|x| (x / expected - 1.0).abs());
    f.bound("noise of 1e-4 of the flow: |variance of the angles / formula - 1|", variance, 1e-6);
    f.bound("noise of 1e-4 of the flow: |circular loss / formula - 1|", circular, 1e-6);
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
    fn floors_and_ceilings() {
        let trial = &mut Trial::new(0, Draw::new(5, "noise"));
        check(trial);
        assert!(trial.findings.violations().is_empty(), "{:?}", trial.findings.violations());
    }
}
