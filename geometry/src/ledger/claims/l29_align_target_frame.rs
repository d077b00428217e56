//! L29: the alignment with the translation split in the target frame (correction B).

use nalgebra::Vector2;

use crate::alignment::{Convention, axial, planar};
use crate::flow::{radial::radial_flow, rigid::rigid_flow, tangential::tangential_flow};
use crate::ledger::{Case, Claim, Findings, Trial, Verdict, taped};
use crate::{scenes, so3};

pub(super) static CLAIM: Claim = Claim {
    id: "L29",
    slug: "align-target-frame",
    place: "correction B of eq. pplanar",
    statement: "With the parts of t' = R^T t in place of those of t, Q_pla = P_t + tan(t') and Q_axi = P_t + rad(t').",
    verdict: Verdict::Exact,
    condition: Some("P_s = R (P_t + t'): if a network's numbers are taken as t', eq. p_s reads R (z K^-1 p~ + t')"),
    formula: "f_pla = f o t'_tan / z,  f_axi = -t'_z / (z + t'_z) d,  T = T_rot T_rad T_tan",
    derivation: "R^-1 P_s = P_t + t'. Subtracting rad(t') leaves P_t + tan(t') at depth z, subtracting tan(t') leaves P_t + \
         rad(t') at depth z + t'_z: the flows of L14 and L15. Target pixel, target depth and principal point stay as printed.",
    counter_example: None,
    correction: None,
    functions: &["alignment::Convention::translation", "alignment::planar", "alignment::axial"],
    taped: &["taped::rigid_flow", "taped::so3_exp", "taped::translation_in_target_frame", "taped::align"],
    missing_way: None,
    check,
};

fn check(trial: &mut Trial) {
    trial.cases(at);
    let hand = scenes::handheld();
    let (camera, rotation) = (&hand.scene.camera, &hand.motion.rotation);
    let exact = hand.scene.matches(&hand.motion)[100];
    let cases = [
        (Convention::Consistent, [5.50098096764, 3.68565724832], [-3.42761755499, -1.63442253984]),
        (Convention::AsPrinted, [5.32409395425, 3.60236651532], [-3.7131295388, -1.96920494175]),
    ];
    for (convention, pla, axi) in cases {
        let a = convention.translation(&hand.motion);
        for (aligned, expected) in [(planar(camera, rotation, &a, &exact), pla), (axial(camera, rotation, &a, &exact), axi)] {
            let flow = aligned.map_or(Vector2::repeat(f64::NAN), |aligned| aligned.flow);
            for k in 0..2 {
                trial.findings.documented("aligned flows of a hand-held pixel, documented", flow[k], expected[k], 1e-11);
            }
        }
    }
}

fn at(case: &Case, f: &mut Findings) {
    let (camera, motion, z) = (&case.camera, &case.motion, case.depth);
    let nowhere = Vector2::repeat(f64::NAN);
    let Some(exact) = case.exact_match() else {
        return f.residual("point in front of the camera", f64::NAN, 1.0);
    };
    let a = Convention::Consistent.translation(motion);
    let plane = planar(camera, &motion.rotation, &a, &exact);
    let axis = axial(camera, &motion.rotation, &a, &exact);
    let tangential = tangential_flow(camera, &a, z);
    let radial = radial_flow(camera, a.z, &case.pixel, z).unwrap_or(nowhere);
    f.residual("f_pla - f o t'_tan / z, px", (plane.map_or(nowhere, |x| x.flow) - tangential).norm(), 1e-10);
    f.residual("f_axi + t'_z / (z + t'_z) d, px", (axis.map_or(nowhere, |x| x.flow) - radial).norm(), 1e-10);
    f.residual("depth of Q_pla - z, relative", (plane.map_or(f64::NAN, |x| x.depth) - z) / z, 1e-12);
    f.residual("depth of Q_axi - (z + t'_z), relative", (axis.map_or(f64::NAN, |x| x.depth) - z - a.z) / z, 1e-12);
    let moved = camera.project(&(motion.rotation * (case.point() + a))).unwrap_or(nowhere);
    let rigid = rigid_flow(camera, motion, &case.pixel, z).map_or(nowhere, |(flow, _)| flow);
    // Two ways to one pixel that may lie far outside the image: rounding is that of its coordinates.
    f.residual("pixel of R (P_t + t') - p_s, by 1 + |p_s|", (moved - case.pixel - rigid).norm() / (1.0 + moved.norm()), 1e-12);
    on_tape(case, [tangential, radial], f);
}

/// Rigid flow, split and alignment on the tape.
fn on_tape(case: &Case, expected: [Vector2<f64>; 2], f: &mut Findings) {
    let tape = dimode_autodiff::Tape::new();
    let one_pixel = [taped::pixel_camera(&case.camera, &case.pixel)];
    let rotation = crate::taped::so3_exp(tape.constant(taped::column(so3::log(&case.motion.rotation).as_slice())));
    let t = tape.constant(taped::column(case.motion.translation.as_slice()));
    let rigid = crate::taped::rigid_flow(tape.constant(taped::column(&[case.depth])), rotation, t, &one_pixel);
    let a = crate::taped::translation_in_target_frame(rotation, t);
    let aligned = crate::taped::align(rigid.slice(1, 2, 1), rotation, a, rigid.slice(1, 0, 2), &one_pixel).value();
    for (k, expected) in expected.into_iter().enumerate() {
        let found = Vector2::new(aligned.at(0, 2 * k, 0, 0), aligned.at(0, 2 * k + 1, 0, 0));
        f.residual("taped alignment - closed forms, px", (found - expected).norm(), 1e-9);
    }
}

#[cfg(test)]
mod tests {
    crate::ledger::testing::tests_on_cases!(super::at);
}
