//! Direction losses (L36 to L50).

use dimode_geometry::aligned_scene::AlignedScene;
use dimode_geometry::loss_forms::{axial, planar, radial, tangential};
use dimode_geometry::noise::{self, axial_angle_mean, planar_angle_variance};
use dimode_geometry::observability::{axial_information, planar_information};
use dimode_geometry::scenes::{self, Reference, Scene};
use dimode_geometry::sensitivity::{
    Response, axial_response, mean_magnitude, planar_response, principal_point_angle, root_mean_square, spread,
};
use dimode_geometry::{Intrinsics, Se3};
use nalgebra::{Vector2, Vector3};

use super::Row;
use super::entry::{Entry, numbers};

pub const ROWS: &[Row] = &[
    ("lpla", "mirror", forms),
    ("lpla", "antiparallel_vertical", forms),
    ("lpla", "leftward_wrap", forms),
    ("lpla", "fan_about_x", forms),
    ("lpla", "fan_about_y", forms),
    ("lpla", "parallel", forms),
    ("lpla", "one_flip_in_four", forms),
    ("lpla", "fold-on-scene", folding),
    ("lpla-gradient", "four-vectors", gradients),
    ("lpla-gradient", "arccos-conditioning", conditioning),
    ("noise-floor", "road-0.5px", noise_floor),
    ("laxi-sign", "snippet", snippet),
    ("laxi-sign", "tx-error-sweep", sweep),
    ("sensitivity", "drive_next", sensitivity),
    ("sensitivity", "handheld", sensitivity),
    ("sensitivity", "lateral", sensitivity),
    ("sensitivity-finite", "drive_next", finite_errors),
    ("sensitivity-finite", "handheld", finite_errors),
    ("sensitivity-finite", "lateral", finite_errors),
    ("observability", "handheld", observability),
    ("principal-point", "drive_next", principal_point),
];

/// Absolute tolerance for losses that are zero in exact arithmetic.
const ZERO: f64 = 1e-9;

fn flows(e: &Entry) -> Vec<Vector2<f64>> {
    e.rows("flows").iter().map(|f| Vector2::from_column_slice(f)).collect()
}

fn forms(e: &Entry) {
    let flows = flows(e);
    e.check_within("printed", &[planar::printed(&flows)], ZERO);
    e.check_within("var_atan2", &[planar::unfolded(&flows)], ZERO);
    e.check_within("circ", &[planar::circular(&flows)], ZERO);
    e.check_within("weighted", &[planar::weighted(&flows)], ZERO);
}

/// `t_z` taken a fifth too large, without rotation.
fn folding(e: &Entry) {
    for (i, row) in e.rows("tp_rows").iter().enumerate() {
        let motion = Se3 { translation: Vector3::from_column_slice(row), ..Se3::identity() };
        let reference = Reference { name: "fold", scene: scenes::room(), motion };
        let seen = AlignedScene::with_error(&reference, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.2 * row[2]]).unwrap().planar;
        let found = [planar::printed, planar::wrapped, planar::circular, planar::weighted, planar::unfolded].map(|f| f(&seen));
        e.check(&format!("rows/{i}"), &found);
    }
}

fn gradients(e: &Entry) {
    let flows = flows(e);
    let list = |gradient: Vec<Vector2<f64>>| -> Vec<f64> { gradient.iter().flat_map(|g| [g.x, g.y]).collect() };
    e.check("circ", &[planar::circular(&flows)]);
    e.check("weighted", &[planar::weighted(&flows)]);
    e.check("printed", &[planar::printed(&flows)]);
    e.check("circ_grad", &list(planar::gradients::circular(&flows)));
    e.check("weighted_grad", &list(planar::gradients::weighted(&flows)));
    e.check("printed_grad", &list(planar::gradients::printed(&flows)));
}

fn conditioning(e: &Entry) {
    let row = |&v: &f64| {
        let flow = Vector2::new(e.number("fx"), v);
        let gradient = planar::gradients::folded_angle(&flow);
        [v, planar::gradients::arccos_slope(&flow), gradient.x, gradient.y]
    };
    let table: Vec<f64> = e.numbers("fy").iter().flat_map(row).collect();
    e.check("rows_fy_dacosdc_dthetadfx_dthetadfy", &table);
}

fn noise_floor(e: &Entry) {
    let (road, sigma) = (scenes::road(), e.number("sigma_px"));
    for (i, t) in e.rows("t_tan").iter().enumerate() {
        let variance = planar_angle_variance(&road.camera, &Vector3::new(t[0], t[1], 0.0), &road.depths, sigma);
        e.check(&format!("lpla_small_noise_variance/{i}"), &[variance]);
    }
    let means: Vec<f64> =
        e.numbers("t_z").iter().map(|&t_z| axial_angle_mean(&road.offsets(), &road.depths, t_z, sigma)).collect();
    e.check("laxi_small_noise_mean", &means);
    e.check("uniform_direction_var_arccos", &[noise::PRINTED_CEILING]);
    e.check("uniform_direction_circ", &[noise::CIRCULAR_CEILING]);
}

/// Printed, sign-aware and unsigned axial loss with an error of `t_x`.
fn axial_losses(reference: &Reference, t_x: f64) -> [f64; 3] {
    let s = AlignedScene::with_error(reference, &[0.0, 0.0, 0.0, t_x, 0.0, 0.0]).unwrap();
    [
        axial::printed(&s.axial, &s.offsets),
        axial::pose_sign(&s.axial, &s.offsets, s.translation.z),
        axial::folded(&s.axial, &s.offsets),
    ]
}

fn snippet(e: &Entry) {
    for reference in [scenes::drive_next(), scenes::drive_prev()] {
        for (form, found) in ["printed", "signed", "unsigned"].into_iter().zip(axial_losses(&reference, 0.0)) {
            e.check(&format!("{}/{form}", reference.name), &[found]);
        }
    }
}

fn sweep(e: &Entry) {
    for reference in [scenes::drive_next(), scenes::drive_prev()] {
        for (i, &error) in e.numbers("tx_error").iter().enumerate() {
            let [printed, signed, unsigned] = axial_losses(&reference, error);
            e.check(&format!("{}/{i}", reference.name), &[error, printed, signed, unsigned]);
        }
    }
}

/// The reference motion that the entry is named after.
fn reference(e: &Entry) -> Reference {
    scenes::references().into_iter().find(|r| r.name == e.name().1).unwrap()
}

fn responses(scene: &Scene, a: &Vector3<f64>) -> [Vec<Response>; 2] {
    [planar_response, axial_response]
        .map(|of| scene.pixels.iter().zip(&scene.depths).map(|(p, &z)| of(&scene.camera, a, p, z)).collect())
}

fn sensitivity(e: &Entry) {
    let reference = reference(e);
    let [planar, axial] = responses(&reference.scene, &reference.motion.translation_in_from_frame());
    e.check("pla_std", &spread(&planar));
    e.check("axi_mean_abs", &mean_magnitude(&axial));
    e.check("axi_rms", &root_mean_square(&axial));
}

/// 0.1 deg about each axis, then 1 % of the translation's length along each.
fn finite_errors(e: &Entry) {
    let reference = reference(e);
    let (camera, depths) = (&reference.scene.camera, &reference.scene.depths);
    let length = reference.motion.translation.norm();
    for k in 0..6 {
        let mut error = [0.0; 6];
        error[k] = if k < 3 { 0.1f64.to_radians() } else { 0.01 * length };
        let s = AlignedScene::with_error(&reference, &error).unwrap();
        let found = [
            planar::circular(&s.planar),
            planar::printed(&s.planar),
            axial::pose_sign(&s.axial, &s.offsets, s.translation.z),
            tangential::printed(camera, &s.planar, depths, &s.translation),
            radial::printed(&s.axial, &s.offsets, depths, &s.translation),
        ];
        e.check_within(&format!("rows/{k}"), &found, 1e-11);
    }
}

fn observability(e: &Entry) {
    let reference = reference(e);
    let a = reference.motion.translation_in_from_frame();
    let wall = reference.scene.at_depth(e.number("constant_depth"));
    for (name, scene) in [("varied", &reference.scene), ("constant", &wall)] {
        let [planar, axial] = responses(scene, &a);
        let ones = vec![1.0; planar.len()];
        // Both matrices are symmetric: columns are rows.
        e.check_within(&format!("{name}/G_pla"), planar_information(&planar, &ones).as_slice(), 1e-10);
        e.check_within(&format!("{name}/G_axi"), axial_information(&axial, &ones).as_slice(), 1e-10);
    }
}

/// The scene is seen by a camera whose centre lies off the one that the alignments assume.
fn principal_point(e: &Entry) {
    let reference = scenes::drive_next();
    let (scene, a) = (&reference.scene, reference.motion.translation_in_from_frame());
    for name in ["half_pixel", "kitti_0926", "kitti_seq00"] {
        let error = Vector2::from_column_slice(&numbers(&e.input("true_minus_assumed_px")[name]));
        let truth = Intrinsics { u0: scene.camera.u0 + error.x, v0: scene.camera.v0 + error.y, ..scene.camera };
        let matches = Scene { camera: truth, ..scene.clone() }.matches(&reference.motion);
        let s = AlignedScene::new(&scene.camera, &reference.motion.rotation, &a, &matches).unwrap();
        e.check(&format!("{name}/laxi"), &[axial::pose_sign(&s.axial, &s.offsets, a.z)]);
        e.check(&format!("{name}/lpla"), &[planar::circular(&s.planar)]);
        e.check(&format!("{name}/laxi_first_order"), &[principal_point_angle(&error, &s.offsets)]);
    }
}
