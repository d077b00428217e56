//! Flow of a static scene (eq. `p_s`) as one operation.
//!
//! With the ray `b = (x, y, 1)`, `e = (R - I) b` and `Z = z (1 + e_z) + t_z`:
//! `f_u = fu (z (e_x - x e_z) + t_x - x t_z) / Z`, `f_v` likewise. Written this way nothing cancels: no
//! motion gives exactly no flow, and single precision keeps its digits for small motions.
//!
//! Vector-Jacobian products, with `a = g_u fu / Z`, `b = g_v fv / Z`, `c = g_z - (g_u f_u + g_v f_v) / Z`:
//! to the depth `a (e_x - x e_z) + b (e_y - y e_z) + c (1 + e_z)`; to `t` the sums of
//! `(a, b, c - a x - b y)`; to row `i` of `R` the sums of `z` times those numbers times the ray. Pixels without incoming gradient
//! have none, whatever they hold.

use dimode_autodiff::{GradSink, Scalar, Shape, Tensor, Var, par};

use super::MIN_DEPTH;
use super::bands::{Band, Motion, bands, bands_per_sample, dot, sum};
use crate::camera::Intrinsics;

/// Flow from target to source and the source depth of every target pixel.
///
/// **Shapes**: `depth` (N,1,H,W); `rotation` (N,1,3,3) and `translation` (N,3,1,1) of `source_from_target`; one
/// camera a sample, used for both views. Result (N,3,H,W): flow u, flow v (pixels), source depth `z_s`.
/// **Domain**: where `z_s <=` [`MIN_DEPTH`] the flow is 0 and no gradient passes; mask by the third channel.
/// **Gradient**: to depth, rotation and translation.
/// **Panics** when a shape does not fit.
#[track_caller]
pub fn rigid_flow<'t, T: Scalar>(
    depth: Var<'t, T>,
    rotation: Var<'t, T>,
    translation: Var<'t, T>,
    intrinsics: &[Intrinsics],
) -> Var<'t, T> {
    let shape = depth.shape();
    assert!(shape.c() == 1, "rigid_flow: depth has shape (N, 1, H, W), got {shape}");
    check_motion("rigid_flow", shape, rotation.shape(), translation.shape(), intrinsics);
    let (r, t, z) = (rotation.value(), translation.value(), depth.value());
    let motions: Vec<Motion<T>> =
        intrinsics.iter().enumerate().map(|(n, k)| Motion::new(k, r.data(), t.data(), n, false)).collect();
    let tape = depth.tape();
    let mut out = tape.scratch(3 * shape.len());
    forward(&motions, shape, z.data(), &mut out);
    let out = tape.tensor(Shape::new(shape.n(), 3, shape.h(), shape.w()), out);
    let record = move |g: &Tensor<T>, grads: &mut GradSink<'_, T>| {
        let mut grad_depth = grads.scratch(shape.len());
        let sums = backward(&motions, shape, z.data(), g.data(), &mut grad_depth);
        match grads.slot(0) {
            Some(mut slot) => slot.add_fresh(grad_depth),
            None => grads.give_back(grad_depth),
        }
        add_sums(grads, 1, &sums, 0..9);
        add_sums(grads, 2, &sums, 9..12);
    };
    tape.push("rigid_flow", out, &[depth, rotation, translation], record)
}

/// Shape checks shared with the alignment.
#[track_caller]
pub(crate) fn check_motion(op: &str, map: Shape, rotation: Shape, translation: Shape, intrinsics: &[Intrinsics]) {
    let n = map.n();
    assert!(rotation == Shape::new(n, 1, 3, 3), "{op}: rotation has shape ({n}, 1, 3, 3), got {rotation}");
    assert!(translation == Shape::new(n, 3, 1, 1), "{op}: translation has shape ({n}, 3, 1, 1), got {translation}");
    assert!(intrinsics.len() == n, "{op}: {} cameras for {n} samples", intrinsics.len());
    for (i, k) in intrinsics.iter().enumerate() {
        assert!(
            (k.height, k.width) == (map.h(), map.w()),
            "{op}: camera {i} belongs to {}x{} pixels, the map has {}x{}; resize the intrinsics with the image",
            k.width,
            k.height,
            map.w(),
            map.h()
        );
    }
}

/// Adds the sums of a range to the gradient of parent `k`.
pub(crate) fn add_sums<T: Scalar>(grads: &mut GradSink<'_, T>, k: usize, sums: &[[f64; 12]], range: std::ops::Range<usize>) {
    if let Some(mut slot) = grads.slot(k) {
        let values = sums.iter().flat_map(|s| &s[range.clone()]);
        slot.as_mut_slice().iter_mut().zip(values).for_each(|(g, &x)| *g += T::from_f64(x));
    }
}

/// Adds band sums up, sample by sample in order.
pub(crate) fn sums_per_sample(band_sums: &[[f64; 12]], height: usize) -> Vec<[f64; 12]> {
    band_sums.chunks(bands_per_sample(height)).map(|bands| std::array::from_fn(|k| bands.iter().map(|s| s[k]).sum())).collect()
}

fn forward<T: Scalar>(motions: &[Motion<T>], shape: Shape, depth: &[T], out: &mut [T]) {
    let (h, w) = (shape.h(), shape.w());
    par::for_each_item(bands::<T, 3>(out, h, w), |_, band| {
        let m = &motions[band.sample];
        let x = m.ray_columns(w);
        let depth = &depth[band.sample * h * w..][..h * w];
        let [u, v, z_s] = band.channels;
        let rows = u.chunks_exact_mut(w).zip(v.chunks_exact_mut(w)).zip(z_s.chunks_exact_mut(w));
        for (i, ((u, v), z_s)) in rows.enumerate() {
            let row = band.first_row + i;
            forward_row(m, m.ray_row(row), &x, &depth[row * w..][..w], u, v, z_s);
        }
    });
}

#[inline(always)]
fn forward_row<T: Scalar>(m: &Motion<T>, y: T, x: &[T], z: &[T], u: &mut [T], v: &mut [T], z_s: &mut [T]) {
    let w = x.len();
    let (z, u, v, z_s) = (&z[..w], &mut u[..w], &mut v[..w], &mut z_s[..w]);
    let c: [T; 3] = std::array::from_fn(|i| m.e[i][1] * y + m.e[i][2]);
    let min = T::from_f64(MIN_DEPTH);
    #[allow(clippy::needless_range_loop)] // one index over many rows
    for j in 0..w {
        let e: [T; 3] = std::array::from_fn(|i| m.e[i][0] * x[j] + c[i]);
        let depth = z[j] * (T::ONE + e[2]) + m.t[2];
        let inverse = if depth > min { T::ONE / depth } else { T::ZERO };
        z_s[j] = depth;
        u[j] = m.fu * (z[j] * (e[0] - x[j] * e[2]) + (m.t[0] - x[j] * m.t[2])) * inverse;
        v[j] = m.fv * (z[j] * (e[1] - y * e[2]) + (m.t[1] - y * m.t[2])) * inverse;
    }
}

/// Fills the gradient of the depth and returns the sums for rotation (9) and translation (3) of every sample.
fn backward<T: Scalar>(motions: &[Motion<T>], shape: Shape, depth: &[T], g: &[T], grad_depth: &mut [T]) -> Vec<[f64; 12]> {
    let (h, w) = (shape.h(), shape.w());
    let mut band_sums = vec![[0.0; 12]; shape.n() * bands_per_sample(h)];
    let items: Vec<_> = bands::<T, 1>(grad_depth, h, w).into_iter().zip(&mut band_sums).collect();
    par::for_each_item(items, |_, (band, sums)| {
        backward_band(&motions[band.sample], h, w, depth, g, band, sums);
    });
    sums_per_sample(&band_sums, h)
}

fn backward_band<T: Scalar>(m: &Motion<T>, h: usize, w: usize, depth: &[T], g: &[T], band: Band<'_, T, 1>, sums: &mut [f64; 12]) {
    let x = m.ray_columns(w);
    let plane = h * w;
    let depth = &depth[band.sample * plane..][..plane];
    let g = &g[band.sample * 3 * plane..][..3 * plane];
    let mut scratch = vec![T::ZERO; 6 * w];
    let [grad_depth] = band.channels;
    for (i, grad) in grad_depth.chunks_exact_mut(w).enumerate() {
        let row = band.first_row + i;
        let y = m.ray_row(row);
        let part = |k: usize| &g[k * plane + row * w..][..w];
        backward_row(m, y, &x, &depth[row * w..][..w], [part(0), part(1), part(2)], grad, &mut scratch);
        let y = y.to_f64();
        for k in 0..3 {
            let (to_e, to_t) = (&scratch[k * w..][..w], &scratch[(3 + k) * w..][..w]);
            let whole = sum(to_e);
            sums[3 * k] += dot(to_e, &x);
            sums[3 * k + 1] += whole * y;
            sums[3 * k + 2] += whole;
            sums[9 + k] += sum(to_t);
        }
    }
}

/// Writes the depth gradient of a row and, into `scratch`, the gradients of `e` (3 rows) and `t` (3 rows).
#[inline(always)]
fn backward_row<T: Scalar>(m: &Motion<T>, y: T, x: &[T], z: &[T], g: [&[T]; 3], grad: &mut [T], scratch: &mut [T]) {
    let w = x.len();
    let (z, grad) = (&z[..w], &mut grad[..w]);
    let [gu, gv, gz] = g.map(|g| &g[..w]);
    let (to_e, to_t) = scratch.split_at_mut(3 * w);
    let (ex, rest) = to_e.split_at_mut(w);
    let (ey, ez) = rest.split_at_mut(w);
    let (tx, rest) = to_t.split_at_mut(w);
    let (ty, tz) = rest.split_at_mut(w);
    let (ez, tz) = (&mut ez[..w], &mut tz[..w]);
    let c: [T; 3] = std::array::from_fn(|i| m.e[i][1] * y + m.e[i][2]);
    let min = T::from_f64(MIN_DEPTH);
    #[allow(clippy::needless_range_loop)] // one index over many rows
    for j in 0..w {
        let e: [T; 3] = std::array::from_fn(|i| m.e[i][0] * x[j] + c[i]);
        // What no gradient comes from may be anything, and 0 times anything may be NaN: sums over pixels must not see it.
        let used = (gu[j] != T::ZERO) | (gv[j] != T::ZERO) | (gz[j] != T::ZERO);
        let z = if used { z[j] } else { T::ONE };
        let depth = z * (T::ONE + e[2]) + m.t[2];
        let (inverse, gz) = if depth > min { (T::ONE / depth, gz[j]) } else { (T::ZERO, T::ZERO) };
        let (nx, ny) = (e[0] - x[j] * e[2], e[1] - y * e[2]);
        let a = gu[j] * m.fu * inverse;
        let b = gv[j] * m.fv * inverse;
        let c = gz - (a * (z * nx + (m.t[0] - x[j] * m.t[2])) + b * (z * ny + (m.t[1] - y * m.t[2]))) * inverse;
        let s = c - a * x[j] - b * y;
        grad[j] = a * nx + b * ny + c * (T::ONE + e[2]);
        tx[j] = a;
        ty[j] = b;
        tz[j] = s;
        ex[j] = a * z;
        ey[j] = b * z;
        ez[j] = s * z;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::taped::pose::pose_tensors;
    use crate::{Se3, flow::rigid, testing};
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};
    use nalgebra::{Vector2, Vector3};

    fn cameras() -> [Intrinsics; 2] {
        [Intrinsics::new(12.0, 13.0, 5.2, 9.1, 11, 19).unwrap(), Intrinsics::new(9.0, 8.0, 4.0, 8.0, 11, 19).unwrap()]
    }

    fn motions() -> [Se3; 2] {
        [
            Se3::from_rotation_vector(&Vector3::new(0.05, -0.08, 0.1), Vector3::new(0.2, -0.1, 0.4)),
            Se3::from_rotation_vector(&Vector3::new(-0.02, 0.03, 0.06), Vector3::new(0.0, 0.3, -0.5)),
        ]
    }

    const SHAPE: [usize; 4] = [2, 1, 19, 11];

    fn depth() -> Tensor<f64> {
        random(3, Shape(SHAPE), 2.0, 9.0)
    }

    #[test]
    fn equals_the_plain_projection() {
        let tape = Tape::new();
        let (r, t) = pose_tensors(&motions());
        let out = rigid_flow(tape.leaf(depth()), tape.leaf(r), tape.leaf(t), &cameras()).value();
        for n in 0..2 {
            for (v, u) in [(0, 0), (18, 10), (7, 3)] {
                let p = Vector2::new(u as f64, v as f64);
                let z = depth().at(n, 0, v, u);
                let (flow, z_s) = rigid::rigid_flow(&cameras()[n], &motions()[n], &p, z).unwrap();
                assert!((out.at(n, 0, v, u) - flow.x).abs() < 1e-12);
                assert!((out.at(n, 1, v, u) - flow.y).abs() < 1e-12);
                assert!((out.at(n, 2, v, u) - z_s).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn gradients_match_differences() {
        let (r, t) = pose_tensors(&motions());
        gradcheck(&[depth(), r, t], |_, v| weighted_sum(rigid_flow(v[0], v[1], v[2], &cameras()), 5), GradCheck::default())
            .assert_ok();
    }

    #[test]
    fn points_behind_the_source_get_no_flow_and_no_gradient() {
        let tape = Tape::new();
        let (r, t) = pose_tensors(&[Se3 { translation: Vector3::new(0.3, 0.1, -5.0), ..Se3::identity() }]);
        let camera = Intrinsics::new(3.0, 3.0, 1.0, 0.0, 3, 1).unwrap();
        let z = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 3), vec![4.0, 5.0, 8.0]));
        let (r, t) = (tape.leaf(r), tape.leaf(t));
        let out = rigid_flow(z, r, t, &[camera]);
        assert_eq!(out.value().to_vec()[..2], [0.0, 0.0]);
        assert_eq!(out.value().to_vec()[6..], [-1.0, 0.0, 3.0]);
        let grad = tape.backward(out.sum()).wrt(z).to_vec();
        assert!(grad[0] == 0.0 && grad[1] == 0.0 && grad[2] != 0.0, "{grad:?}");
    }

    #[test]
    fn no_motion_is_exactly_no_flow_and_single_precision_is_close() {
        let camera = testing::kitti640();
        let shape = Shape::new(1, 1, 192, 640);
        let z = random::<f64>(1, shape, 2.0, 80.0);
        let run32 = |m: Se3| {
            let tape = Tape::<f32>::new();
            let (r, t) = pose_tensors(&[m]);
            rigid_flow(tape.leaf(z.cast()), tape.leaf(r), tape.leaf(t), &[camera]).value()
        };
        assert!(run32(Se3::identity()).data()[..2 * shape.len()].iter().all(|&f| f == 0.0));
        let tape = Tape::<f64>::new();
        let (r, t) = pose_tensors(&[testing::drive_next()]);
        let exact = rigid_flow(tape.leaf(z.clone()), tape.leaf(r), tape.leaf(t), &[camera]).value();
        let single = run32(testing::drive_next());
        let worst =
            exact.data()[..2 * shape.len()].iter().zip(single.data()).map(|(a, &b)| (a - f64::from(b)).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-4, "{worst}");
    }

    #[test]
    fn same_bits_on_any_number_of_threads() {
        let run = || {
            let tape = Tape::<f32>::new();
            let (r, t) = pose_tensors::<f32>(&motions());
            let vars = [tape.leaf(depth().cast::<f32>()), tape.leaf(r), tape.leaf(t)];
            let loss = weighted_sum(rigid_flow(vars[0], vars[1], vars[2], &cameras()), 5);
            let grads = tape.backward(loss);
            vars.map(|v| grads.wrt(v).to_vec().iter().map(|x| x.to_bits()).collect::<Vec<_>>())
        };
        let one = par::with_threads(1, run);
        assert_eq!(one, par::with_threads(2, run));
        assert_eq!(one, par::with_threads(3, run));
    }

    #[test]
    #[should_panic(expected = "resize the intrinsics with the image")]
    fn a_camera_of_another_size_is_refused() {
        let tape = Tape::<f64>::new();
        let (r, t) = pose_tensors(&[Se3::identity()]);
        let z = tape.leaf(Tensor::full(Shape::new(1, 1, 4, 4), 1.0));
        rigid_flow(z, tape.leaf(r), tape.leaf(t), &[testing::kitti640()]);
    }
}
