//! Alignment with imaging plane and optical axis (eqs. `pplanar`, `disflow`) as one operation.
//!
//! Source pixel `p_s = p + f_opt`, ray `b = (x + f_u/fu, y + f_v/fv, 1)` with the target ray `(x, y, 1)`,
//! `e = (R^T - I) b`, `Y = D (b + e)`. With `n_x = f_u/fu + e_x - x e_z` and `n_z = 1 + e_z`:
//! `z_pla = D n_z - a_z`, `f_pla,u = fu (D n_x + x a_z) / z_pla`,
//! `z_axi = D n_z`, `f_axi,u = fu (D n_x - a_x) / z_axi`, and the same for v.
//!
//! Vector-Jacobian products, with `A = g_pla f / z_pla`, `B = g_axi f / z_axi` (two components each),
//! `C_pla = g_zpla - (g_pla . f_pla) / z_pla`, `C_axi` likewise and `S = (A + B, C_pla + C_axi)`:
//! to `D`: `n . S`; to `a`: `-B_x`, `-B_y`, `x A_x + y A_y - C_pla`; to `e`: `D (S_x, S_y, S_z - x S_x - y S_y)`;
//! from there to `R` through `b` and to the flow through `b` and `n`. Pixels without incoming gradient have none, whatever they hold.

use dimode_autodiff::{GradSink, Scalar, Shape, Tensor, Var, par};

use super::MIN_DEPTH;
use super::bands::{Band, Motion, bands, bands_per_sample, dot, sum};
use super::pose::rotate;
use super::rigid_flow::{add_sums, check_motion, sums_per_sample};
use crate::camera::Intrinsics;

/// `R^T t`: translations (N,3,1,1) expressed in the target frame.
///
/// **Panics** unless rotations are (N,1,3,3) and translations (N,3,1,1).
#[track_caller]
pub fn translation_in_target_frame<'t, T: Scalar>(rotation: Var<'t, T>, translation: Var<'t, T>) -> Var<'t, T> {
    rotate(rotation.transpose_hw(), translation)
}

/// Planar and axial flow with their depths.
///
/// **Shapes**: `source_depth` (N,1,H,W), the source depth found at `p + flow`; `rotation` (N,1,3,3) of
/// `source_from_target`; `translation` (N,3,1,1), the `a` of the chosen convention; `flow` (N,2,H,W), pixels.
/// Result (N,6,H,W): `f_pla` u and v, `f_axi` u and v (pixels), `z_pla`, `z_axi`.
/// **Domain**: where a depth is `<=` [`MIN_DEPTH`] its flow is 0 and no gradient passes through it; mask by the
/// depth channels.
/// **Gradient**: to all four inputs.
/// **Panics** when a shape does not fit.
#[track_caller]
pub fn align<'t, T: Scalar>(
    source_depth: Var<'t, T>,
    rotation: Var<'t, T>,
    translation: Var<'t, T>,
    flow: Var<'t, T>,
    intrinsics: &[Intrinsics],
) -> Var<'t, T> {
    let shape = source_depth.shape();
    let (n, h, w) = (shape.n(), shape.h(), shape.w());
    assert!(shape.c() == 1, "align: source depth has shape (N, 1, H, W), got {shape}");
    assert!(flow.shape() == Shape::new(n, 2, h, w), "align: flow has shape ({n}, 2, {h}, {w}), got {}", flow.shape());
    check_motion("align", shape, rotation.shape(), translation.shape(), intrinsics);
    let (r, a) = (rotation.value(), translation.value());
    let motions: Vec<Motion<T>> =
        intrinsics.iter().enumerate().map(|(n, k)| Motion::new(k, r.data(), a.data(), n, true)).collect();
    let (depth, optical) = (source_depth.value(), flow.value());
    let tape = source_depth.tape();
    let mut out = tape.scratch(6 * shape.len());
    forward(&motions, shape, depth.data(), optical.data(), &mut out);
    let out = tape.tensor(Shape::new(n, 6, h, w), out);
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        let (mut grad_depth, mut grad_flow) = (grads.scratch(shape.len()), grads.scratch(2 * shape.len()));
        let inputs = [depth.data(), optical.data(), g.data()];
        let sums = backward(&motions, shape, inputs, &mut grad_depth, &mut grad_flow);
        for (k, gradient) in [(0, grad_depth), (3, grad_flow)] {
            match grads.slot(k) {
                Some(mut slot) => slot.add_fresh(gradient),
                None => grads.give_back(gradient),
            }
        }
        add_sums(grads, 1, &sums, 0..9);
        add_sums(grads, 2, &sums, 9..12);
    };
    tape.push("align", out, &[source_depth, rotation, translation, flow], record)
}

fn forward<T: Scalar>(motions: &[Motion<T>], shape: Shape, depth: &[T], flow: &[T], out: &mut [T]) {
    let (h, w) = (shape.h(), shape.w());
    let plane = h * w;
    par::for_each_item(bands::<T, 6>(out, h, w), |_, band| {
        let m = &motions[band.sample];
        let x = m.ray_columns(w);
        let depth = &depth[band.sample * plane..][..plane];
        let flow = &flow[band.sample * 2 * plane..][..2 * plane];
        let mut channels = band.channels.map(|c| c.chunks_exact_mut(w));
        let rows = channels[0].len();
        for row in band.first_row..band.first_row + rows {
            let out = channels.each_mut().map(|c| c.next().expect("bands have whole rows"));
            let at = row * w;
            forward_row(m, m.ray_row(row), &x, &depth[at..][..w], [&flow[at..][..w], &flow[plane + at..][..w]], out);
        }
    });
}

#[inline(always)]
fn forward_row<T: Scalar>(m: &Motion<T>, y: T, x: &[T], depth: &[T], flow: [&[T]; 2], out: [&mut [T]; 6]) {
    let w = x.len();
    let depth = &depth[..w];
    let [fu, fv] = flow.map(|f| &f[..w]);
    let [pla_u, pla_v, axi_u, axi_v, z_pla, z_axi] = out.map(|o| &mut o[..w]);
    let (inv_fu, inv_fv) = m.inverse_focal();
    let [ax, ay, az] = m.t;
    let min = T::from_f64(MIN_DEPTH);
    #[allow(clippy::needless_range_loop)] // one index over many rows
    for j in 0..w {
        let d = depth[j];
        let (dx, dy) = (fu[j] * inv_fu, fv[j] * inv_fv);
        let e = turn(m, x[j] + dx, y + dy);
        let (nx, ny, nz) = (dx + e[0] - x[j] * e[2], dy + e[1] - y * e[2], T::ONE + e[2]);
        let (zp, za) = (d * nz - az, d * nz);
        let ip = if zp > min { T::ONE / zp } else { T::ZERO };
        let ia = if za > min { T::ONE / za } else { T::ZERO };
        pla_u[j] = m.fu * (d * nx + x[j] * az) * ip;
        pla_v[j] = m.fv * (d * ny + y * az) * ip;
        axi_u[j] = m.fu * (d * nx - ax) * ia;
        axi_v[j] = m.fv * (d * ny - ay) * ia;
        z_pla[j] = zp;
        z_axi[j] = za;
    }
}

/// `(R^T - I) (x, y, 1)`.
#[inline(always)]
fn turn<T: Scalar>(m: &Motion<T>, x: T, y: T) -> [T; 3] {
    std::array::from_fn(|i| m.e[i][0] * x + m.e[i][1] * y + m.e[i][2])
}

/// Fills the gradients of source depth and flow; returns the sums for rotation (9) and translation (3).
fn backward<T: Scalar>(
    motions: &[Motion<T>],
    shape: Shape,
    inputs: [&[T]; 3],
    grad_depth: &mut [T],
    grad_flow: &mut [T],
) -> Vec<[f64; 12]> {
    let (h, w) = (shape.h(), shape.w());
    let mut band_sums = vec![[0.0; 12]; shape.n() * bands_per_sample(h)];
    let gradients = bands::<T, 1>(grad_depth, h, w).into_iter().zip(bands::<T, 2>(grad_flow, h, w));
    let items: Vec<_> = gradients.zip(&mut band_sums).collect();
    par::for_each_item(items, |_, ((depth, flow), sums)| {
        backward_band(&motions[depth.sample], h, w, inputs, depth, flow, sums);
    });
    sums_per_sample(&band_sums, h)
}

fn backward_band<T: Scalar>(
    m: &Motion<T>,
    h: usize,
    w: usize,
    inputs: [&[T]; 3],
    grad_depth: Band<'_, T, 1>,
    grad_flow: Band<'_, T, 2>,
    sums: &mut [f64; 12],
) {
    let x = m.ray_columns(w);
    let (plane, sample) = (h * w, grad_depth.sample);
    let row_of = |k: usize, channels: usize, c: usize, row: usize| &inputs[k][(sample * channels + c) * plane + row * w..][..w];
    let [grad_depth] = grad_depth.channels;
    let [grad_u, grad_v] = grad_flow.channels;
    let first_row = grad_flow.first_row;
    let mut s = Scratch::new(w);
    let rows = grad_depth.chunks_exact_mut(w).zip(grad_u.chunks_exact_mut(w)).zip(grad_v.chunks_exact_mut(w));
    for (i, ((gd, gu), gv)) in rows.enumerate() {
        let row = first_row + i;
        let flow = [row_of(1, 2, 0, row), row_of(1, 2, 1, row)];
        let g = std::array::from_fn(|c| row_of(2, 6, c, row));
        backward_row(m, m.ray_row(row), &x, row_of(0, 1, 0, row), flow, g, [gd, gu, gv], &mut s);
        for k in 0..3 {
            // e_k = sum_j E_kj b_j with E = R^T - I: the gradient of E_kj belongs to R_jk.
            sums[k] += dot(&s.to_e[k], &s.xs);
            sums[3 + k] += dot(&s.to_e[k], &s.ys);
            sums[6 + k] += sum(&s.to_e[k]);
            sums[9 + k] += sum(&s.to_a[k]);
        }
    }
}

/// Per-row numbers whose sums give the gradients of rotation and translation.
struct Scratch<T> {
    xs: Vec<T>,
    ys: Vec<T>,
    to_e: [Vec<T>; 3],
    to_a: [Vec<T>; 3],
}

impl<T: Scalar> Scratch<T> {
    fn new(w: usize) -> Self {
        let row = || vec![T::ZERO; w];
        Self { xs: row(), ys: row(), to_e: [row(), row(), row()], to_a: [row(), row(), row()] }
    }
}

#[inline(always)]
#[allow(clippy::too_many_arguments)] // one row of every array of the operation
fn backward_row<T: Scalar>(
    m: &Motion<T>,
    y: T,
    x: &[T],
    depth: &[T],
    flow: [&[T]; 2],
    g: [&[T]; 6],
    grad: [&mut [T]; 3],
    s: &mut Scratch<T>,
) {
    let w = x.len();
    let depth = &depth[..w];
    let [fu, fv] = flow.map(|f| &f[..w]);
    let [g1, g2, g3, g4, g5, g6] = g.map(|g| &g[..w]);
    let [grad_depth, grad_u, grad_v] = grad.map(|g| &mut g[..w]);
    let (xs, ys) = (&mut s.xs[..w], &mut s.ys[..w]);
    let [ex, ey, ez] = s.to_e.each_mut().map(|r| &mut r[..w]);
    let [to_ax, to_ay, to_az] = s.to_a.each_mut().map(|r| &mut r[..w]);
    let (inv_fu, inv_fv) = m.inverse_focal();
    let [ax, ay, az] = m.t;
    let min = T::from_f64(MIN_DEPTH);
    #[allow(clippy::needless_range_loop)] // one index over many rows
    for j in 0..w {
        // What no gradient comes from may be anything, and 0 times anything may be NaN: sums over pixels must not see it.
        let g = [g1[j], g2[j], g3[j], g4[j], g5[j], g6[j]];
        let used = g.iter().fold(false, |used, &g| used | (g != T::ZERO));
        let d = if used { depth[j] } else { T::ONE };
        let (dx, dy) = if used { (fu[j] * inv_fu, fv[j] * inv_fv) } else { (T::ZERO, T::ZERO) };
        xs[j] = x[j] + dx;
        ys[j] = y + dy;
        let e = turn(m, xs[j], ys[j]);
        let (nx, ny, nz) = (dx + e[0] - x[j] * e[2], dy + e[1] - y * e[2], T::ONE + e[2]);
        let (zp, za) = (d * nz - az, d * nz);
        let (ip, gp) = if zp > min { (T::ONE / zp, g5[j]) } else { (T::ZERO, T::ZERO) };
        let (ia, ga) = if za > min { (T::ONE / za, g6[j]) } else { (T::ZERO, T::ZERO) };
        let (pu, pv) = (g1[j] * m.fu * ip, g2[j] * m.fv * ip);
        let (au, av) = (g3[j] * m.fu * ia, g4[j] * m.fv * ia);
        let cp = gp - (pu * (d * nx + x[j] * az) + pv * (d * ny + y * az)) * ip;
        let ca = ga - (au * (d * nx - ax) + av * (d * ny - ay)) * ia;
        let (sx, sy, sz) = (pu + au, pv + av, cp + ca);
        grad_depth[j] = nx * sx + ny * sy + nz * sz;
        to_ax[j] = -au;
        to_ay[j] = -av;
        to_az[j] = x[j] * pu + y * pv - cp;
        ex[j] = d * sx;
        ey[j] = d * sy;
        ez[j] = d * (sz - x[j] * sx - y * sy);
        let through = |k: usize| m.e[0][k] * ex[j] + m.e[1][k] * ey[j] + m.e[2][k] * ez[j];
        grad_u[j] = (ex[j] + through(0)) * inv_fu;
        grad_v[j] = (ey[j] + through(1)) * inv_fv;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alignment::{Convention, Match, axial, planar};
    use crate::taped::pose::pose_tensors;
    use crate::taped::rigid_flow::rigid_flow;
    use crate::{Se3, testing};
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};
    use nalgebra::{Vector2, Vector3};

    fn camera(shift: f64) -> Intrinsics {
        Intrinsics::new(12.0 + shift, 13.0, 5.2, 9.1 - shift, 11, 19).unwrap()
    }

    fn inputs() -> [Tensor<f64>; 4] {
        let motions = [
            Se3::from_rotation_vector(&Vector3::new(0.05, -0.08, 0.1), Vector3::new(0.2, -0.1, 0.4)),
            Se3::from_rotation_vector(&Vector3::new(-0.02, 0.03, 0.06), Vector3::new(0.0, 0.3, -0.5)),
        ];
        let (r, a) = pose_tensors(&motions);
        [random(3, Shape::new(2, 1, 19, 11), 2.0, 9.0), r, a, random(4, Shape::new(2, 2, 19, 11), -2.0, 2.0)]
    }

    #[test]
    fn equals_the_plain_alignment() {
        let tape = Tape::new();
        let [d, r, a, f] = inputs();
        let cameras = [camera(0.0), camera(1.0)];
        let out = align(tape.leaf(d.clone()), tape.leaf(r.clone()), tape.leaf(a.clone()), tape.leaf(f.clone()), &cameras).value();
        #[allow(clippy::needless_range_loop)] // the sample indexes several lists
        for n in 0..2 {
            let rotation = nalgebra::Matrix3::from_fn(|i, j| r.at(n, 0, i, j));
            let a = Vector3::from_fn(|i, _| a.at(n, i, 0, 0));
            for (v, u) in [(0, 0), (18, 10), (7, 3)] {
                let target = Vector2::new(u as f64, v as f64);
                let source = target + Vector2::new(f.at(n, 0, v, u), f.at(n, 1, v, u));
                let m = Match { target, source, source_depth: d.at(n, 0, v, u) };
                let plane = planar(&cameras[n], &rotation, &a, &m).unwrap();
                let axis = axial(&cameras[n], &rotation, &a, &m).unwrap();
                let expected = [plane.flow.x, plane.flow.y, axis.flow.x, axis.flow.y, plane.depth, axis.depth];
                for (c, expected) in expected.into_iter().enumerate() {
                    assert!((out.at(n, c, v, u) - expected).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn gradients_match_differences() {
        let cameras = [camera(0.0), camera(1.0)];
        gradcheck(&inputs(), |_, v| weighted_sum(align(v[0], v[1], v[2], v[3], &cameras), 5), GradCheck::default()).assert_ok();
    }

    #[test]
    fn planar_flow_ignores_tangential_and_axial_flow_radial_translation() {
        let tape = Tape::new();
        let [d, r, a, f] = inputs().map(|x| tape.leaf(x));
        let out = align(d, r, a, f, &[camera(0.0), camera(1.0)]);
        let pla = tape.backward(weighted_sum(out.slice(1, 0, 2), 1)).wrt(a);
        let axi = tape.backward(weighted_sum(out.slice(1, 2, 2), 1)).wrt(a);
        for n in 0..2 {
            assert_eq!((pla.at(n, 0, 0, 0), pla.at(n, 1, 0, 0), axi.at(n, 2, 0, 0)), (0.0, 0.0, 0.0));
            assert!(pla.at(n, 2, 0, 0) != 0.0 && axi.at(n, 0, 0, 0) != 0.0);
        }
    }

    #[test]
    fn exact_scene_leaves_one_translation_each() {
        for motion in
            [testing::motion([0.01, 0.03, -0.02], [0.1, -0.05, -0.4]), testing::motion([0.0, -0.02, 0.0], [0.1, 0.2, 0.5])]
        {
            let tape = Tape::<f64>::new();
            let k = camera(0.0);
            let depth = random(3, Shape::new(1, 1, 19, 11), 2.0, 9.0);
            let (r, t) = pose_tensors(&[motion]);
            let (r, t) = (tape.leaf(r), tape.leaf(t));
            let rigid = rigid_flow(tape.leaf(depth.clone()), r, t, &[k]);
            let a = translation_in_target_frame(r, t);
            let out = align(rigid.slice(1, 2, 1), r, a, rigid.slice(1, 0, 2), &[k]).value();
            let a = Convention::Consistent.translation(&motion);
            for (v, u) in [(0, 0), (18, 10), (7, 3)] {
                let z = depth.at(0, 0, v, u);
                assert!((out.at(0, 0, v, u) - k.fu * a.x / z).abs() < 1e-12);
                assert!((out.at(0, 3, v, u) + a.z / (z + a.z) * (v as f64 - k.v0)).abs() < 1e-12);
                assert!((out.at(0, 4, v, u) - z).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn points_behind_get_no_flow_and_no_gradient() {
        let tape = Tape::<f64>::new();
        let k = Intrinsics::new(3.0, 3.0, 1.0, 0.0, 2, 1).unwrap();
        let (r, a) = pose_tensors(&[Se3 { translation: Vector3::new(0.1, 0.0, 5.0), ..Se3::identity() }]);
        let d = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 2), vec![4.0, 8.0]));
        let f = tape.leaf(Tensor::full(Shape::new(1, 2, 1, 2), 0.5));
        let out = align(d, tape.leaf(r), tape.leaf(a), f, &[k]);
        assert_eq!(out.value().at(0, 0, 0, 0), 0.0);
        assert_eq!(out.value().at(0, 4, 0, 0), -1.0);
        let planar_only = out.slice(1, 0, 2).sum();
        let grad = tape.backward(planar_only).wrt(d).to_vec();
        assert!(grad[0] == 0.0 && grad[1] != 0.0, "{grad:?}");
    }

    #[test]
    fn pixels_that_no_one_uses_may_hold_anything() {
        let [d, r, a, f] = inputs();
        let cameras = [camera(0.0), camera(1.0)];
        let spoilt =
            |x: &Tensor<f64>, bad: f64| Tensor::from_fn(x.shape(), |n, c, v, u| if v > 9 { bad } else { x.at(n, c, v, u) });
        let gradients = |d: Tensor<f64>, f: Tensor<f64>| {
            let tape = Tape::new();
            let vars = [d, r.clone(), a.clone(), f].map(|x| tape.leaf(x));
            let out = align(vars[0], vars[1], vars[2], vars[3], &cameras);
            let grads = tape.backward(weighted_sum(out.slice(2, 0, 10), 5));
            vars.map(|v| grads.wrt(v))
        };
        let expected = gradients(d.clone(), f.clone());
        for bad in [f64::NAN, f64::INFINITY, 0.0] {
            for found in [gradients(spoilt(&d, bad), f.clone()), gradients(d.clone(), spoilt(&f, bad))] {
                assert!(found.iter().zip(&expected).all(|(a, b)| a == b), "{bad}");
            }
        }
    }

    #[test]
    fn same_bits_on_any_number_of_threads() {
        let run = || {
            let tape = Tape::<f32>::new();
            let vars = inputs().map(|x| tape.leaf(x.cast::<f32>()));
            let out = align(vars[0], vars[1], vars[2], vars[3], &[camera(0.0), camera(1.0)]);
            let grads = tape.backward(weighted_sum(out, 5));
            vars.map(|v| grads.wrt(v).to_vec().iter().map(|x| x.to_bits()).collect::<Vec<_>>())
        };
        assert_eq!(par::with_threads(1, run), par::with_threads(3, run));
    }
}
