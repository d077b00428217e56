//! L52: depth-to-translation ratio from axial flows.

use dimode_autodiff::Var;
use dimode_autodiff::proof::Number;
use nalgebra::Vector2;

use crate::alignment::{self, Convention, Match};
use crate::flow::radial::radial_flow;
use crate::flow::rigid::rigid_flow;
use crate::ledger::forward::{self, V2, ratio};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, taped};
use crate::ratios::{
    inverse_radial_ratio, inverse_radial_ratio_gradient, radial_ratio, radial_ratio_gradient, radial_ratio_of_component,
};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L52",
    slug: "rho-z",
    place: "eq. constraint4",
    statement: "The axial flow gives the ratio of depth to radial translation: rho_z = -d.(f + d) / (d.f) = z / t_z.",
    verdict: Verdict::Exact,
    condition: Some("axial flow exact, d.f != 0 (t_z != 0 and p != p0)"),
    formula: "rho_z = -(d.(f + d)) / (d.f) = -(r + f_r) / f_r,  f_r = d.f / r;  1/rho_z = -f_r / (r + f_r);  d rho_z / df = r^2 \
              d / (d.f)^2,  d(1/rho_z) / df = -r^2 d / (d.(f + d))^2",
    derivation: "f = -t_z / (z + t_z) d gives d.f = -t_z r^2 / (z + t_z) and d.(f + d) = z r^2 / (z + t_z); their negative \
                 quotient is z / t_z. Only d.f enters, so flow orthogonal to d changes nothing. The ratio is singular where d.f \
                 = 0, its inverse only where the flow ends on p0. For a focus e off p0, f ~ p - e, the singular set is the \
                 circle with diameter p0-e (Thales), and inside it the ratio has the wrong sign.",
    counter_example: None,
    correction: None,
    functions: &[
        "ratios::radial_ratio",
        "ratios::inverse_radial_ratio",
        "ratios::radial_ratio_of_component",
        "ratios::radial_ratio_gradient",
        "ratios::inverse_radial_ratio_gradient",
    ],
    taped: &["losses::radial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let (camera, p) = (scenes::kitti640(), Vector2::new(451.0, 63.0));
    let d = p - camera.principal_point();
    for (t_z, expected) in [(0.6, 20.8333333333), (-0.8, -15.625)] {
        let flow = radial_flow(&camera, t_z, &p, 12.5).unwrap_or(Vector2::repeat(f64::NAN));
        trial.findings.documented("rho_z at (451, 63), documented", radial_ratio(&flow, &d), expected, 1e-11);
    }
    let flow = Vector2::new(-8.0, 3.0);
    trial.findings.documented("rho_z at (451, 63), documented", radial_ratio(&flow, &d), 14.9110723627, 1e-11);
    let inverse = inverse_radial_ratio(&flow, &d);
    trial.findings.documented_within("1 / rho_z at (451, 63), documented", inverse, 0.0670642577326, 1e-12);
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, p, z, d) = (&case.camera, case.pixel, case.depth, case.offset());
    let a = Convention::Consistent.translation(&case.motion);
    let flow = radial_flow(camera, a.z, &p, z).unwrap_or(Vector2::repeat(f64::NAN));
    let axial = rigid_flow(camera, &case.motion, &p, z).and_then(|(flow, source_depth)| {
        alignment::axial(camera, &case.motion.rotation, &a, &Match { target: p, source: p + flow, source_depth })
    });
    let aligned = axial.map_or(Vector2::repeat(f64::NAN), |aligned| aligned.flow);
    let r = d.norm();
    if r > 5.0 {
        f.residual("z / rho_z - t'_z of eq. radial_flow, relative to z", inverse_radial_ratio(&flow, &d) - a.z / z, 1e-12);
        f.residual("z / rho_z - t'_z after the alignment, relative to z", inverse_radial_ratio(&aligned, &d) - a.z / z, 1e-11);
    }
    if r > 5.0 && a.z.abs() > 0.01 * z {
        let ratio = radial_ratio(&flow, &d);
        f.residual("rho_z t'_z / z - 1 of eq. radial_flow", ratio * a.z / z - 1.0, 1e-12);
        let from_component = radial_ratio_of_component(flow.dot(&d) / r, r);
        f.equal("rho_z from the radial component, relative", from_component, ratio, ratio, 1e-12);
        let orthogonal = Vector2::new(-d.y, d.x) * (case.extra(0, -5.0, 5.0) * flow.norm() / r);
        let turned = radial_ratio(&(flow + orthogonal), &d);
        f.equal("rho_z with flow orthogonal to d added, relative", turned, ratio, ratio, 1e-11);
        off_centre(case, a.z / z, f);
    }
    if r > 5.0 {
        slopes(&d, case.extra_flow(4), f);
    }
}

/// `d.f` and `d.(f + d)` on the tape.
fn products<'t>(flow: Var<'t, f64>, d: &Vector2<f64>) -> [Var<'t, f64>; 2] {
    let along = flow.mul(flow.tape().constant(taped::column(d.as_slice()))).sum_chw();
    [along, along.add_scalar(d.norm_squared())]
}

fn inverse<N: Number>([f_u, f_v]: V2<N>, [d_u, d_v]: V2<f64>) -> N {
    let along = f_u * N::constant(d_u) + f_v * N::constant(d_v);
    -along / (along + N::constant(d_u * d_u + d_v * d_v))
}

/// Ratio and inverse ratio of any flow, and their derivatives by it.
fn slopes(d: &Vector2<f64>, flow: Vector2<f64>, f: &mut Findings) {
    let (offset, at): (V2<f64>, V2<f64>) = ((*d).into(), flow.into());
    let (along, whole) = (d.dot(&flow), d.dot(&(flow + d)));
    let input = [taped::column(flow.as_slice())];
    // The poles: flow across the radius for the ratio, flow that ends beside p0 for its inverse.
    if along.abs() > 1e-2 * d.norm() * flow.norm() {
        let closed = radial_ratio_gradient(&flow, d);
        let dual = forward::jacobian(at, |x| [ratio::radial_ratio(x, offset)]);
        let steps = [1e-5 * along.abs() / d.norm(); 2];
        let central = forward::central(at, steps, |x: V2<f64>| [ratio::radial_ratio(x, offset)]);
        let (value, rows) = taped::jacobian(&input, |v| {
            let [along, whole] = products(v[0], d);
            whole.div(along).neg()
        });
        let plain = radial_ratio(&flow, d);
        f.equal("rho_z on the tape - plain, relative to r / |f_r|", value[0], plain, d.norm_squared() / along, 1e-12);
        f.derivative("d rho_z / df", closed.as_slice(), Some(&dual), Some(&rows[0]), Some(&central), closed.norm());
    }
    if whole.abs() > 1e-2 * d.norm() * (flow + d).norm() && whole.abs() > 1e-2 * d.norm_squared() {
        let closed = inverse_radial_ratio_gradient(&flow, d);
        let dual = forward::jacobian(at, |x| [inverse(x, offset)]);
        let central = forward::central(at, [1e-5 * whole.abs() / d.norm(); 2], |x: V2<f64>| [inverse(x, offset)]);
        let (value, rows) = taped::jacobian(&input, |v| {
            let [along, whole] = products(v[0], d);
            along.div(whole).neg()
        });
        let plain = inverse_radial_ratio(&flow, d);
        let size = d.norm() * flow.norm() / whole.abs();
        f.equal("1 / rho_z on the tape - plain, relative to r |f| / |d.(f + d)|", value[0], plain, size, 1e-12);
        f.derivative("d(1 / rho_z) / df", closed.as_slice(), Some(&dual), Some(&rows[0]), Some(&central), closed.norm());
    }
}

/// Flow about a focus that is not the principal point: on the circle between both it has no radial part, inside the wrong one.
fn off_centre(case: &Case, share: f64, f: &mut Findings) {
    let focus = Vector2::new(case.extra(1, 5.0, 50.0), 0.0);
    let (sin, cos) = case.extra(2, 0.2, std::f64::consts::TAU - 0.2).sin_cos();
    let k = -share / (1.0 + share);
    // The angle stays off 0, where the circle runs through the focus and the flow itself vanishes.
    let on = focus * 0.5 + Vector2::new(cos, sin) * (0.5 * focus.norm());
    let flow = (on - focus) * k;
    if on.norm() > 0.1 {
        f.residual("d.f on the circle with diameter p0-e, relative to |d| |f|", on.dot(&flow) / (on.norm() * flow.norm()), 1e-12);
    }
    let [inside, outside] = [case.extra(3, 0.4, 0.9), case.extra(3, 1.2, 3.0)].map(|s| {
        let d = focus * s;
        radial_ratio(&((d - focus) * k), &d) * share
    });
    f.residual("sign of rho_z inside the circle, + 1", inside.signum() + 1.0, 0.0);
    f.residual("sign of rho_z outside the circle, - 1", outside.signum() - 1.0, 0.0);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
