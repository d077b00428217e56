//! `l_loc`: the local structure of the predicted depth must match that of a pseudo-depth (paper: the refinement of SC-DepthV3).
//!
//! Normal matching: `mean |n(D) - n(D*)|` over pixels and components, with surface normals of the back-projected depth maps. The
//! scale of `D*` does not matter. Which pseudo-depth is used is a setting; `self-guided` needs no teacher.

use dimode_autodiff::{Conv2d, PadMode, Scalar, Shape, Tensor, Var};
use dimode_geometry::Intrinsics;

/// Guard of the normalisation, squared.
const TINY: f64 = 1e-24;

/// Mean absolute difference of the normals of `depth` and `pseudo`, both `[n, 1, h, w]`.
pub fn normal_matching<'t, T: Scalar>(depth: Var<'t, T>, pseudo: &Tensor<T>, cameras: &[Intrinsics]) -> Var<'t, T> {
    let wanted = normals(depth.tape().constant(pseudo.clone()), cameras);
    normals(depth, cameras).sub(wanted).abs().mean()
}

/// Unit normals `[n, 3, h, w]` of back-projected depth maps: `dP/du x dP/dv` by Sobel differences with repeated borders.
///
/// A plane that faces the camera has normal (0, 0, 1). Where the surface degenerates to a point the normal is 0.
///
/// # Panics
/// When there is not one camera for each map.
#[track_caller]
pub fn normals<'t, T: Scalar>(depth: Var<'t, T>, cameras: &[Intrinsics]) -> Var<'t, T> {
    let shape = depth.shape();
    assert!(cameras.len() == shape.n(), "normals: {} cameras for depth {shape}", cameras.len());
    let tape = depth.tape();
    let rays = Tensor::from_fn(shape.with_c(3), |n, c, h, w| {
        let ray = cameras[n].ray(w as f64, h as f64);
        T::from_f64(ray[c])
    });
    let points = depth.broadcast_to(shape.with_c(3)).mul(tape.constant(rays));
    let sobel = |along_rows: bool| {
        let weights = Tensor::from_fn(Shape::new(3, 1, 3, 3), |_, _, h, w| {
            let (step, smooth) = if along_rows { (w, h) } else { (h, w) };
            T::from_f64((step as f64 - 1.0) * [1.0, 2.0, 1.0][smooth] / 8.0)
        });
        let conv = Conv2d { groups: 3, pad_mode: PadMode::Replicate, ..Conv2d::new(1, 1) };
        points.conv2d(tape.constant(weights), None, conv)
    };
    let (du, dv) = (sobel(true), sobel(false));
    let part = |x: Var<'t, T>, c: usize| x.slice(1, c % 3, 1);
    let cross: Vec<_> = (0..3).map(|c| part(du, c + 1).mul(part(dv, c + 2)).sub(part(du, c + 2).mul(part(dv, c + 1)))).collect();
    let length = cross.iter().map(|x| x.square()).reduce(|a, b| a.add(b)).expect("three components");
    let scale = length.add_scalar(TINY).sqrt().recip();
    Var::concat(&[cross[0].mul(scale), cross[1].mul(scale), cross[2].mul(scale)], 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};

    fn camera(width: usize, height: usize) -> Intrinsics {
        Intrinsics::new(10.0, 11.0, 2.4, 1.7, width, height).expect("a sane camera")
    }

    #[test]
    fn a_plane_has_its_normal_everywhere() {
        // 1 / z is affine in (u, v) on a plane; n . P = d with n = (0.2, -0.3, 1) / |.|.
        let (w, h) = (7, 6);
        let cam = camera(w, h);
        let n = nalgebra::Vector3::new(0.2, -0.3, 1.0).normalize();
        let depth = Tensor::from_fn(Shape::new(1, 1, h, w), |_, _, v, u| 2.0 / n.dot(&cam.ray(u as f64, v as f64)));
        let tape = Tape::<f64>::new();
        let got = normals(tape.constant(depth), &[cam]).value();
        for c in 0..3 {
            for &x in got.plane(0, c) {
                assert!((x - n[c]).abs() < 1e-9, "component {c}: {x} against {}", n[c]);
            }
        }
    }

    #[test]
    fn the_scale_of_the_pseudo_depth_does_not_matter() {
        let depth = random::<f64>(1, Shape::new(1, 1, 5, 6), 2.0, 3.0);
        let twice = Tensor::from_vec(depth.shape(), depth.data().iter().map(|d| 2.0 * d).collect());
        let tape = Tape::new();
        let loss = normal_matching(tape.constant(depth), &twice, &[camera(6, 5)]).value().item();
        assert!(loss < 1e-12, "{loss}");
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let depth = random::<f64>(2, Shape::new(2, 1, 4, 5), 2.0, 3.0);
        let cams = [camera(5, 4), camera(5, 4)];
        let check = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
        gradcheck(&[depth], |_, v| weighted_sum(normals(v[0], &cams), 3), check).assert_ok();
    }

    #[test]
    fn gradient_of_the_matching_matches_finite_differences() {
        let depth = random::<f64>(2, Shape::new(2, 1, 4, 5), 2.0, 3.0);
        let pseudo = random::<f64>(3, Shape::new(2, 1, 4, 5), 1.0, 2.0);
        let cams = [camera(5, 4), camera(5, 4)];
        let check = GradCheck { step: 1e-6, rtol: 1e-6, atol: 1e-8, ..GradCheck::default() };
        gradcheck(&[depth], |_, v| normal_matching(v[0], &pseudo, &cams), check).assert_ok();
    }
}
