//! L51: depth-to-translation ratios from planar flows.

use dimode_autodiff::proof::{Dual, Number};
use dimode_autodiff::{Tensor, Var};
use nalgebra::{Vector2, Vector3};

use crate::alignment::{self, Convention, Match};
use crate::camera::Intrinsics;
use crate::flow::rigid::rigid_flow;
use crate::flow::tangential::tangential_flow;
use crate::ledger::forward::{self, V2};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, taped};
use crate::ratios::{inverse_tangential_ratio_slopes, inverse_tangential_ratios, tangential_ratio_slopes, tangential_ratios};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L51",
    slug: "rho-xy",
    place: "eq. constraint3",
    statement: "The planar flow gives the ratios of depth to tangential translation: z / t_x = f_x / f_pla,x, z / t_y = f_y / \
                f_pla,y (f_x, f_y stand for the focal lengths f_u, f_v here).",
    verdict: Verdict::Exact,
    condition: Some("planar flow exact (translation in the target frame), t'_x != 0, t'_y != 0"),
    formula: "rho_x = f_u / f_pla,x = z / t'_x,  rho_y = f_v / f_pla,y = z / t'_y;  d rho_k / d f_k = -f / f_k^2,  d(1/rho_k) / \
              d f_k = 1 / f",
    derivation: "After the planar alignment f_pla = (f_u t'_x, f_v t'_y) / z; divide the focal length by each component. The \
                 inverse ratios f_pla,x / f_u = t'_x / z are linear in the flow and hold at t'_x = 0 too.",
    counter_example: None,
    correction: None,
    functions: &[
        "ratios::tangential_ratios",
        "ratios::inverse_tangential_ratios",
        "ratios::tangential_ratio_slopes",
        "ratios::inverse_tangential_ratio_slopes",
    ],
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
    slopes(case, f);
}

/// Focal lengths on the tape, (1,2,1,1).
fn focal<'t>(flow: Var<'t, f64>, [f_u, f_v]: [f64; 2]) -> Var<'t, f64> {
    flow.tape().constant(Tensor::from_vec(flow.shape(), vec![f_u, f_v]))
}

/// Ratio and inverse ratio of any flow, and their slopes: a ratio does not see the flow across its axis.
fn slopes(case: &Case, f: &mut Findings) {
    let (camera, flow) = (&case.camera, case.extra_flow(0));
    let lengths = [camera.fu, camera.fv];
    // A long step costs the linear inverse nothing and saves digits.
    let size = flow.norm();
    let (inverse, closed) = (inverse_tangential_ratios(camera, &flow), inverse_tangential_ratio_slopes(camera));
    let linear = |[x, y]: V2<f64>| [x / lengths[0], y / lengths[1]];
    let dual = forward::jacobian(flow.into(), |x| [0, 1].map(|k| x[k] / Dual::constant(lengths[k])));
    let central = forward::central(flow.into(), [size; 2], linear);
    let (values, rows) = taped::jacobian(&[taped::column(flow.as_slice())], |v| v[0].div(focal(v[0], lengths)));
    let taped = (Vector2::from_row_slice(&values) - inverse).norm() / inverse.norm();
    f.residual("1 / rho_xy on the tape - plain, relative", taped, 1e-14);
    let closed = [closed.x, 0.0, 0.0, closed.y];
    f.derivative("d(1 / rho_xy) / df", &closed, Some(&dual), Some(&rows.concat()), Some(&central), closed[0].max(closed[3]));
    if flow.x.abs().min(flow.y.abs()) > 1e-2 * size {
        ratio_slopes(camera, &flow, f);
    }
}

fn ratio_slopes(camera: &Intrinsics, flow: &Vector2<f64>, f: &mut Findings) {
    let lengths = [camera.fu, camera.fv];
    let (plain, closed) = (tangential_ratios(camera, flow), tangential_ratio_slopes(camera, flow));
    let dual = forward::jacobian((*flow).into(), |x| [0, 1].map(|k| Dual::constant(lengths[k]) / x[k]));
    let steps = [flow.x, flow.y].map(|x| 1e-5 * x.abs());
    let central = forward::central((*flow).into(), steps, |x: V2<f64>| [lengths[0] / x[0], lengths[1] / x[1]]);
    let (values, rows) = taped::jacobian(&[taped::column(flow.as_slice())], |v| focal(v[0], lengths).div(v[0]));
    let tape = rows.concat();
    for k in 0..2 {
        f.equal("rho_xy on the tape - plain, relative", values[k], plain[k], plain[k], 1e-14);
        // Each ratio by its own size: the two may differ by a factor of 1e4.
        let mut row = [0.0; 2];
        row[k] = closed[k];
        let of = |all: &[f64]| [all[2 * k], all[2 * k + 1]];
        let (dual, tape, central) = (of(&dual), of(&tape), of(&central));
        f.derivative("d rho_xy / df", &row, Some(&dual), Some(&tape), Some(&central), closed[k].abs());
    }
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
