//! L60: information in the radial ratio under flow noise.

use dimode_autodiff::proof::Number;
use nalgebra::Vector3;

use crate::flow::tangential::tangential_flow;
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::quadrature::GaussLegendre;
use crate::ratio_noise::{
    least_radius, normal_upper_tail, radial_depth_noise, radial_ratio_slope, sign_flip_probability, tangential_depth_noise,
};
use crate::ratios::{radial_flow_component, radial_ratio_noise, radial_ratio_of_component, tangential_ratios};

pub(super) static CLAIM: Claim = Claim {
    id: "L60",
    slug: "rho-z-noise",
    place: "text after eq. lr",
    statement: "The radial ratio constrains depth consistently across the whole map.",
    verdict: Verdict::Fails,
    condition: None,
    formula: "d rho_z / d f_r = r / f_r^2;  std(rho_z) = sigma (z + t_z)^2 / (t_z^2 r);  P(wrong sign) = Phi(-|f_r| / sigma)",
    derivation: "rho_z = -1 - r / f_r; differentiate, and insert f_r = -t_z r / (z + t_z). The variance is proportional to 1 / \
                 r^2: a pixel's information grows with r^2, however equal the gradients are. When the noise turns the sign of \
                 f_r, the ratio has the wrong sign. For comparison rho_x = f_u / f_x: relative error sigma z / (f_u |t_x|) at \
                 every pixel.",
    counter_example: Some(
        "sigma = 0.5 px, z = 20 m, t_z = -0.8 m: std(rho_z) 144 at r = 2 px, 2.88 at 100 px, 0.96 at 300 px; relative error of \
         depth 5.76, 0.1152, 0.0384; wrong sign with probability 0.434, 4e-17, 3e-138.",
    ),
    correction: Some(
        "Weight by r^2, or use r > 5 sigma (z + t_z)^2 / (z |t_z|), 58 px in this case, for a relative error below 0.2; at t_z \
         = -0.1 m no pixel of the image is that far out.",
    ),
    functions: &[
        "ratio_noise::radial_ratio_slope",
        "ratios::radial_ratio_noise",
        "ratio_noise::radial_depth_noise",
        "ratio_noise::tangential_depth_noise",
        "ratio_noise::sign_flip_probability",
        "ratio_noise::least_radius",
    ],
    taped: &["losses::radial"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    let table = [
        (-0.8, 2.0, 144.0, 5.76, 0.43381616738909634),
        (-0.8, 50.0, 5.76, 0.2304, 1.5454296882296e-5),
        (-0.8, 100.0, 2.88, 0.1152, 3.929873434851047e-17),
        (-0.8, 300.0, 0.96, 0.0384, 3.05669670638245e-138),
        (-0.1, 2.0, 9900.25, 49.50125, 0.4919815996400442),
        (-0.1, 300.0, 66.0016666667, 0.330008333333, 0.0012845769911206983),
    ];
    for (t_z, r, std, relative, flip) in table {
        f.documented("std(rho_z), documented", radial_ratio_noise(0.5, 20.0, t_z, r), std, 1e-11);
        f.documented("relative depth error, documented", radial_depth_noise(0.5, 20.0, t_z, r), relative, 1e-11);
        let found = sign_flip_probability(radial_flow_component(20.0, t_z, r), 0.5);
        f.documented("P(wrong sign), documented", found, flip, 1e-11);
    }
    f.documented("radius for a relative error of 0.2, px, documented", least_radius(0.5, 20.0, -0.8, 0.2), 57.6, 1e-12);
    let spread = |t_z: f64| radial_depth_noise(0.5, 20.0, t_z, 2.0) / radial_depth_noise(0.5, 20.0, t_z, 300.0);
    f.gap("variance of rho_z at r = 2 px over that at 300 px", spread(-0.8).powi(2), 0.9 * 22500.0);
    f.gap("radius for a relative error of 0.2 at t_z = -0.1 m, px", least_radius(0.5, 20.0, -0.1, 0.2), 0.9 * 495.0);
}

fn ratio<N: Number>(f_r: N, r: f64) -> N {
    -(N::constant(r) + f_r) / f_r
}

fn at(case: &Case, f: &mut Findings) {
    let (z, t_z, r) = (case.depth, case.motion.translation.z, case.extra(0, 5.0, 400.0));
    let f_r = radial_flow_component(z, t_z, r);
    tangential(case, f);
    tail(case.extra(1, 0.0, 30.0), f);
    if f_r.abs() <= 1e-2 {
        return;
    }
    let closed = radial_ratio_slope(f_r, r);
    f.equal("r / f_r^2 - (z + t_z)^2 / (t_z^2 r), relative", closed, radial_ratio_noise(1.0, z, t_z, r), closed, 1e-12);
    f.equal("rho_z - z / t_z, relative", radial_ratio_of_component(f_r, r), z / t_z, z / t_z, 1e-12);
    let dual = forward::jacobian([f_r], |[x]| [ratio(x, r)]);
    let central = forward::central([f_r], [1e-5 * f_r.abs()], |[x]| [ratio(x, r)]);
    let (_, rows) = taped::jacobian(&[taped::column(&[f_r])], |v| v[0].add_scalar(r).div(v[0]).neg());
    f.derivative("d rho_z / d f_r", &[closed], Some(&dual), Some(&rows[0]), Some(&central), closed);
    // Relative depth error times radius: the same at any other radius.
    let elsewhere = case.extra(2, 5.0, 400.0);
    let [here, there] = [r, elsewhere].map(|r| radial_depth_noise(0.5, z, t_z, r) * r);
    f.equal("depth error times radius, here and elsewhere, relative", here, there, here, 1e-12);
    let limit = case.extra(3, 0.05, 1.0);
    let reached = radial_depth_noise(0.5, z, t_z, least_radius(0.5, z, t_z, limit));
    f.equal("depth error at the least radius - its limit, relative", reached, limit, limit, 1e-12);
}

/// `rho_x`: the relative depth that it implies, and its slope, without any radius.
fn tangential(case: &Case, f: &mut Findings) {
    let (camera, z, t) = (&case.camera, case.depth, case.motion.translation);
    let flow = tangential_flow(camera, &Vector3::new(t.x, 0.0, 0.0), z);
    if flow.x.abs() <= 1e-2 {
        return;
    }
    let at = tangential_ratios(camera, &flow).x * t.x / z;
    f.residual("rho_x t_x / z - 1", at - 1.0, 1e-12);
    fn depth<N: Number>(f_x: N, scale: f64) -> N {
        N::constant(scale) / f_x
    }
    let (scale, x) = (camera.fu * t.x / z, flow.x);
    // Depth falls as the flow grows along its own direction.
    let closed = -x.signum() * tangential_depth_noise(camera, 1.0, z, t.x);
    let dual = forward::jacobian([x], |[x]| [depth(x, scale)]);
    let central = forward::central([x], [1e-5 * x.abs()], |[x]| [depth(x, scale)]);
    let (_, rows) = taped::jacobian(&[taped::column(&[x])], |v| v[0].tape().constant(taped::column(&[scale])).div(v[0]));
    f.derivative("d(rho_x t_x / z) / d f_x", &[closed], Some(&dual), Some(&rows[0]), Some(&central), closed.abs());
}

/// Mass of the bell above `x` by quadrature, relative to its value at `x`.
fn tail(x: f64, f: &mut Findings) {
    let rule = GaussLegendre::new();
    let end = (x * x + 90f64).sqrt() - x;
    let relative = rule.integral(0.0, end, 8, |s| (-s * (x + 0.5 * s)).exp());
    let bell = (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    f.equal("normal tail - quadrature, relative", normal_upper_tail(x), relative * bell, relative * bell, 1e-11);
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
