//! Both alignments of a row, with the equations of [`align`](crate::taped::align), and which of its pixels can be used.
//!
//! With `n = (dx + e_x - x e_z, dy + e_y - y e_z, 1 + e_z)`: `z_pla = D n_z - a_z`, `f_pla,u = fu (D n_x + x a_z) / z_pla`,
//! `z_axi = D n_z`, `f_axi,u = fu (D n_x - a_x) / z_axi`, and the same for v.

use dimode_autodiff::Scalar;
use dimode_autodiff::simd::{Simd, Wide};

use super::rows::{Rows, Sample, add_sums, load2, read, splat};
use crate::taped::MIN_DEPTH;

/// The given maps on a segment of a row.
#[derive(Clone, Copy)]
pub(super) struct Given<'a, T> {
    /// Target depth.
    pub target_depth: &'a [T],
    /// Source depth where the flow ends.
    pub source_depth: &'a [T],
    /// Optical flow.
    pub flow: [&'a [T]; 2],
    /// Weights of the pixels.
    pub mask: &'a [T],
}

/// Constants of a row in registers.
struct Turn<S: Simd, T: Scalar> {
    e: [[Wide<S, T>; 3]; 3],
    inverse_focal: [Wide<S, T>; 2],
    y: Wide<S, T>,
}

/// Coordinates of a ray where the flow ends, and `n`.
type Ray<S, T> = ([Wide<S, T>; 2], [Wide<S, T>; 3]);

impl<S: Simd, T: Scalar> Turn<S, T> {
    #[inline(always)]
    fn new(simd: S, sample: &Sample<T>, rows: &Rows<'_, T>) -> Self {
        let zero = Wide::splat(simd, T::ZERO);
        let mut e = [[zero; 3]; 3];
        for (e, &entry) in e.iter_mut().flatten().zip(sample.motion.e.iter().flatten()) {
            *e = Wide::splat(simd, entry);
        }
        let [fu, fv] = sample.inverse_focal;
        let inverse_focal = [Wide::splat(simd, fu), Wide::splat(simd, fv)];
        Self { e, inverse_focal, y: Wide::splat(simd, rows.offset_v * fv) }
    }

    /// The ray where the flow ends, and `n`.
    #[inline(always)]
    fn of(&self, x: Wide<S, T>, dx: Wide<S, T>, dy: Wide<S, T>) -> Ray<S, T> {
        let (xs, ys) = (x + dx, self.y + dy);
        let [e0, e1, e2] = self.e;
        let ex = e0[0].mul_add(xs, e0[1].mul_add(ys, e0[2]));
        let ey = e1[0].mul_add(xs, e1[1].mul_add(ys, e1[2]));
        let ez = e2[0].mul_add(xs, e2[1].mul_add(ys, e2[2]));
        ([xs, ys], [dx + ex - x * ez, dy + ey - self.y * ez, x.like(T::ONE) + ez])
    }
}

/// Fills weights, depths, flows and noise of a segment.
#[inline(always)]
pub(super) fn forward<S: Simd, T: Scalar>(simd: S, sample: &Sample<T>, given: Given<'_, T>, rows: &mut Rows<'_, T>) {
    let m = &sample.motion;
    let turn = Turn::new(simd, sample, rows);
    let (fu, fv) = (Wide::splat(simd, m.fu), Wide::splat(simd, m.fv));
    let (ax, ay, az) = (Wide::splat(simd, m.t[0]), Wide::splat(simd, m.t[1]), Wide::splat(simd, m.t[2]));
    let (zero, one) = (splat(simd, 0.0), splat(simd, 1.0));
    let (min, z_min) = (splat(simd, MIN_DEPTH), Wide::splat(simd, sample.z_min));
    let infinity = Wide::splat(simd, -T::NEG_INFINITY);
    let noisy = sample.noise.is_some();
    let [noise_pixels, noise_share] = sample.noise.unwrap_or([T::ZERO; 2]);
    let (noise_pixels, noise_share) = (Wide::splat(simd, noise_pixels), Wide::splat(simd, noise_share));
    for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
        let (flow_u, flow_v) = (read(simd, given.flow[0], at), read(simd, given.flow[1], at));
        let d = read(simd, given.source_depth, at);
        let weight = read(simd, given.mask, at);
        let x = Wide::load(simd, &rows.offset[at..]) * turn.inverse_focal[0];
        let (dx, dy) = (flow_u * turn.inverse_focal[0], flow_v * turn.inverse_focal[1]);
        let (_, [nx, ny, nz]) = turn.of(x, dx, dy);
        let za = d * nz;
        let zp = za - az;
        let (ahead_p, ahead_a) = (min.less(zp), min.less(za));
        let (zp_or_one, za_or_one) = (ahead_p.choose(zp, one), ahead_a.choose(za, one));
        let inverse = one / (zp_or_one * za_or_one);
        let (ip, ia) = (ahead_p.choose(za_or_one * inverse, zero), ahead_a.choose(zp_or_one * inverse, zero));
        let planar = [fu * d.mul_add(nx, x * az) * ip, fv * d.mul_add(ny, turn.y * az) * ip];
        let axial = [fu * d.mul_add(nx, -ax) * ia, fv * d.mul_add(ny, -ay) * ia];
        let in_view = zero.at_most(Wide::load(simd, &rows.part[0][at..]));
        let finite = planar[0].abs().less(infinity)
            & planar[1].abs().less(infinity)
            & axial[0].abs().less(infinity)
            & axial[1].abs().less(infinity);
        let ahead = z_min.less(d) & z_min.less(zp) & z_min.less(za);
        let usable = zero.less(weight.abs()) & in_view & finite & ahead;
        let weight = usable.choose(weight, zero);
        weight.store(&mut rows.weight[at..]);
        usable.choose(d, one).store(&mut rows.source_depth[at..]);
        let z = read(simd, given.target_depth, at);
        z.store(&mut rows.target_depth[at..]);
        let front = usable & z_min.less(z) & z.less(infinity);
        front.choose(weight, zero).store(&mut rows.front_weight[at..]);
        front.choose(one / z, one).store(&mut rows.inverse_depth[at..]);
        usable.choose(ip, zero).store(&mut rows.inverse[0][at..]);
        usable.choose(ia, zero).store(&mut rows.inverse[1][at..]);
        usable.choose(planar[0], zero).store(&mut rows.planar[0][at..]);
        usable.choose(planar[1], zero).store(&mut rows.planar[1][at..]);
        usable.choose(axial[0], zero).store(&mut rows.axial[0][at..]);
        usable.choose(axial[1], zero).store(&mut rows.axial[1][at..]);
        if noisy {
            let size = flow_u.mul_add(flow_u, flow_v * flow_v).sqrt();
            usable.choose(noise_share.mul_add(size, noise_pixels), zero).store(&mut rows.noise[at..]);
        }
    }
}

/// Turns gradients of the flows into those of the source depth and, if `to_flow`, of the optical flow; adds to the sums of
/// `R^T - I` (9) and `a` (3).
///
/// With `P = g_pla f / z_pla`, `A = g_axi f / z_axi`, `C_pla = -(g_pla . f_pla) / z_pla`, `C_axi` likewise and
/// `S = (P + A, C_pla + C_axi)`: to `D` `n . S`; to `a` `(-A, x P_x + y P_y - C_pla)`; to `e` `D (S_x, S_y, S_z - x S_x - y S_y)`.
#[inline(always)]
pub(super) fn backward<S: Simd, T: Scalar>(
    simd: S,
    sample: &Sample<T>,
    given: Given<'_, T>,
    rows: &mut Rows<'_, T>,
    to_flow: bool,
    sums: &mut [f64; 12],
) {
    let m = &sample.motion;
    let turn = Turn::new(simd, sample, rows);
    let (fu, fv) = (Wide::splat(simd, m.fu), Wide::splat(simd, m.fv));
    let zero = splat(simd, 0.0);
    let noise_share = Wide::splat(simd, sample.noise.map_or(T::ZERO, |noise| noise[1]));
    let mut totals = [zero; 12];
    for at in (0..rows.padded()).step_by(Wide::<S, T>::lanes()) {
        let used = zero.less(Wide::load(simd, &rows.weight[at..]).abs());
        let flow_u = used.choose(read(simd, given.flow[0], at), zero);
        let flow_v = used.choose(read(simd, given.flow[1], at), zero);
        let x = Wide::load(simd, &rows.offset[at..]) * turn.inverse_focal[0];
        let (dx, dy) = (flow_u * turn.inverse_focal[0], flow_v * turn.inverse_focal[1]);
        let ([xs, ys], [nx, ny, nz]) = turn.of(x, dx, dy);
        let d = Wide::load(simd, &rows.source_depth[at..]);
        let [ip, ia] = load2(simd, &rows.inverse, at);
        let ([gpu, gpv], [gau, gav]) = (load2(simd, &rows.to_planar, at), load2(simd, &rows.to_axial, at));
        let ([pla_u, pla_v], [axi_u, axi_v]) = (load2(simd, &rows.planar, at), load2(simd, &rows.axial, at));
        let (px, py) = (gpu * fu * ip, gpv * fv * ip);
        let (ax, ay) = (gau * fu * ia, gav * fv * ia);
        let cp = -(gpu.mul_add(pla_u, gpv * pla_v) * ip);
        let ca = -(gau.mul_add(axi_u, gav * axi_v) * ia);
        let (sx, sy, sz) = (px + ax, py + ay, cp + ca);
        nx.mul_add(sx, ny.mul_add(sy, nz * sz)).store(&mut rows.to_source_depth[at..]);
        let (ex, ey) = (d * sx, d * sy);
        let ez = d * (sz - x * sx - turn.y * sy);
        for (k, to_e) in [ex, ey, ez].into_iter().enumerate() {
            totals[3 * k] = to_e.mul_add(xs, totals[3 * k]);
            totals[3 * k + 1] = to_e.mul_add(ys, totals[3 * k + 1]);
            totals[3 * k + 2] = totals[3 * k + 2] + to_e;
        }
        totals[9] = totals[9] - ax;
        totals[10] = totals[10] - ay;
        totals[11] = totals[11] + (x * px + turn.y * py - cp);
        if to_flow {
            let [e0, e1, e2] = turn.e;
            let to_x = ex + e0[0].mul_add(ex, e1[0].mul_add(ey, e2[0] * ez));
            let to_y = ey + e0[1].mul_add(ex, e1[1].mul_add(ey, e2[1] * ez));
            // The noise is a share of the flow's length, whose slope at no flow counts as 0.
            let size = flow_u.mul_add(flow_u, flow_v * flow_v).sqrt();
            let moves = zero.less(size);
            let g = Wide::load(simd, &rows.to_noise[at..]) * noise_share;
            let g = moves.choose(g / moves.choose(size, zero.like(T::ONE)), zero);
            g.mul_add(flow_u, to_x * turn.inverse_focal[0]).store(&mut rows.to_flow[0][at..]);
            g.mul_add(flow_v, to_y * turn.inverse_focal[1]).store(&mut rows.to_flow[1][at..]);
        }
    }
    // e_k = sum_j E_kj b_j with E = R^T - I: the gradient of E_kj belongs to R_jk.
    let [a, b, c, d, e, f, g, h, i, x, y, z] = totals;
    add_sums(sums, [a, d, g, b, e, h, c, f, i, x, y, z]);
}
