//! Two views of one scene with their depth maps, and one of them as the other sees it: what both SC-Depth pair terms begin with.

use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::{Scalar, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::{Divisor, Pose, Projection, SampleGrid, back_project, project};

/// Mean and deviation by which the SC-Depth programs normalise colours in [0, 1], for their networks and in their losses.
pub const COLOURS: [f64; 2] = [0.45, 0.225];

/// An image and its depth map.
#[derive(Clone, Copy, Debug)]
pub struct View<'t, T: Scalar> {
    /// Colours `[n, c, h, w]`.
    pub image: Var<'t, T>,
    /// Depth `[n, 1, h, w]`, positive.
    pub depth: Var<'t, T>,
}

/// A target, a reference and the motion between them.
#[derive(Clone, Copy, Debug)]
pub struct ViewPair<'a, 't, T: Scalar> {
    /// The view that is explained.
    pub target: View<'t, T>,
    /// The view that explains it.
    pub reference: View<'t, T>,
    /// `reference_from_target`.
    pub motion: Pose<'t, T>,
    /// One camera a sample, of both views.
    pub intrinsics: &'a [Intrinsics],
}

/// The reference as read from the target's pixels.
#[derive(Clone, Copy, Debug)]
pub struct Warped<'t, T: Scalar> {
    /// Colours of the reference, 0 outside, `[n, c, h, w]`.
    pub image: Var<'t, T>,
    /// Depth map of the reference, 0 outside, `[n, 1, h, w]`.
    pub depth: Var<'t, T>,
}

impl<'t, T: Scalar> ViewPair<'_, 't, T> {
    /// The pair with its roles exchanged; `motion` is `target_from_reference`, which these programs predict apart.
    #[must_use]
    pub fn exchanged(self, motion: Pose<'t, T>) -> Self {
        ViewPair { target: self.reference, reference: self.target, motion, ..self }
    }

    /// Where the target's points appear in the reference.
    #[track_caller]
    pub fn projection(&self, divisor: Divisor) -> Projection<'t, T> {
        let points = back_project(self.target.depth, self.intrinsics);
        project(points, self.motion.rotation, self.motion.translation, self.intrinsics, divisor)
    }

    /// The reference read at `pixels`, bilinear, 0 outside.
    #[track_caller]
    pub fn read(&self, pixels: Var<'t, T>, grid: SampleGrid) -> Warped<'t, T> {
        let s = self.reference.depth.shape();
        let at = grid.coordinates(pixels, s.h(), s.w());
        let [image, depth] =
            [self.reference.image, self.reference.depth].map(|map| map.bilinear_sample(at, SamplePadding::Zeros));
        Warped { image, depth }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{Shape, Tape, Tensor};
    use dimode_geometry::taped::RotationForm;
    use dimode_geometry::taped::so3_exp::rotation_matrix;

    pub const H: usize = 8;
    pub const W: usize = 9;

    pub fn cameras(n: usize) -> Vec<Intrinsics> {
        vec![Intrinsics::new(9.0, 8.0, 3.9, 3.6, W, H).unwrap(); n]
    }

    /// Target image and depth, reference image and depth, Euler angles and translation of a random scene.
    pub fn scene(n: usize) -> Vec<Tensor<f64>> {
        let map = |seed, c, lo, hi| random(seed, Shape::new(n, c, H, W), lo, hi);
        let vector = |seed, size: f64| random(seed, Shape::new(n, 3, 1, 1), -size, size);
        vec![
            map(1, 3, -1.0, 1.0),
            map(2, 1, 2.0, 5.0),
            map(3, 3, -1.0, 1.0),
            map(4, 1, 2.0, 5.0),
            vector(5, 0.05),
            vector(6, 0.3),
        ]
    }

    /// The pair of the variables of [`scene`].
    pub fn pair<'a, 't>(v: &[Var<'t, f64>], cameras: &'a [Intrinsics]) -> ViewPair<'a, 't, f64> {
        ViewPair {
            target: View { image: v[0], depth: v[1] },
            reference: View { image: v[2], depth: v[3] },
            motion: Pose { rotation: rotation_matrix(v[4], RotationForm::Euler), translation: v[5] },
            intrinsics: cameras,
        }
    }

    /// Variables of [`scene`] on a tape.
    pub fn leaves(tape: &Tape<f64>, scene: Vec<Tensor<f64>>) -> Vec<Var<'_, f64>> {
        scene.into_iter().map(|x| tape.leaf(x)).collect()
    }

    #[test]
    fn a_still_camera_reads_the_reference_itself() {
        let tape = Tape::new();
        let mut scene = scene(1);
        scene[4] = Tensor::zeros(Shape::new(1, 3, 1, 1));
        scene[5] = Tensor::zeros(Shape::new(1, 3, 1, 1));
        let v = leaves(&tape, scene);
        let cameras = cameras(1);
        let pair = pair(&v, &cameras);
        let seen = pair.projection(Divisor::AtLeast);
        let read = pair.read(seen.pixels, SampleGrid::Pixels);
        let inner = |x: Var<'_, f64>| x.slice(2, 1, H - 2).slice(3, 1, W - 2).value().to_vec();
        for (a, b) in inner(read.depth).into_iter().zip(inner(v[3])) {
            assert!((a - b).abs() < 1e-12);
        }
        assert_eq!(seen.depth.value().data(), v[1].value().data());
    }
}
