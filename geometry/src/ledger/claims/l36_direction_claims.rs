//! L36: the two observations about flow directions before eq. `lp`.

use nalgebra::Vector2;

use crate::flow::radial::radial_flow;
use crate::flow::tangential::tangential_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::loss_forms::planar;
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L36",
    slug: "direction-claims",
    place: "observations (1) and (2) before eq. lp",
    statement: "(1) Parallel planar flows are those of one constant e_1 . f / |f|. (2) Axial flows satisfy f / |f| = d / r.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "f_pla = (f o t'_tan) / z,  f_axi = -t'_z / (z + t'_z) d",
    derivation: "(1) All planar flows are positive multiples of f o t'_tan, so the cosine is constant; but the cosine of a \
                 flow mirrored about e_1 is the same. (2) -t'_z / (z + t'_z) has the sign of -t'_z: away from p0 for t'_z < 0, \
                 toward it for t'_z > 0.",
    counter_example: Some(
        "(1) (1, 0.5) and (1, -0.5) share the cosine 0.894427 and enclose 0.927295 rad. (2) For every t'_z > 0 the unit \
         vectors f / |f| and d / r are opposite: 2 apart.",
    ),
    correction: Some("(1) is necessary only. (2) f / |f| = -sign(t'_z) d / r."),
    functions: &["flow::tangential::tangential_flow", "flow::radial::radial_flow", "loss_forms::planar::circular"],
    taped: &["taped::align"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let pair = [Vector2::new(1.0, 0.5), Vector2::new(1.0, -0.5)];
    let f = &mut trial.findings;
    f.documented("cosines of (1, 0.5) and (1, -0.5), documented", cosine(&pair[0]), 0.894427191, 1e-9);
    f.documented("cosines of (1, 0.5) and (1, -0.5), documented", cosine(&pair[1]), 0.894427191, 1e-9);
    f.gap("angle between two flows of one cosine, rad", pair[0].angle(&pair[1]), 0.9);
    f.gap("circular variance of two flows of one cosine", planar::circular(&pair), 0.2);
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    let (toward, d) = (radial_flow(&camera, 0.6, &p, 12.5).unwrap_or_default(), p - camera.principal_point());
    f.gap("printed: f / |f| - d / r for t'_z > 0", (toward / toward.norm() - d / d.norm()).norm(), 1.99);
}

/// `e_1 . f / |f|`.
fn cosine(f: &Vector2<f64>) -> f64 {
    f.x / f.norm()
}

fn at(case: &Case, f: &mut Findings) {
    parallel(case, f);
    radial(case, f);
}

/// Statement (1): necessary, not sufficient.
fn parallel(case: &Case, f: &mut Findings) {
    let (a, z) = (case.in_target(), case.depth);
    let flows = [z, case.extra(0, 0.5, 80.0)].map(|z| tangential_flow(&case.camera, &a, z));
    // Without tangential translation there is no direction.
    if flows[0].norm() == 0.0 {
        return;
    }
    f.residual("e_1 . f / |f| at two depths", cosine(&flows[0]) - cosine(&flows[1]), 1e-12);
    f.residual("angle between planar flows at two depths, rad", flows[0].perp(&flows[1]).atan2(flows[0].dot(&flows[1])), 1e-12);
    let mirrored = Vector2::new(flows[0].x, -flows[0].y);
    f.residual("e_1 . f / |f| of a mirrored flow", cosine(&flows[0]) - cosine(&mirrored), 0.0);
}

/// Statement (2): true up to the sign of the radial translation.
fn radial(case: &Case, f: &mut Findings) {
    let (a_z, d) = (case.in_target().z, case.offset());
    let flow = radial_flow(&case.camera, a_z, &case.pixel, case.depth).unwrap_or(Vector2::repeat(f64::NAN));
    if a_z == 0.0 || d.norm() <= 1.0 {
        return;
    }
    let (direction, radius) = (flow / flow.norm(), d / d.norm());
    f.residual("f / |f| + sign(t'_z) d / r", (direction + radius * a_z.signum()).norm(), 1e-12);
    if a_z > 0.0 {
        f.gap("printed: f / |f| - d / r for t'_z > 0", (direction - radius).norm(), 1.99);
    }
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

        #[test]
        fn the_printed_sign_is_wrong_for_every_backward_source(case in case()) {
            let case = if case.in_target().z < 0.0 { case.with_translation(-case.motion.translation) } else { case };
            prop_assume!(case.in_target().z > 0.0 && case.offset().norm() > 1.0);
            let mut f = Findings::default();
            radial(&case, &mut f);
            prop_assert!(f.findings().iter().any(|x| x.what.starts_with("printed") && (x.worst - 2.0).abs() < 1e-12));
        }
    }
}
