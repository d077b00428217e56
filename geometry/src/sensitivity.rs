//! How the directions of aligned flows answer to small errors of the estimate, to first order (L47, L48, L50).
//!
//! Errors are ordered `w_x, w_y, w_z, a_x, a_y, a_z`: `eps` in `R exp([eps]_x)`, radians, and the translation `a = t'` in the
//! target frame, in units of depth. Responses are rad per rad and rad per unit of depth, at the true motion.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::alignment::{self, Match};
use crate::camera::Intrinsics;
use crate::flow::tangential::focal_scaled;
use crate::loss_forms::mean;

/// Responses to the six errors.
pub type Response = [f64; 6];

/// Response of the angle of the planar flow at a pixel.
///
/// **Formula**: with `F = f o a_tan`, `Q = P + a` and the point's motion `q = -(e_k x Q)`:
/// `J_wk = F x [f o (q_xy - Q_xy q_z / z)] / |F|^2`, proportional to depth; `J_ax = J_ay = 0`; `J_az = (F x d) / |F|^2`.
/// **Domain**: `F` not 0.
#[must_use]
pub fn planar_response(camera: &Intrinsics, a: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> Response {
    let tangential = focal_scaled(camera, a);
    let q = camera.ray(p.x, p.y) * z + a;
    let (across, upright) = (q.x * q.y / z, [q.z + q.x * q.x / z, q.z + q.y * q.y / z]);
    let about = |x: f64, y: f64| tangential.perp(&Vector2::new(camera.fu * x, camera.fv * y)) / tangential.norm_squared();
    let radial = tangential.perp(&(p - camera.principal_point())) / tangential.norm_squared();
    [about(across, upright[1]), about(-upright[0], -across), about(q.y, -q.x), 0.0, 0.0, radial]
}

/// Response of the angle of the axial flow at a pixel.
///
/// **Formula**: with `d = p - p0`, `z' = z + a_z`, `Q = P + a`: `J_ax = -f_u d_v / (a_z r^2)`, `J_ay = f_v d_u / (a_z r^2)`,
/// `J_wx = -z' J_ay`, `J_wy = z' J_ax`, `J_wz = (f_v d_u Q_x + f_u d_v Q_y) / (a_z r^2)`, `J_az = 0`.
/// **Domain**: `a_z` not 0, `p` not the principal point.
#[must_use]
pub fn axial_response(camera: &Intrinsics, a: &Vector3<f64>, p: &Vector2<f64>, z: f64) -> Response {
    let d = p - camera.principal_point();
    let q = camera.ray(p.x, p.y) * z + a;
    let size = a.z * d.norm_squared();
    let (a_x, a_y) = (-camera.fu * d.y / size, camera.fv * d.x / size);
    let roll = (camera.fv * d.x * q.x + camera.fu * d.y * q.y) / size;
    [-q.z * a_y, q.z * a_x, roll, a_x, a_y, 0.0]
}

/// The responses of all pixels to each error.
fn by_error(responses: &[Response]) -> [Vec<f64>; 6] {
    std::array::from_fn(|k| responses.iter().map(|r| r[k]).collect())
}

/// Mean magnitude of the responses: `L_axi = |eps| B` for a small error `eps` of one kind.
#[must_use]
pub fn mean_magnitude(responses: &[Response]) -> Response {
    by_error(responses).map(|j| mean(j.iter().map(|x| x.abs())))
}

/// Root of the mean square of the responses.
#[must_use]
pub fn root_mean_square(responses: &[Response]) -> Response {
    by_error(responses).map(|j| mean(j.iter().map(|x| x * x)).sqrt())
}

/// Standard deviation of the responses over the pixels: `L_pla = eps^2 A^2` for a small error `eps` of one kind; what all
/// flows turn by together costs nothing.
#[must_use]
pub fn spread(responses: &[Response]) -> Response {
    by_error(responses).map(|j| {
        let centre = mean(j.iter().copied());
        mean(j.iter().map(|x| (x - centre).powi(2))).sqrt()
    })
}

/// Mean angle by which `L_axi` misses when the principal point is `error` off (true minus assumed, pixels):
/// `E[|error x d| / r^2]`, rad.
///
/// **Domain**: first order in the error and without rotation; a rotation by `w` adds terms of the relative size
/// `|w| z' / |a_z|`, see [`principal_point_response`].
#[must_use]
pub fn principal_point_angle(error: &Vector2<f64>, d: &[Vector2<f64>]) -> f64 {
    mean(d.iter().map(|d| error.perp(d).abs() / d.norm_squared()))
}

/// Response of the angle from the radius to the axial flow to an error of the assumed principal point (true minus assumed),
/// rad per pixel, with everything else true.
///
/// **Formula**: the source ray moves by `K^-1 (e, 0)`, so that the aligned point moves by `z_s R^T K^-1 (e, 0)` and the axial
/// flow by `G e` with `G = z_s / z_axi (r_2 - (p_a - p0) (r_z / f)) - 1`, where `r_2` is `f R^T f^-1` and `r_z` the third row of
/// `R^T`, each with two columns only, and `p_a` the end of the axial flow; the radius moves by `e`:
/// `J = f x G / |f|^2 - d x 1 / r^2`. Without rotation `G = 0`, and `J e = -(d x e) / r^2`.
/// **Domain**: in front of the camera, `f` and `d` not 0.
#[must_use]
pub fn principal_point_response(
    camera: &Intrinsics,
    rotation: &Matrix3<f64>,
    a: &Vector3<f64>,
    m: &Match,
) -> Option<Vector2<f64>> {
    let aligned = alignment::axial(camera, rotation, a, m)?;
    let d = m.target - camera.principal_point();
    let (focal, inverse) = (Vector2::new(camera.fu, camera.fv), Vector2::new(1.0 / camera.fu, 1.0 / camera.fv));
    let turn = rotation.transpose() * (m.source_depth / aligned.depth);
    let plane = Matrix2::from_fn(|i, j| focal[i] * turn[(i, j)] * inverse[j]);
    let forward = Vector2::from_fn(|j, _| turn[(2, j)] * inverse[j]);
    let flow_moves = plane - (d + aligned.flow) * forward.transpose() - Matrix2::identity();
    let column = |j: usize| {
        let unit = Vector2::ith(j, 1.0);
        let moves: Vector2<f64> = flow_moves.column(j).into();
        aligned.flow.perp(&moves) / aligned.flow.norm_squared() - d.perp(&unit) / d.norm_squared()
    };
    Some(Vector2::new(column(0), column(1)))
}
