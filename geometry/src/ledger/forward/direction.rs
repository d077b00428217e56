//! The direction losses once more: `L_pla` and `L_axi` of lists of flows, written from their definitions.

use dimode_autodiff::proof::{Number, total};

use super::V2;

fn length<N: Number>(f: V2<N>) -> N {
    (f[0] * f[0] + f[1] * f[1]).sqrt()
}

fn cross<N: Number>(a: V2<N>, b: V2<N>) -> N {
    a[0] * b[1] - a[1] * b[0]
}

fn dot<N: Number>(a: V2<N>, b: V2<N>) -> N {
    a[0] * b[0] + a[1] * b[1]
}

fn mean<N: Number>(x: &[N]) -> N {
    total(x.iter().copied()) * N::constant(1.0 / x.len() as f64)
}

fn variance<N: Number>(x: &[N]) -> N {
    let centre = mean(x);
    let squares: Vec<N> = x.iter().map(|&x| (x - centre) * (x - centre)).collect();
    mean(&squares)
}

fn each<N: Number>(flows: &[V2<N>], of: impl Fn(V2<N>) -> N) -> Vec<N> {
    flows.iter().map(|&f| of(f)).collect()
}

/// The printed angle `arccos(f_u / |f|)`.
#[must_use]
pub fn angle_by_arccos<N: Number>(f: V2<N>) -> N {
    (f[0] / length(f)).acos()
}

/// Eq. `lp` letter by letter: variance of `arccos(f_u / |f|)`.
#[must_use]
pub fn planar_printed<N: Number>(flows: &[V2<N>]) -> N {
    variance(&each(flows, angle_by_arccos))
}

/// Variance of `atan2(f_v, f_u)`.
#[must_use]
pub fn planar_unfolded<N: Number>(flows: &[V2<N>]) -> N {
    variance(&each(flows, |f| f[1].atan2(f[0])))
}

/// `2 (1 - |E[f / |f|]|)`.
#[must_use]
pub fn planar_circular<N: Number>(flows: &[V2<N>]) -> N {
    let centre = [0, 1].map(|k| mean(&each(flows, |f| f[k] / length(f))));
    N::constant(2.0) * (N::one() - length(centre))
}

/// `2 (1 - |sum f| / sum |f|)`.
#[must_use]
pub fn planar_weighted<N: Number>(flows: &[V2<N>]) -> N {
    let sum = [0, 1].map(|k| total(flows.iter().map(|f| f[k])));
    N::constant(2.0) * (N::one() - length(sum) / total(each(flows, length)))
}

/// `E[|f x n|]` with the unit vector `n` along `direction`.
#[must_use]
pub fn planar_perpendicular<N: Number>(flows: &[V2<N>], direction: V2<N>) -> N {
    mean(&each(flows, |f| cross(f, direction).abs() / length(direction)))
}

fn along<N: Number>(flows: &[V2<N>], d: &[V2<f64>], of: impl Fn(V2<N>, V2<N>) -> N) -> N {
    let terms: Vec<N> = flows.iter().zip(d).map(|(&f, d)| of(f, d.map(N::constant))).collect();
    mean(&terms)
}

/// Eq. `la` letter by letter: mean of `arccos(f . d / (|f| |d|))`.
#[must_use]
pub fn axial_printed<N: Number>(flows: &[V2<N>], d: &[V2<f64>]) -> N {
    along(flows, d, |f, d| (dot(f, d) / (length(f) * length(d))).acos())
}

/// Mean of `atan2(|f x d|, s f . d)` for a sign `s`.
#[must_use]
pub fn axial_signed<N: Number>(flows: &[V2<N>], d: &[V2<f64>], s: f64) -> N {
    along(flows, d, |f, d| cross(f, d).abs().atan2(N::constant(s) * dot(f, d)))
}

/// Mean of `atan2(|f x d|, |f . d|)`.
#[must_use]
pub fn axial_folded<N: Number>(flows: &[V2<N>], d: &[V2<f64>]) -> N {
    along(flows, d, |f, d| cross(f, d).abs().atan2(dot(f, d).abs()))
}

/// `E[(f x d)^2 / (f.f d.d)]`.
#[must_use]
pub fn axial_smooth<N: Number>(flows: &[V2<N>], d: &[V2<f64>]) -> N {
    along(flows, d, |f, d| cross(f, d) * cross(f, d) / (dot(f, f) * dot(d, d)))
}

/// `E[|f x d| / |d|]`.
#[must_use]
pub fn axial_perpendicular<N: Number>(flows: &[V2<N>], d: &[V2<f64>]) -> N {
    along(flows, d, |f, d| cross(f, d).abs() / length(d))
}
