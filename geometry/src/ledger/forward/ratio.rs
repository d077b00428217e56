//! The ratio losses (eqs. `lt`, `lr`) and what flows and depths recover, over any [`Number`].

use dimode_autodiff::proof::Number;

use super::{V2, V3};
use crate::camera::Intrinsics;

/// Mean of a list that is not empty.
pub(super) fn mean<N: Number>(values: impl ExactSizeIterator<Item = N>) -> N {
    let count = N::constant(values.len() as f64);
    values.fold(N::zero(), |sum, x| sum + x) / count
}

/// `E[|rho a - z| / z] + |(E[z / rho] - a) / a|` from the ratios of all pixels.
fn ratio_loss<N: Number>(ratios: &[N], depths: &[N], a: N) -> N {
    let pixels = mean(ratios.iter().zip(depths).map(|(&rho, &z)| (rho * a - z).abs() / z));
    let recovered = mean(ratios.iter().zip(depths).map(|(&rho, &z)| z / rho));
    pixels + ((recovered - a) / a).abs()
}

/// `L_tan` as printed, of planar flows, target depths and a translation.
#[must_use]
pub fn tangential_loss<N: Number>(camera: &Intrinsics, flows: &[V2<N>], depths: &[N], a: V3<N>) -> N {
    let axis = |k: usize, focal: f64| {
        let ratios: Vec<N> = flows.iter().map(|f| N::constant(focal) / f[k]).collect();
        ratio_loss(&ratios, depths, a[k])
    };
    axis(0, camera.fu) + axis(1, camera.fv)
}

/// `L_rad` as printed, of axial flows, offsets `p - p0`, target depths and a radial translation.
#[must_use]
pub fn radial_loss<N: Number>(flows: &[V2<N>], offsets: &[V2<f64>], depths: &[N], a_z: N) -> N {
    let ratios: Vec<N> = flows.iter().zip(offsets).map(|(&f, &d)| radial_ratio(f, d)).collect();
    ratio_loss(&ratios, depths, a_z)
}

/// `rho_z = -(d.(f + d)) / (d.f)`.
#[must_use]
pub fn radial_ratio<N: Number>(f: V2<N>, d: V2<f64>) -> N {
    let along = f[0] * N::constant(d[0]) + f[1] * N::constant(d[1]);
    -(along + N::constant(d[0] * d[0] + d[1] * d[1])) / along
}

/// Mean over the pixels of `(z / rho_x, z / rho_y, z / rho_z)`.
#[must_use]
pub fn recovered<N: Number>(camera: &Intrinsics, [planar, axial]: [&[V2<N>]; 2], offsets: &[V2<f64>], depths: &[N]) -> V3<N> {
    let tangential = |k: usize, focal: f64| mean(planar.iter().zip(depths).map(|(f, &z)| z * f[k] / N::constant(focal)));
    let radial = mean((0..depths.len()).map(|i| {
        let ([f_u, f_v], [d_u, d_v]) = (axial[i], offsets[i].map(N::constant));
        let along = f_u * d_u + f_v * d_v;
        -depths[i] * along / (along + d_u * d_u + d_v * d_v)
    }));
    [tangential(0, camera.fu), tangential(1, camera.fv), radial]
}
