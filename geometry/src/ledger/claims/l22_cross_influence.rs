//! L22: what tangential and radial translation do to each other's gradients.

use nalgebra::{Vector2, Vector3};

use crate::alignment::axial_jacobian;
use crate::flow::gradients::{
    mixed_second_derivatives, radial_influence, tangential_influence, tangential_influence_radius, translational_gradients,
};
use crate::ledger::flow_derivatives::{Input, ways};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, forward, taped};
use crate::scenes;

pub(super) static CLAIM: Claim = Claim {
    id: "L22",
    slug: "cross-influence",
    place: "text after eq. grad_tz",
    statement: "The gradients of t_x and t_y are influenced by t_z, and the other way round.",
    verdict: Verdict::Conditional,
    condition: Some(
        "t_x, t_y: by the share t_z / z of their size, never of their direction; t_z: mainly for r < |f o t_tan| / z",
    ),
    formula: "d ln |df/dt_x| / dt_z = -1 / (z + t_z);  d2f / dt_x dt_z = -(f_u, 0) / (z + t_z)^2;  share of t_tan in df/dt_z: \
         |f o t_tan| / (r z)",
    derivation: "df/dt_x = (f_u, 0) / (z + t_z) depends on t_z through the source depth only. df/dt_z = -[d z + f o t_tan] / (z \
         + t_z)^2 is the sum of a share of the offset and one of t_tan, in the proportion r z to |f o t_tan|. The alignment \
         takes away the dependence on the estimate of the other part, not on the truth: df_axi/dt_x = -f_u / z' with z' = z + \
         t'_z.",
    counter_example: Some(
        "z = 20, t_z = 0.8: df/dt_x changes by 4 %, its direction not at all. The share of t_tan in df/dt_z outweighs the other \
         only within 0.42 px of p0 at 20 m for the median pair of KITTI odometry 00-10, and within 6.6 px at 4.36 m for the \
         hand-held motion of the room.",
    ),
    correction: Some("The influence is of second order for t_x and t_y; for t_z it is confined to the surroundings of p0."),
    functions: &[
        "flow::gradients::radial_influence",
        "flow::gradients::mixed_second_derivatives",
        "flow::gradients::tangential_influence",
        "flow::gradients::tangential_influence_radius",
    ],
    taped: &["taped::rigid_flow", "taped::so3_exp"],
    missing_way: Some(
        "Forward mode and tape are of first order: second derivatives come from central differences of their first ones.",
    ),
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let f = &mut trial.findings;
    let by_x = |t_z: f64| {
        translational_gradients(&scenes::kitti640(), &Vector3::new(0.3, 0.0, t_z), &Vector2::new(451.0, 63.0), 20.0)
            .map_or(f64::NAN, |g| g.t_x.x)
    };
    let unchanged = by_x(0.8) / by_x(0.0);
    let first_order = 1.0 + 0.8 * radial_influence(20.0, 0.0);
    f.bound("|share of df/dt_x left - first order|, by (t_z / z)^2", (unchanged - first_order).abs() / 0.04f64.powi(2), 1.0);
    f.gap("share of df/dt_x that t_z = 0.8 leaves alone at 20 m", unchanged, 0.9);
    let (hand, pixel) = (scenes::handheld(), 100);
    let (camera, z, t) = (&hand.scene.camera, hand.scene.depths[pixel], hand.motion.translation_in_from_frame());
    f.documented(
        "radius of influence, hand-held at 4.36 m, px",
        tangential_influence_radius(camera, &t, z),
        5.50098096764f64.hypot(3.68565724832),
        1e-10,
    );
    let corner = Vector2::new(0.0, 0.0);
    f.gap("share of the offset in df/dt_z at the image corner", 1.0 - tangential_influence(camera, &t, &corner, z), 0.9);
    let gradient =
        axial_jacobian(camera, &hand.motion.rotation, &t, &hand.scene.matches(&hand.motion)[pixel]).translation[(0, 0)];
    f.documented("df_axi/dt_x = -f_u / z', px/m", gradient, -camera.fu / (z + t.z), 1e-11);
    f.gap("change of df_axi/dt_x with the true t'_z, relative", gradient * z / camera.fu + 1.0, 0.0168);
}

/// `df/dt_x`, `df/dt_y` and `df/dt_z` at another translation, in forward mode.
fn gradients(case: &Case, t: Vector3<f64>) -> [Vector2<f64>; 3] {
    let (camera, p, z) = (&case.camera, case.pixel, case.depth);
    let dual = forward::jacobian([t.x, t.y, t.z], |t| {
        forward::rigid_flow(camera, forward::fixed([0.0; 3]), t, forward::fixed(p.into()), forward::fixed([z])[0]).0
    });
    std::array::from_fn(|k| Vector2::new(dual[k], dual[3 + k]))
}

fn at(case: &Case, f: &mut Findings) {
    let case = case.without_rotation();
    let (camera, t, z) = (&case.camera, case.motion.translation, case.depth);
    let (h, source_depth) = (1e-6 * z, z + t.z);
    let along = |k: usize| [gradients(&case, t + Vector3::ith(k, h)), gradients(&case, t - Vector3::ith(k, h))];
    let (x, y, radial) = (along(0), along(1), along(2));
    let slope = |pair: &[[Vector2<f64>; 3]; 2], k: usize| (pair[0][k] - pair[1][k]) / (2.0 * h);
    let [by_x, by_y] = mixed_second_derivatives(camera, z, t.z);
    let scale = camera.fu.max(camera.fv) / (source_depth * source_depth);
    for (closed, first, second) in [(by_x, slope(&radial, 0), slope(&x, 2)), (by_y, slope(&radial, 1), slope(&y, 2))] {
        f.derivative("d(df/dt_x)/dt_z, d(df/dt_y)/dt_z", closed.as_slice(), None, None, Some(first.as_slice()), scale);
        f.derivative("d(df/dt_z)/dt_x, d(df/dt_z)/dt_y", closed.as_slice(), None, None, Some(second.as_slice()), scale);
    }
    for (above, below) in radial[0].iter().zip(&radial[1]).take(2) {
        let (above_size, below_size) = (above.norm(), below.norm());
        let logarithm = (above_size / below_size).ln() / (2.0 * h);
        let closed = radial_influence(z, t.z);
        f.derivative("d ln |df/dt_x| / dt_z", &[closed], None, None, Some(&[logarithm]), 1.0 / source_depth);
        f.residual("turn of df/dt_x, df/dt_y with t_z, rad", above.perp(below) / (above_size * below_size), 1e-12);
    }
    taped_second(&case, f);
    shares(&case, f);
}

/// The mixed derivative from differences of the tape's gradients.
fn taped_second(case: &Case, f: &mut Findings) {
    let (t, h) = (case.motion.translation, 1e-6 * case.depth);
    let gradient = |t_z: f64| {
        let (_, rows) = taped::rigid_flow(&case.camera, &Vector3::zeros(), &Vector3::new(t.x, t.y, t_z), &case.pixel, case.depth);
        Vector2::new(rows[0][3], rows[1][3])
    };
    let taped = (gradient(t.z + h) - gradient(t.z - h)) / (2.0 * h);
    let [by_x, _] = mixed_second_derivatives(&case.camera, case.depth, t.z);
    let scale = case.camera.fu / (case.depth + t.z).powi(2);
    f.derivative("d(df/dt_x)/dt_z from the tape's gradients", by_x.as_slice(), None, None, Some(taped.as_slice()), scale);
}

/// `df/dt_z` as the sum of the offset's and the tangential translation's share.
fn shares(case: &Case, f: &mut Findings) {
    let (t, d) = (case.motion.translation, case.offset());
    let whole = ways(case).forward[Input::Radial as usize];
    let offset_only = gradients(case, Vector3::new(0.0, 0.0, t.z))[2];
    let ratio = tangential_influence(&case.camera, &t, &case.pixel, case.depth);
    // Compared as a product: at the principal point the ratio has no value.
    if d.norm() > 1e-3 {
        let scale = whole.norm() + offset_only.norm();
        f.equal("share of t_tan in df/dt_z, relative", (whole - offset_only).norm(), ratio * offset_only.norm(), scale, 1e-9);
    }
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
