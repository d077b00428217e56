//! The geometry once more, over any [`Number`]: with `f64` a second value, with [`Dual`] derivatives in forward mode.
//!
//! Written from the equations alone, without nalgebra, homographies or the tape, so that a mistake in the closed forms or in a
//! backward rule finds no accomplice here.

pub mod direction;
pub mod pipeline;
pub mod ratio;

use dimode_autodiff::proof::{Dual, Number};

use crate::camera::Intrinsics;

/// A vector of three numbers.
pub type V3<N> = [N; 3];

/// A pixel or a flow.
pub type V2<N> = [N; 2];

/// Numbers that do not move.
#[must_use]
pub fn fixed<N: Number, const K: usize>(x: [f64; K]) -> [N; K] {
    x.map(N::constant)
}

/// `a + b`.
#[must_use]
pub fn sum<N: Number>(a: V3<N>, b: V3<N>) -> V3<N> {
    std::array::from_fn(|i| a[i] + b[i])
}

/// `a - b`.
#[must_use]
pub fn difference<N: Number>(a: V3<N>, b: V3<N>) -> V3<N> {
    std::array::from_fn(|i| a[i] - b[i])
}

/// `s a`.
#[must_use]
pub fn scaled<N: Number>(a: V3<N>, s: N) -> V3<N> {
    a.map(|x| x * s)
}

/// `a x b`.
#[must_use]
pub fn cross<N: Number>(a: V3<N>, b: V3<N>) -> V3<N> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `exp([w]_x) x`: `x` turned by `|w|` radians about `w`, by the power series (angles up to about 1 rad).
#[must_use]
pub fn rotated<N: Number>(w: V3<N>, x: V3<N>) -> V3<N> {
    let mut term = x;
    let mut out = x;
    for k in 1..22 {
        term = scaled(cross(w, term), N::constant(1.0 / f64::from(k)));
        out = sum(out, term);
    }
    out
}

/// `exp([w]_x)^T x`.
#[must_use]
pub fn rotated_back<N: Number>(w: V3<N>, x: V3<N>) -> V3<N> {
    rotated(w.map(|c| -c), x)
}

/// Viewing ray of a pixel, third component 1.
#[must_use]
pub fn ray<N: Number>(camera: &Intrinsics, p: V2<N>) -> V3<N> {
    let offset = |p: N, centre: f64, focal: f64| (p - N::constant(centre)) / N::constant(focal);
    [offset(p[0], camera.u0, camera.fu), offset(p[1], camera.v0, camera.fv), N::one()]
}

/// Pixel of a point.
#[must_use]
pub fn projected<N: Number>(camera: &Intrinsics, x: V3<N>) -> V2<N> {
    let pixel = |x: N, z: N, centre: f64, focal: f64| N::constant(focal) * x / z + N::constant(centre);
    [pixel(x[0], x[2], camera.u0, camera.fu), pixel(x[1], x[2], camera.v0, camera.fv)]
}

/// Flow of eq. `p_s` and the source depth, for a rotation vector `w`, a translation `t` in the source frame, a pixel and its
/// depth.
#[must_use]
pub fn rigid_flow<N: Number>(camera: &Intrinsics, w: V3<N>, t: V3<N>, p: V2<N>, z: N) -> (V2<N>, N) {
    let point = sum(rotated(w, scaled(ray(camera, p), z)), t);
    let pixel = projected(camera, point);
    ([pixel[0] - p[0], pixel[1] - p[1]], point[2])
}

/// Flow and depth of eq. `pplanar` after `eps` was added to a rotation: `R = exp([w]) exp([eps])`, point
/// `R^T z_s K^-1 p_s - removed`.
#[must_use]
pub fn aligned<N: Number>(
    camera: &Intrinsics,
    [w, eps]: [V3<N>; 2],
    removed: V3<N>,
    [target, source]: [V2<N>; 2],
    source_depth: N,
) -> (V2<N>, N) {
    let turned = rotated_back(eps, rotated_back(w, scaled(ray(camera, source), source_depth)));
    let point = difference(turned, removed);
    let pixel = projected(camera, point);
    ([pixel[0] - target[0], pixel[1] - target[1]], point[2])
}

/// Derivatives by forward mode, row by row: entry `O * row + column` is the derivative of output `row` along input `column`.
#[must_use]
pub fn jacobian<const I: usize, const O: usize>(x: [f64; I], f: impl Fn([Dual; I]) -> [Dual; O]) -> Vec<f64> {
    let along = |column: usize| {
        f(std::array::from_fn(|i| Dual { value: x[i], slope: if i == column { 1.0 } else { 0.0 } })).map(|y| y.slope)
    };
    let columns: Vec<[f64; O]> = (0..I).map(along).collect();
    (0..O).flat_map(|row| columns.iter().map(move |column| column[row])).collect()
}

/// Derivatives by central differences with one step an input, in the order of [`jacobian`].
#[must_use]
pub fn central<const I: usize, const O: usize>(x: [f64; I], steps: [f64; I], f: impl Fn([f64; I]) -> [f64; O]) -> Vec<f64> {
    let along = |column: usize| -> [f64; O] {
        let moved = |sign: f64| {
            let mut x = x;
            x[column] += sign * steps[column];
            (f(x), x[column])
        };
        let ((above, hi), (below, lo)) = (moved(1.0), moved(-1.0));
        std::array::from_fn(|row| (above[row] - below[row]) / (hi - lo))
    };
    let columns: Vec<[f64; O]> = (0..I).map(along).collect();
    (0..O).flat_map(|row| columns.iter().map(move |column| column[row])).collect()
}

/// As [`central`], from the steps `h` and `2 h` extrapolated to none: what is left over falls with `h^4` instead of `h^2`, which
/// admits steps large enough for rounding not to show.
#[must_use]
pub fn central_extrapolated<const I: usize, const O: usize>(
    x: [f64; I],
    steps: [f64; I],
    f: impl Fn([f64; I]) -> [f64; O],
) -> Vec<f64> {
    let (near, far) = (central(x, steps, &f), central(x, steps.map(|h| 2.0 * h), &f));
    near.into_iter().zip(far).map(|(near, far)| near + (near - far) / 3.0).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;

    use super::*;
    use crate::ledger::testing;
    use crate::so3;

    #[test]
    fn differences_and_forward_mode_agree_on_a_worked_function() {
        let exact = [12.0, 4.0, 1.0, -0.25];
        let f = |[x, y]: [Dual; 2]| [x * x * y, x / y];
        let forward = jacobian([2.0, 3.0], |[x, y]| f([x, y - Dual::constant(0.0)]));
        assert_eq!(forward, [12.0, 4.0, 1.0 / 3.0, -2.0 / 9.0]);
        let central = central([2.0, 3.0], [1e-6; 2], |[x, y]| [x * x * y, x / y]);
        assert!(forward.iter().zip(&central).all(|(a, b)| (a - b).abs() < 1e-8));
        assert!(exact[0] == forward[0] && exact[1] == forward[1]);
    }

    #[test]
    fn extrapolated_differences_leave_the_fourth_power_of_the_step() {
        let error = |h: f64| (central_extrapolated([1.0], [h], |[x]: [f64; 1]| [x.exp()])[0] - 1f64.exp()).abs();
        let (coarse, fine) = (error(0.1), error(0.05));
        assert!((coarse / fine - 16.0).abs() < 0.5, "{coarse} {fine}");
        assert!(error(1e-3) < 1e-12);
    }

    proptest! {
        #[test]
        fn the_series_turns_as_the_exponential_does(w in prop::array::uniform3(-0.6f64..0.6), x in prop::array::uniform3(-5.0f64..5.0)) {
            let expected = so3::exp(&Vector3::from(w)) * Vector3::from(x);
            prop_assert!((Vector3::from(rotated(w, x)) - expected).norm() < 1e-14 * 10.0);
            prop_assert!((Vector3::from(rotated_back(w, rotated(w, x))) - Vector3::from(x)).norm() < 1e-13);
        }

        #[test]
        fn both_implementations_of_the_rigid_flow_agree(case in testing::case()) {
            let w = so3::log(&case.motion.rotation);
            let (flow, z) = rigid_flow::<f64>(&case.camera, w.into(), case.motion.translation.into(), case.pixel.into(), case.depth);
            let (expected, depth) = crate::flow::rigid::rigid_flow(&case.camera, &case.motion, &case.pixel, case.depth).unwrap();
            prop_assert!((nalgebra::Vector2::from(flow) - expected).norm() < 1e-9);
            prop_assert!((z - depth).abs() < 1e-12 * case.depth);
        }
    }
}
