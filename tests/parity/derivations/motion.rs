//! Preliminaries and motion components (L01 to L27).

use dimode_geometry::flow::gradients::{rigid_gradients, translational_gradients};
use dimode_geometry::flow::radial::{radial_flow, scale_change, scale_change_first_order};
use dimode_geometry::flow::rigid::{printed_correspondence, rigid_flow, rigid_flow_by_parts};
use dimode_geometry::flow::rotational::{printed_quadratic_terms, quadratic_terms, rotational_flow, rotational_flow_first_order};
use dimode_geometry::flow::tangential::tangential_flow;
use dimode_geometry::flow::translational::{flow_about_focus, flow_from_parts, focus_of_expansion, translational_flow};
use dimode_geometry::flow::uniformity::uniformity;
use dimode_geometry::homography::{rotation_homography, transfer};
use dimode_geometry::motion::{translation_gap, translation_gap_first_order};
use dimode_geometry::photometric::{Moments, photometric_error};
use dimode_geometry::removal::{printed_rotation_first, rotation_first, translation_first, without_translation};
use dimode_geometry::{Intrinsics, Se3, scenes, so3};
use nalgebra::{Matrix3, Vector2, Vector3};

use super::Row;
use super::entry::Entry;

pub const ROWS: &[Row] = &[
    ("intrinsics", "ray", ray),
    ("rigid-flow", "generic", rigid),
    ("photometric", "constant-images", photometric),
    ("decomposition", "frames", frames),
    ("rot-flow", "generic", rotational),
    ("rot-flow", "optical-axis", rotational),
    ("rot-flow", "yaw-1deg-spread", yaw),
    ("rot-flow", "deviation-from-uniform-1deg", deviation),
    ("rot-flow-first-order", "error-growth", first_order),
    ("footnote-order", "generic", order),
    ("footnote-order", "commutator", commutator),
    ("tan-flow", "generic", tangential),
    ("rad-flow", "tz=0.6", radial),
    ("rad-flow", "tz=-0.8", radial),
    ("scale-change", "table", scale),
    ("combined-flow", "generic", combined),
    ("combined-flow", "with-rotation", with_rotation),
];

fn ray(e: &Entry) {
    let (camera, p) = (e.camera(), e.pixel());
    let ray = camera.ray(p.x, p.y);
    e.check("ray", ray.as_slice());
    e.check("k_ray", (camera.matrix() * ray).as_slice());
}

fn radial(e: &Entry) {
    let (camera, p, z, t) = (e.camera(), e.pixel(), e.number("z"), e.vector("t"));
    let point = camera.ray(p.x, p.y) * z + Vector3::new(0.0, 0.0, t.z);
    e.check("flow", (camera.project(&point).unwrap() - p).as_slice());
    e.check("formula", radial_flow(&camera, t.z, &p, z).unwrap().as_slice());
    e.check("scale", &[scale_change(z, t.z)]);
}

/// Entries of a matrix, row by row.
fn by_rows(m: &Matrix3<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

fn rigid(e: &Entry) {
    let (camera, p, z, motion) = (e.camera(), e.pixel(), e.number("z"), e.pose("omega", "t"));
    e.check("R", &by_rows(&motion.rotation));
    e.check("p_s_cam", motion.transform(&(camera.ray(p.x, p.y) * z)).as_slice());
    let (flow, depth) = rigid_flow(&camera, &motion, &p, z).unwrap();
    e.check("flow", flow.as_slice());
    e.check("p_s", (p + flow).as_slice());
    e.check("z_s", &[depth]);
    let printed = printed_correspondence(&camera, &motion, &p, z, 1.1 * depth);
    e.check("homogeneous_if_zs_is_10pct_high", printed.as_slice());
}

fn photometric(e: &Entry) {
    let (a, b) = (e.number("a"), e.number("b"));
    let similarity = Moments::of(&[a; 9], &[b; 9]).similarity(e.number("c1"), e.number("c2"));
    e.check("ssim", &[similarity]);
    e.check("loss", &[photometric_error(&[similarity; 3], &[a - b; 3], e.number("alpha"))]);
}

fn frames(e: &Entry) {
    let motion = e.pose("omega", "t");
    e.check("R", &by_rows(&motion.rotation));
    e.check("t_target_frame", motion.translation_in_from_frame().as_slice());
    e.check("delta", translation_gap(&motion).as_slice());
    e.check("first_order_delta", translation_gap_first_order(&e.vector("omega"), &e.vector("t")).as_slice());
}

fn rotational(e: &Entry) {
    let (camera, p, omega) = (e.camera(), e.pixel(), e.vector("omega"));
    let rotation = so3::exp(&omega);
    let h = rotation_homography(&camera, &rotation);
    let (_, ratio) = transfer(&h, &p).unwrap();
    let (flow, terms, printed) =
        (rotational_flow(&camera, &rotation, &p).unwrap(), quadratic_terms(&h, &p), printed_quadratic_terms(&h, &p));
    e.check("H", &by_rows(&h));
    e.check("flow", flow.as_slice());
    e.check("quadratic_terms", terms.as_slice());
    e.check("printed_expansion", printed.as_slice());
    e.check("flow_with_printed_expansion", (flow + (printed - terms) / ratio).as_slice());
    let motion = Se3 { rotation, translation: Vector3::zeros() };
    for (i, z) in e.numbers("depths").into_iter().enumerate() {
        e.check(&format!("flow_at_depths/{i}"), rigid_flow(&camera, &motion, &p, z).unwrap().0.as_slice());
    }
    e.check("first_order_flow", rotational_flow_first_order(&camera, &omega, &p).as_slice());
    e.check("zs_over_zt", &[ratio]);
}

fn yaw(e: &Entry) {
    let (camera, rotation) = (e.camera(), so3::exp(&e.vector("omega")));
    for (i, p) in e.rows("pixels").into_iter().enumerate() {
        let flow = rotational_flow(&camera, &rotation, &Vector2::new(p[0], p[1])).unwrap();
        e.check_within(&format!("flow/{i}"), flow.as_slice(), 1e-9);
    }
}

fn deviation(e: &Entry) {
    assert_eq!(e.input("scene"), "road");
    let (scene, angle) = (scenes::road(), e.number("angle"));
    for (name, axis) in [("pitch", Vector3::x()), ("yaw", Vector3::y()), ("roll", Vector3::z())] {
        let rotation = so3::exp(&(axis * angle));
        let flows: Vec<_> = scene.pixels.iter().map(|p| rotational_flow(&scene.camera, &rotation, p).unwrap()).collect();
        let found = uniformity(&flows).unwrap();
        e.check_within(&format!("{name}/mean"), found.mean.as_slice(), 1e-9);
        e.check(&format!("{name}/rms_deviation"), &[found.rms_deviation]);
    }
}

fn first_order(e: &Entry) {
    assert_eq!(e.input("scene"), "road");
    let scene = scenes::road();
    let largest = |angle: f64| {
        let omega = e.vector("axis") * angle;
        let error = |p: &Vector2<f64>| {
            let exact = rotational_flow(&scene.camera, &so3::exp(&omega), p).unwrap();
            (exact - rotational_flow_first_order(&scene.camera, &omega, p)).norm()
        };
        scene.pixels.iter().map(error).fold(0.0, f64::max)
    };
    let errors: Vec<_> = e.numbers("angles").into_iter().map(largest).collect();
    e.check("max_error_px", &errors);
}

fn order(e: &Entry) {
    let (camera, p, motion) = (e.camera(), e.pixel(), e.pose("omega", "t"));
    let source = motion.transform(&(camera.ray(p.x, p.y) * e.number("z")));
    let pixel = |point: Vector3<f64>| camera.project(&point).unwrap();
    e.check("translation_removed_first", pixel(without_translation(&motion, &source)).as_slice());
    e.check("homography", transfer(&rotation_homography(&camera, &motion.rotation), &p).unwrap().0.as_slice());
    e.check("rotation_first_then_t", pixel(printed_rotation_first(&motion, &source)).as_slice());
    e.check("p_t", pixel(rotation_first(&motion, &source)).as_slice());
    e.check("p_t", pixel(translation_first(&motion, &source)).as_slice());
}

fn commutator(e: &Entry) {
    let norm = |a: f64| so3::commutator(&(Vector3::x() * a), &(Vector3::y() * a)).norm();
    let found: Vec<_> = e.numbers("angles").into_iter().map(norm).collect();
    e.check("frobenius", &found);
}

fn tangential(e: &Entry) {
    let (camera, p, z, t) = (e.camera(), e.pixel(), e.number("z"), e.vector("t"));
    let (flow, depth) = rigid_flow(&camera, &Se3 { translation: t, ..Se3::identity() }, &p, z).unwrap();
    e.check("flow", flow.as_slice());
    e.check("formula", tangential_flow(&camera, &t, z).as_slice());
    e.check("z_s", &[depth]);
}

fn scale(e: &Entry) {
    let mut rows = Vec::new();
    for z in e.numbers("z") {
        for t_z in e.numbers("tz") {
            rows.extend([z, t_z, scale_change(z, t_z) - 1.0, scale_change_first_order(z, t_z) - 1.0, -t_z / (z + t_z)]);
        }
    }
    e.check("rows_z_tz_scalechange_first_order_exact", &rows);
}

/// The flow by all of its closed forms without rotation.
fn translational_forms(camera: &Intrinsics, t: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> [Vector2<f64>; 3] {
    [translational_flow, flow_from_parts, flow_about_focus].map(|form| form(camera, t, p, z).unwrap())
}

fn combined(e: &Entry) {
    let (camera, p, z, t) = (e.camera(), e.pixel(), e.number("z"), e.vector("t"));
    for flow in translational_forms(&camera, &t, &p, z) {
        e.check("flow", flow.as_slice());
    }
    let (tangential, radial) = (tangential_flow(&camera, &t, z), radial_flow(&camera, t.z, &p, z).unwrap());
    let flow = translational_flow(&camera, &t, &p, z).unwrap();
    e.check("f_tan", tangential.as_slice());
    e.check("f_rad", radial.as_slice());
    e.check("sum_minus_combined", (tangential + radial - flow).as_slice());
    e.check("foe", focus_of_expansion(&camera, &t).unwrap().as_slice());
    let gradients = translational_gradients(&camera, &t, &p, z).unwrap();
    e.check("gradients/z", gradients.z.as_slice());
    e.check("gradients/tx", gradients.t_x.as_slice());
    e.check("gradients/ty", gradients.t_y.as_slice());
    e.check("gradients/tz", gradients.t_z.as_slice());
}

fn with_rotation(e: &Entry) {
    let (camera, p, z, motion) = (e.camera(), e.pixel(), e.number("z"), e.pose("omega", "t"));
    e.check("flow", rigid_flow(&camera, &motion, &p, z).unwrap().0.as_slice());
    let (rotational, rest) = rigid_flow_by_parts(&camera, &motion, &p, z).unwrap();
    e.check("via_rotated_pixel", (rotational + rest).as_slice());
    let (rotated, ratio) = transfer(&rotation_homography(&camera, &motion.rotation), &p).unwrap();
    e.check("p_rotated", rotated.as_slice());
    e.check("z_rotated", &[z * ratio]);
    e.check("grad_z", rigid_gradients(&camera, &motion, &p, z).unwrap().z.as_slice());
}
