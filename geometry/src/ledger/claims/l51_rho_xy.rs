//! L51: depth-to-translation ratios from planar flows.

use nalgebra::{Vector2, Vector3};

use crate::alignment::{self, Convention, Match};
use crate::flow::rigid::rigid_flow;
use crate::flow::tangential::tangential_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict};
use crate::ratios::{inverse_tangential_ratios, tangential_ratios};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L51",
    slug: "rho-xy",
    place: "eq. constraint3",
    statement: "The planar flow gives the ratios of depth to tangential translation: z / t_x = f_x / f_pla,x, z / t_y = f_y / \
                f_pla,y (f_x, f_y stand for the focal lengths f_u, f_v here).",
    verdict: Verdict::Exact,
    condition: Some("planar flow exact (translation in the target frame), t'_x != 0, t'_y != 0"),
    formula: "rho_x = f_u / f_pla,x = z / t'_x,  rho_y = f_v / f_pla,y = z / t'_y",
    derivation: "After the planar alignment f_pla = (f_u t'_x, f_v t'_y) / z; divide the focal length by each component. The \
                 inverse ratios f_pla,x / f_u = t'_x / z are linear in the flow and hold at t'_x = 0 too.",
    counter_example: None,
    correction: None,
    functions: &["ratios::tangential_ratios", "ratios::inverse_tangential_ratios"],
    taped: &["losses::tangential"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let camera = scenes::kitti640();
    let ratios = tangential_ratios(&camera, &tangential_flow(&camera, &Vector3::new(0.3, -0.1, 0.0), 12.5));
    trial.findings.documented("ratios of t = (0.3, -0.1, 0) at 12.5 m, documented", ratios.x, 41.6666666667, 1e-11);
    trial.findings.documented("ratios of t = (0.3, -0.1, 0) at 12.5 m, documented", ratios.y, -125.0, 1e-11);
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, p, z) = (&case.camera, case.pixel, case.depth);
    let a = Convention::Consistent.translation(&case.motion);
    let planar = rigid_flow(camera, &case.motion, &p, z).and_then(|(flow, source_depth)| {
        alignment::planar(camera, &case.motion.rotation, &a, &Match { target: p, source: p + flow, source_depth })
    });
    let flow = planar.map_or(Vector2::repeat(f64::NAN), |aligned| aligned.flow);
    let recovered = inverse_tangential_ratios(camera, &flow) * z;
    f.residual("z / rho_xy - t'_xy after the alignment, relative to z", (recovered - a.xy()).norm() / z, 1e-12);
    let exact = tangential_ratios(camera, &tangential_flow(camera, &a, z));
    let aligned = tangential_ratios(camera, &flow);
    for k in 0..2 {
        // A ratio needs a flow to divide by; at 1 % of the depth that is a pixel or more.
        if a[k].abs() > 0.01 * z {
            f.residual("rho t' / z - 1 of eq. tangential_flow", exact[k] * a[k] / z - 1.0, 1e-12);
            f.residual("rho t' / z - 1 after the alignment", aligned[k] * a[k] / z - 1.0, 1e-10);
        }
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
    }
}
