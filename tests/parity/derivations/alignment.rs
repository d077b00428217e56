//! Gradients of the flow, decomposition and alignment (L18 to L35).

use dimode_geometry::aligned_scene::AlignedScene;
use dimode_geometry::alignment::corrections::{self, AlignedBoth, Referred};
use dimode_geometry::alignment::{self, Convention, Match, printed};
use dimode_geometry::backprojection::{InverseDepthPlane, source_point};
use dimode_geometry::deviation::{self, alignment_products, alignment_residual, residual_products, residual_rows};
use dimode_geometry::flow::gradients::{depth_gradient_about_focus, translational_gradients};
use dimode_geometry::flow::radial::radial_flow;
use dimode_geometry::flow::tangential::tangential_flow;
use dimode_geometry::loss_forms::{axial, planar, radial, tangential};
use dimode_geometry::motion::MotionParts;
use dimode_geometry::scenes::{self, Reference, families};
use dimode_geometry::{Intrinsics, Se3, so3};
use nalgebra::{Vector2, Vector3};
use serde_json::Value;

use super::Row;
use super::entry::{Entry, numbers};

pub const ROWS: &[Row] = &[
    ("grad-z-claim", "table", depth_gradients),
    ("residual-rows", "generic", rows_of_the_residual),
    ("residual-remark", "0.1deg", remark),
    ("residual-remark", "flow-sizes", remark_flow_sizes),
    ("align", "drive_next", reference_motion),
    ("align", "drive_prev", reference_motion),
    ("align", "turn", reference_motion),
    ("align", "handheld", reference_motion),
    ("align", "lateral", reference_motion),
    ("align", "generic", reference_motion),
    ("align-residual", "driving_yaw", family),
    ("align-residual", "driving_arc", family),
    ("align-residual", "driving_pitch", family),
    ("align-residual", "handheld", family),
    ("align-residual", "lateral", family),
    ("align-jacobian", "handheld-pixel-100", jacobian),
    ("warp-depth", "ground-plane", ground_plane),
];

fn depth_gradients(e: &Entry) {
    let (camera, z) = (e.camera(), e.number("z"));
    for (i, t) in e.rows("t_rows").iter().enumerate() {
        let t = Vector3::from_column_slice(t);
        let at = |r: &f64| camera.principal_point() - Vector2::new(*r, 0.0);
        let offsets = e.numbers("offsets_left_of_p0");
        let lengths: Vec<_> = offsets.iter().map(|r| translational_gradients(&camera, &t, &at(r), z).unwrap().z.norm()).collect();
        e.check(&format!("rows/{i}"), &lengths);
        let about_focus: Vec<_> = offsets.iter().map(|r| depth_gradient_about_focus(&camera, &t, &at(r), z).unwrap()).collect();
        e.check(&format!("rows/{i}"), &about_focus);
    }
}

fn row_major(m: &nalgebra::Matrix3<f64>) -> Vec<f64> {
    m.transpose().iter().copied().collect()
}

fn rows_of_the_residual(e: &Entry) {
    let (truth, estimate) = (e.pose("omega", "t"), e.pose("omega_hat", "t_hat"));
    e.check("dR", &row_major(&deviation::rotation_deviation(&truth, &estimate)));
    let (rows, products) = (residual_rows(&truth, &estimate), residual_products(&truth, &estimate));
    e.check("formula_rad", rows.radial.translation.as_slice());
    e.check("formula_tan", rows.tangential.translation.as_slice());
    e.check("delta_t_rad", products.radial.translation.as_slice());
    e.check("delta_t_tan", products.tangential.translation.as_slice());
    let (planar, _) = alignment_residual(&truth, &estimate);
    e.check("target_frame_formula", planar.translation.as_slice());
    e.check("target_frame_delta_t_tan", alignment_products(&truth, &estimate).0.translation.as_slice());
    let point = Vector3::new(1.3, -0.7, 9.0);
    let [after_tangential, after_radial] = deviation::partly_moved_points(&estimate, &point);
    let parts = MotionParts::in_source_frame(&truth);
    let gap = |left: Se3, moved: &Vector3<f64>| (truth.transform(&point) - left.transform(moved)).norm();
    e.check_within("procedure_gap_rad", &[gap(parts.radial * rows.radial, &after_tangential)], 1e-13);
    e.check_within("procedure_gap_tan", &[gap(parts.tangential * rows.tangential, &after_radial)], 1e-13);
}

fn remark(e: &Entry) {
    let (angle, t_rad) = (e.number("angle"), e.vector("t_rad"));
    let axes = [("pitch", [1.0, 0.0, 0.0]), ("yaw", [0.0, 1.0, 0.0]), ("roll", [0.0, 0.0, 1.0]), ("mixed", [0.6, -0.64, 0.48])];
    for (name, axis) in axes {
        let turned = so3::exp(&(Vector3::from(axis) * angle));
        let printed = deviation::printed_induced_translation(&turned, &t_rad);
        let derived = deviation::induced_translation(&turned, &t_rad);
        e.check(&format!("{name}/printed"), printed.as_slice());
        e.check(&format!("{name}/derived"), derived.as_slice());
        e.check(&format!("{name}/norm_printed"), &[printed.norm()]);
        e.check(&format!("{name}/norm_derived"), &[derived.norm()]);
    }
}

fn remark_flow_sizes(e: &Entry) {
    let (camera, angle, t_z) = (e.camera(), e.number("angle"), e.number("tz"));
    let row = |z: f64| {
        let (rotation, induced) =
            (deviation::rotation_flow_size(camera.fu, angle), deviation::induced_flow_size(camera.fu, angle, t_z, z));
        [z, rotation, induced]
    };
    e.check("rows_depth_rotflow_transflow", &[5.0, 10.0, 20.0, 40.0].map(row).concat());
}

fn reference_of(e: &Entry) -> Reference {
    let (_, case) = e.name();
    let found = scenes::references().into_iter().find(|r| r.name == case).unwrap();
    let motion = e.input("motion");
    let fields = |name: &str| <[f64; 3]>::try_from(numbers(&motion[name])).unwrap();
    assert_eq!(found.motion, scenes::motion(fields("omega"), fields("tp")));
    found
}

fn check_losses(e: &Entry, place: &str, flows: &AlignedScene, depths: &[f64], atol: f64) {
    let AlignedScene { camera, planar: pla, axial: axi, offsets: d, translation: a } = flows;
    let values = [
        ("lpla_printed", planar::printed(pla)),
        ("lpla_circ", planar::circular(pla)),
        ("lpla_wrapped", planar::wrapped(pla)),
        ("laxi_printed", axial::printed(axi, d)),
        ("laxi_signed", axial::pose_sign(axi, d, a.z)),
        ("laxi_unsigned", axial::folded(axi, d)),
        ("ltan", tangential::printed(camera, pla, depths, a)),
        ("lrad", radial::printed(axi, d, depths, a)),
    ];
    for (name, value) in values {
        e.check_within(&format!("{place}/{name}"), &[value], atol);
    }
}

fn reference_motion(e: &Entry) {
    let r = reference_of(e);
    for (place, convention, atol) in [("printed", Convention::AsPrinted, 0.0), ("target_frame", Convention::Consistent, 1e-9)] {
        check_losses(e, place, &r.scene.aligned(&r.motion, convention), &r.scene.depths, atol);
    }
    pixel_100(e, &r);
    corrected(e, &r);
}

fn pixel_100(e: &Entry, r: &Reference) {
    let (camera, m) = (&r.scene.camera, r.scene.matches(&r.motion)[100]);
    let (p, z) = (r.scene.pixels[100], r.scene.depths[100]);
    let at = |name: &str| format!("pixel_100/{name}");
    e.check(&at("p"), p.as_slice());
    e.check(&at("z"), &[z]);
    e.check(&at("z_s"), &[m.source_depth]);
    e.check(&at("p_s"), m.source.as_slice());
    for (suffix, convention) in [("printed", Convention::AsPrinted), ("target", Convention::Consistent)] {
        let a = convention.translation(&r.motion);
        let plane = alignment::planar(camera, &r.motion.rotation, &a, &m).unwrap().flow;
        let axis = alignment::axial(camera, &r.motion.rotation, &a, &m).unwrap().flow;
        e.check(&at(&format!("fpla_{suffix}")), plane.as_slice());
        e.check(&at(&format!("faxi_{suffix}")), axis.as_slice());
    }
    e.check(&at("fpla_printed"), printed::planar_flow(camera, &r.motion, &p, z).unwrap().as_slice());
    e.check(&at("faxi_printed"), printed::axial_flow(camera, &r.motion, &p, z).unwrap().as_slice());
    let in_target = r.motion.translation_in_from_frame();
    e.check(&at("tan_formula"), tangential_flow(camera, &in_target, z).as_slice());
    e.check(&at("rad_formula"), radial_flow(camera, in_target.z, &p, z).unwrap().as_slice());
}

/// Flows of corrections C and C' with the references they name.
#[derive(Default)]
struct ReferredFlows {
    planar: Vec<Vector2<f64>>,
    axial: Vec<Vector2<f64>>,
    d: Vec<Vector2<f64>>,
    depths: Vec<f64>,
}

type Correction = fn(&Intrinsics, &Se3, &Match, f64) -> Option<AlignedBoth<Referred>>;

fn referred(r: &Reference, align: Correction) -> ReferredFlows {
    let mut flows = ReferredFlows::default();
    for (m, &z) in r.scene.matches(&r.motion).iter().zip(&r.scene.depths) {
        let both = align(&r.scene.camera, &r.motion, m, z).unwrap();
        flows.planar.push(both.planar.flow);
        flows.axial.push(both.axial.flow);
        flows.d.push(both.axial.pixel - r.scene.camera.principal_point());
        flows.depths.push(both.planar.depth);
    }
    flows
}

fn corrected(e: &Entry, r: &Reference) {
    let (camera, t) = (&r.scene.camera, r.motion.translation);
    let target = r.scene.aligned(&r.motion, Convention::Consistent);
    let differences = r.scene.matches(&r.motion).into_iter().enumerate().map(|(i, m)| {
        let both = corrections::source_to_target(camera, &r.motion.inverse(), &m).unwrap();
        (both.planar.flow - target.planar[i]).amax().max((both.axial.flow - target.axial[i]).amax())
    });
    e.check_within("source_to_target_minus_target_frame_max", &[differences.fold(0.0, f64::max)], 1e-9);
    let c = referred(r, corrections::rotated_target);
    let values = [
        ("lpla_circ", planar::circular(&c.planar)),
        ("laxi_signed", axial::pose_sign(&c.axial, &c.d, t.z)),
        ("ltan", tangential::printed(camera, &c.planar, &c.depths, &t)),
        ("lrad", radial::printed(&c.axial, &c.d, &c.depths, &t)),
    ];
    for (name, value) in values {
        e.check_within(&format!("rotated_target/{name}"), &[value], 1e-9);
    }
    let moved = referred(r, corrections::moved_target);
    e.check_within("right_multiplied/lpla_circ", &[planar::circular(&moved.planar)], 1e-9);
    e.check_within("right_multiplied/laxi_signed", &[axial::pose_sign(&moved.axial, &moved.d, t.z)], 1e-9);
}

fn family(e: &Entry) {
    let (_, case) = e.name();
    let family = families::all().into_iter().find(|f| f.name == case).unwrap();
    assert_eq!(numbers(&e.input("family")["axis"]), family.axis);
    let names: Vec<_> = e.input("columns").as_array().unwrap().iter().map(|c| c.as_str().unwrap().to_owned()).collect();
    assert_eq!(names.len(), 15);
    let mut row = 0;
    for degrees in [0.5, 1.0, 2.0, 5.0, 10.0_f64] {
        for length in [0.05, 0.2, 1.0] {
            let motion = family.motion(degrees.to_radians(), length);
            e.check_within(&format!("rows/{row}"), &family_row(&family, &motion, degrees, length), 1e-11);
            row += 1;
        }
    }
}

fn family_row(family: &families::Family, motion: &Se3, degrees: f64, length: f64) -> Vec<f64> {
    let (camera, d) = (&family.scene.camera, family.scene.offsets());
    let flows = family.scene.aligned(motion, Convention::AsPrinted);
    let (t, delta) = (motion.translation, printed::defect(motion));
    let pixel = printed::pixel_terms(camera, motion, &family.scene.pixels, &family.scene.depths);
    let factors = printed::tangential_ratio_factors(motion);
    // The chord of an arc is horizontal: no motion along y, and the table says 0 for its ratio and term.
    let or_zero = |x: f64| if motion.translation_in_from_frame().y == 0.0 { 0.0 } else { x };
    vec![
        degrees,
        length,
        planar::circular(&flows.planar),
        printed::planar_loss_first_order(camera, motion, &d),
        axial::pose_sign(&flows.axial, &d, t.z),
        printed::axial_loss(camera, motion, &d),
        printed::axial_loss_first_order(camera, motion, &d),
        pixel.x,
        or_zero(pixel.y),
        pixel.z,
        factors.x,
        or_zero(factors.y),
        delta.x,
        delta.y,
        delta.z,
    ]
}

fn jacobian(e: &Entry) {
    let motion: &Value = e.input("motion");
    let fields = |name: &str| <[f64; 3]>::try_from(numbers(&motion[name])).unwrap();
    let truth = scenes::motion(fields("omega"), fields("tp"));
    let camera = scenes::hand512();
    let exact = scenes::room().matches(&truth)[e.number("pixel_index") as usize];
    assert!((exact.source - Vector2::from_column_slice(&e.numbers("p_s"))).norm() < 1e-10);
    let m = Match { source_depth: exact.source_depth * e.number("zs_hat_over_zs"), ..exact };
    let (r, a) = (so3::exp(&e.vector("omega_hat")), e.vector("tp_hat"));
    assert_eq!(alignment::unrotated_point(&camera, &r, &m), r.tr_mul(&source_point(&camera, &m.source, m.source_depth)));
    let cases = [
        ("pla", alignment::planar(&camera, &r, &a, &m), alignment::planar_jacobian(&camera, &r, &a, &m)),
        ("axi", alignment::axial(&camera, &r, &a, &m), alignment::axial_jacobian(&camera, &r, &a, &m)),
    ];
    for (name, aligned, jacobian) in cases {
        let row_major = |m: &nalgebra::Matrix2x3<f64>| m.transpose().iter().copied().collect::<Vec<f64>>();
        e.check(&format!("f{name}"), aligned.unwrap().flow.as_slice());
        e.check(&format!("d_{name}_d_rot"), &row_major(&jacobian.rotation));
        e.check(&format!("d_{name}_d_t"), &row_major(&jacobian.translation));
        e.check(&format!("d_{name}_d_zs"), jacobian.source_depth.as_slice());
    }
}

fn ground_plane(e: &Entry) {
    let [a, b, c] = <[f64; 3]>::try_from(e.numbers("inverse_depth_plane")).unwrap();
    let plane = InverseDepthPlane { a, b, c };
    for (name, v) in ["far", "near"].into_iter().zip(e.numbers("v")) {
        let p = Vector2::new(320.0, v + e.number("half_pixel"));
        let cell = plane.cell(&p);
        e.check(&format!("true_{name}"), &[plane.depth(&p)]);
        e.check(&format!("linear_{name}"), &[cell.by_depth()]);
        e.check(&format!("inverse_{name}"), &[cell.by_inverse_depth()]);
    }
}
