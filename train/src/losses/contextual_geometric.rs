//! Contextual-geometric depth consistency of DCPI-Depth: the depth that flow and motion imply must be the predicted one.
//!
//! **Formula** [mengtanZ/DCPI-Depth, `trainer.py`]. With the flow without its rotational part `f_tr = f_opt - sg(f_rot)`,
//! `q = p - p_0` and `X_s = R X_t + t`:
//!
//! - [`radial_depth`] ("v2", the default there): `D_geo = -t_z (q.q + q.f_tr) / (q.f_tr + 1e-5)`;
//! - [`triangulated_depth`] ("v1"): `D_geo = ((t_x + t_y) - t_z s) / ((r_3.b) s - (r_1 + r_2).b + 1e-5)` with the target ray `b`, the
//!   rows `r_i` of `R`, and `s = x_s + y_s` of the source ray `(x_s, y_s, 1)`;
//! - the error of either is `e = |D_geo - D| / (D + 1e-5)`, the loss the mean over the pixels of the batch with `e < 2`.
//!
//! DCPI-Depth adds [`PART_WEIGHT`] times [`rigid_agreement`](super::rigid_agreement) and
//! [`contextual_divergence`](super::contextual_divergence) and weighs the sum by [`WEIGHT`]. All are for the next frame and the finest
//! scale.
//!
//! **Gradient**: what is marked `sg` has none, and neither has the choice of pixels. Pixels that do not count have exactly zero
//! gradient, also where an error is infinite; without any, a loss is 0 (the public code gives NaN).
//!
//! **Reading**: the public code has three slips, which [`ContextualForm`] and [`TriangulatedForm`] keep for comparison only.

use dimode_autodiff::{Scalar, Shape, Tensor, Var};
use dimode_geometry::Intrinsics;

use super::gated::{GUARD, Gated, below};
use super::masked::batch_mean;

/// Relative errors of depths from here on do not count.
pub const DEPTH_GATE: f64 = 2.0;
/// Weight of the whole in DCPI-Depth, from its second epoch on.
pub const WEIGHT: f64 = 0.01;
/// Weight of `L_dpc` and of `L_rig` inside the whole.
pub const PART_WEIGHT: f64 = 0.2;

/// Which `q` and which rotational flow [`radial_depth`] takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ContextualForm {
    /// `q` from the principal point.
    #[default]
    Corrected,
    /// `q` from the middle of the image, wherever the principal point is. For comparison only.
    ImageCentre,
    /// As the public code: the middle of the image, and the end of the rotational flow multiplied by `W / (W - 1)` and
    /// `H / (H - 1)`, up to a pixel too far. For comparison only.
    AsCoded,
}

/// Which way the rotation acts in [`triangulated_depth`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TriangulatedForm {
    /// From target to source.
    #[default]
    Corrected,
    /// As the public code: the inverse motion with another sign, so that the rotation acts the wrong way. For comparison only.
    AsCoded,
}

/// What the losses compare. Maps are `[n, c, h, w]` in pixels and units of depth.
#[derive(Clone, Copy, Debug)]
pub struct ContextualInputs<'a, 't, T: Scalar> {
    /// Optical flow from target to source, two channels.
    pub flow: Var<'t, T>,
    /// Predicted target depth.
    pub depth: Var<'t, T>,
    /// Rotation of `source_from_target`, `[n, 1, 3, 3]`.
    pub rotation: Var<'t, T>,
    /// Translation of `source_from_target`, `[n, 3, 1, 1]`.
    pub translation: Var<'t, T>,
    /// Flow of the rotation alone, two channels.
    pub rotational: &'a Tensor<T>,
    /// Camera of every sample, at the size of the maps.
    pub intrinsics: &'a [Intrinsics],
}

impl<'t, T: Scalar> ContextualInputs<'_, 't, T> {
    pub(super) fn shape(&self) -> Shape {
        self.depth.shape()
    }

    pub(super) fn constant(&self, x: Tensor<T>) -> Var<'t, T> {
        self.depth.tape().constant(x)
    }

    /// `t_k` at every pixel.
    pub(super) fn translation(&self, k: usize) -> Var<'t, T> {
        self.translation.slice(1, k, 1).broadcast_to(self.shape())
    }

    /// `p` minus the centre, two channels.
    pub(super) fn offsets(&self, form: ContextualForm) -> Var<'t, T> {
        let s = self.shape();
        let centre = |n: usize| match form {
            ContextualForm::Corrected => [self.intrinsics[n].u0, self.intrinsics[n].v0],
            _ => [(s.w() - 1) as f64 / 2.0, (s.h() - 1) as f64 / 2.0],
        };
        self.constant(Tensor::from_fn(s.with_c(2), |n, c, h, w| T::from_f64([w, h][c] as f64 - centre(n)[c])))
    }

    /// The inputs with harmless numbers where flow or depth is not finite, and the pixels where both are. No gate lets such a pixel
    /// pass, but 0 times its numbers would be NaN on the way back.
    pub(super) fn without_holes(self) -> (Self, Tensor<T>) {
        let (shape, flow, depth) = (self.shape(), self.flow.value(), self.depth.value());
        let whole = |n, h, w| [flow.at(n, 0, h, w), flow.at(n, 1, h, w), depth.at(n, 0, h, w)].iter().all(|x| x.is_finite());
        let one = |yes| if yes { T::ONE } else { T::ZERO };
        let finite = Tensor::from_fn(shape, |n, _, h, w| one(whole(n, h, w)));
        if finite.data().iter().all(|&f| f != T::ZERO) {
            return (self, finite);
        }
        let both = Tensor::from_fn(flow.shape(), |n, _, h, w| finite.at(n, 0, h, w));
        let flow = self.flow.select(&both, self.constant(Tensor::zeros(both.shape())));
        let depth = self.depth.select(&finite, self.constant(Tensor::full(shape, T::ONE)));
        (Self { flow, depth, ..self }, finite)
    }

    /// `f_opt - sg(f_rot)`.
    pub(super) fn translational_flow(&self, form: ContextualForm) -> Var<'t, T> {
        let rotational = match form {
            ContextualForm::AsCoded => stretched(self.rotational),
            _ => self.rotational.clone(),
        };
        self.flow.sub(self.constant(rotational))
    }
}

/// Flows whose ends `p + f` are multiplied by `W / (W - 1)` and `H / (H - 1)`: what DCPI-Depth's way back from sampling positions
/// makes of a flow. For comparison only.
#[must_use]
pub fn stretched<T: Scalar>(flow: &Tensor<T>) -> Tensor<T> {
    let s = flow.shape();
    let factor = [s.w(), s.h()].map(|size| T::from_f64(size as f64 / (size - 1) as f64));
    Tensor::from_fn(s, |n, c, h, w| {
        let p = T::from_usize([w, h][c]);
        (p + flow.at(n, c, h, w)) * factor[c] - p
    })
}

/// Error of the depth that the radial part of the flow implies ("v2").
///
/// **Gradient**: to flow, depth and `t_z`; none to the rotation.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn radial_depth<'t, T: Scalar>(inputs: &ContextualInputs<'_, 't, T>, form: ContextualForm) -> Gated<'t, T> {
    let (inputs, finite) = inputs.without_holes();
    let (q, f) = (inputs.offsets(form), inputs.translational_flow(form));
    let along = dot(q, f);
    let upper = inputs.translation(2).mul(dot(q, q).add(along)).neg();
    depth_error(upper, along.add_scalar(GUARD), inputs.depth, &finite)
}

/// Error of the depth triangulated from the sum of both image equations ("v1").
///
/// **Gradient**: to flow, depth, rotation and translation.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn triangulated_depth<'t, T: Scalar>(inputs: &ContextualInputs<'_, 't, T>, form: TriangulatedForm) -> Gated<'t, T> {
    let (inputs, finite) = inputs.without_holes();
    let s = inputs.shape();
    let column = Shape::new(s.n(), 1, 3, 1);
    let (rotation, translation) = match form {
        TriangulatedForm::Corrected => (inputs.rotation, inputs.translation),
        TriangulatedForm::AsCoded => {
            let back = inputs.rotation.transpose_hw();
            let moved = back.matmul(inputs.translation.reshape(column)).reshape(inputs.translation.shape());
            // -R^T t, and the code's own minus sign in front of the numerator.
            (back, moved)
        }
    };
    let ray = |n: usize, h: usize, w: usize| inputs.intrinsics[n].ray(w as f64, h as f64);
    let rays = Tensor::from_fn(s.with_c(3), |n, c, h, w| T::from_f64(ray(n, h, w)[c]));
    let flat = rays.reshaped(Shape::new(s.n(), 1, 3, s.plane()));
    let turned = rotation.matmul(inputs.constant(flat)).reshape(s.with_c(3));
    let per_pixel =
        Tensor::from_fn(s.with_c(2), |n, c, _, _| T::from_f64([1.0 / inputs.intrinsics[n].fu, 1.0 / inputs.intrinsics[n].fv][c]));
    let start = Tensor::from_fn(s, |n, _, h, w| T::from_f64(ray(n, h, w).x + ray(n, h, w).y));
    let sum = dot(inputs.flow, inputs.constant(per_pixel)).add(inputs.constant(start));
    let part = |x: Var<'t, T>, k: usize| x.slice(1, k, 1);
    let t = |k: usize| part(translation, k).broadcast_to(s);
    let upper = t(0).add(t(1)).sub(t(2).mul(sum));
    let lower = part(turned, 2).mul(sum).sub(part(turned, 0).add(part(turned, 1))).add_scalar(GUARD);
    depth_error(upper, lower, inputs.depth, &finite)
}

/// `a . b` over the channels.
pub(super) fn dot<'t, T: Scalar>(a: Var<'t, T>, b: Var<'t, T>) -> Var<'t, T> {
    let product = a.mul(b);
    product.sum_to(product.shape().with_c(1))
}

/// `|upper / lower - D| / (D + 1e-5)`, gated, of the pixels of a mask.
fn depth_error<'t, T: Scalar>(upper: Var<'t, T>, lower: Var<'t, T>, depth: Var<'t, T>, mask: &Tensor<T>) -> Gated<'t, T> {
    let guard = T::from_f64(GUARD);
    let pixels = upper
        .value()
        .data()
        .iter()
        .zip(lower.value().data())
        .zip(depth.value().data())
        .zip(mask.data())
        .map(|(((&u, &l), &d), &m)| {
            // A depth that is not positive cannot count.
            if d > T::ZERO && m != T::ZERO { (u / l - d).abs() / (d + guard) } else { T::from_f64(f64::INFINITY) }
        })
        .collect();
    let errors = Tensor::from_vec(depth.shape(), pixels);
    let kept = below(&errors, DEPTH_GATE);
    let one = depth.tape().constant(Tensor::full(depth.shape(), T::ONE));
    let safe = |x: Var<'t, T>| x.select(&kept, one);
    let depth = safe(depth);
    let error = safe(upper).div(safe(lower)).sub(depth).abs().div(depth.add_scalar(GUARD));
    Gated { mean: batch_mean(error, &kept, 0), errors, kept }
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::contextual_divergence::{DivergenceForm, divergence_agreement};
    use super::super::rigid_agreement::rigid_agreement;
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Tape, gradcheck};
    use dimode_geometry::Se3;
    use dimode_geometry::taped::pose::pose_tensors;
    use dimode_geometry::taped::{rigid_flow, so3_exp};
    use nalgebra::Vector3;

    const WIDTH: usize = 12;
    const HEIGHT: usize = 10;

    fn cameras() -> [Intrinsics; 2] {
        [[20.0, 22.0, 4.3, 5.6], [25.0, 24.0, 6.8, 4.2]].map(|[a, b, c, d]| Intrinsics::new(a, b, c, d, WIDTH, HEIGHT).unwrap())
    }

    /// A slanted plane seen by either camera.
    fn plane() -> Tensor<f64> {
        Tensor::from_fn(Shape::new(2, 1, HEIGHT, WIDTH), |n, _, h, w| {
            let ray = cameras()[n].ray(w as f64, h as f64);
            8.0 / (1.0 + 0.6 * ray.x - 0.5 * ray.y)
        })
    }

    fn flow_of(depth: &Tensor<f64>, motion: Se3) -> Tensor<f64> {
        let tape = Tape::new();
        let (r, t) = pose_tensors(&[motion; 2]);
        rigid_flow(tape.constant(depth.clone()), tape.constant(r), tape.constant(t), &cameras()).slice(1, 0, 2).value()
    }

    pub fn motion(w: [f64; 3], t: [f64; 3]) -> Se3 {
        Se3::from_rotation_vector(&Vector3::from(w), Vector3::from(t))
    }

    /// Runs `f` on the exact scene of a motion.
    pub fn exact<R>(m: Se3, f: impl FnOnce(&ContextualInputs<'_, '_, f64>) -> R) -> R {
        let (tape, depth) = (Tape::new(), plane());
        let (r, t) = pose_tensors(&[m; 2]);
        let still = Se3 { translation: Vector3::zeros(), ..m };
        f(&ContextualInputs {
            flow: tape.leaf(flow_of(&depth, m)),
            depth: tape.leaf(depth.clone()),
            rotation: tape.leaf(r),
            translation: tape.leaf(t),
            rotational: &flow_of(&depth, still),
            intrinsics: &cameras(),
        })
    }

    #[test]
    fn the_radial_depth_is_exact_without_rotation_about_the_right_centre() {
        exact(motion([0.0; 3], [0.0, 0.0, -1.0]), |inputs| {
            // What remains is the guard of 1e-5 beside q . f.
            let corrected = radial_depth(inputs, ContextualForm::Corrected);
            assert!(corrected.mean.value().item() < 1e-4, "{corrected:?}");
            assert!(radial_depth(inputs, ContextualForm::ImageCentre).mean.value().item() > 0.05);
            assert!(radial_depth(inputs, ContextualForm::AsCoded).mean.value().item() > 0.1);
        });
    }

    #[test]
    fn the_triangulated_depth_is_exact_for_any_motion() {
        exact(motion([0.02, -0.03, 0.04], [0.3, 0.2, -1.0]), |inputs| {
            let corrected = triangulated_depth(inputs, TriangulatedForm::Corrected);
            // Where x and y parts of the flow cancel, the guard of 1e-5 shows.
            assert!(corrected.mean.value().item() < 2e-3, "{}", corrected.mean.value().item());
            assert!(triangulated_depth(inputs, TriangulatedForm::AsCoded).mean.value().item() > 0.1);
        });
    }

    #[test]
    fn gradients_match_differences_in_every_form() {
        let depth = random::<f64>(1, Shape::new(2, 1, HEIGHT, WIDTH), 6.0, 7.0);
        let rotational = random::<f64>(3, Shape::new(2, 2, HEIGHT, WIDTH), 0.0, 0.1);
        let w = random::<f64>(4, Shape::new(2, 3, 1, 1), 0.0, 0.02);
        let t = Tensor::from_vec(Shape::new(2, 3, 1, 1), vec![0.2, 0.1, -1.0, -0.1, 0.2, -0.8]);
        // A noisy version of the flow of an axial motion, so that most errors are below the gates and none is 0.
        let base = flow_of(&depth, motion([0.0; 3], [0.1, 0.1, -1.0]));
        let noise = random::<f64>(5, base.shape(), 0.02, 0.1);
        let flow = Tensor::from_vec(base.shape(), base.data().iter().zip(noise.data()).map(|(a, b)| a + b).collect());
        let check = GradCheck { step: 1e-7, rtol: 1e-4, atol: 1e-6, allow_zero: false };
        let run = |f: &dyn for<'t> Fn(&ContextualInputs<'_, 't, f64>) -> Gated<'t, f64>| {
            let report = gradcheck(
                &[flow.clone(), depth.clone(), w.clone(), t.clone()],
                |_, v| {
                    let rotation = so3_exp(v[2]);
                    let (rotational, intrinsics) = (&rotational, &cameras());
                    f(&ContextualInputs { flow: v[0], depth: v[1], rotation, translation: v[3], rotational, intrinsics }).mean
                },
                check,
            );
            report.assert_ok();
        };
        for form in [ContextualForm::Corrected, ContextualForm::ImageCentre, ContextualForm::AsCoded] {
            run(&|i| radial_depth(i, form));
        }
        for form in [TriangulatedForm::Corrected, TriangulatedForm::AsCoded] {
            run(&|i| triangulated_depth(i, form));
        }
        for form in [DivergenceForm::Corrected, DivergenceForm::AsCoded] {
            run(&|i| divergence_agreement(i, ContextualForm::Corrected, form));
        }
        run(&|i| rigid_agreement(i.flow, &base));
    }

    #[test]
    fn without_motion_nothing_counts_and_nothing_is_nan() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(2, 1, HEIGHT, WIDTH);
        let (r, t) = pose_tensors::<f64>(&[Se3::identity(); 2]);
        let zero = Tensor::zeros(shape.with_c(2));
        let leaves = [tape.leaf(zero.clone()), tape.leaf(Tensor::full(shape, 3.0)), tape.leaf(r), tape.leaf(t)];
        let [flow, depth, rotation, translation] = leaves;
        let inputs = ContextualInputs { flow, depth, rotation, translation, rotational: &zero, intrinsics: &cameras() };
        let losses = [
            divergence_agreement(&inputs, ContextualForm::Corrected, DivergenceForm::Corrected).mean,
            divergence_agreement(&inputs, ContextualForm::AsCoded, DivergenceForm::AsCoded).mean,
            radial_depth(&inputs, ContextualForm::Corrected).mean,
            triangulated_depth(&inputs, TriangulatedForm::Corrected).mean,
            rigid_agreement(flow, &zero).mean,
        ];
        for loss in losses {
            assert!(loss.value().is_finite());
            let grads = tape.backward(loss);
            assert!(leaves.iter().all(|&v| grads.wrt(v).is_finite()));
        }
        assert_eq!(losses[0].value().item(), 0.0);
    }

    #[test]
    fn pixels_beyond_the_gate_have_no_gradient() {
        exact(motion([0.0; 3], [0.0, 0.0, -1.0]), |inputs| {
            let shape = inputs.shape();
            let wrong = Tensor::from_fn(shape, |n, _, h, w| if h == 3 { 0.01 } else { plane().at(n, 0, h, w) * 1.1 });
            let depth = inputs.depth.tape().leaf(wrong);
            let gated = radial_depth(&ContextualInputs { depth, ..*inputs }, ContextualForm::Corrected);
            let grad = inputs.depth.tape().backward(gated.mean).wrt(depth);
            for (g, k) in grad.data().iter().zip(gated.kept.data()) {
                assert_eq!(*g != 0.0, *k != 0.0);
            }
            assert!((0..WIDTH).all(|w| gated.kept.at(0, 0, 3, w) == 0.0));
        });
    }
}
