//! Dynamo-Depth: the flow of the camera's own motion, of moving things, and a soft mask that tells them apart.
//!
//! **Formula** [YihongSun/Dynamo-Depth, `Trainer.py`, `networks/model.py`]. Flows here are three-dimensional, in units of depth:
//! with points `X = D b`, `T X = R X + t`, the network's complete flow `F` and motion mask `m = sigmoid(logit)`,
//! 1 = moves by itself:
//!
//! - `F_ego = T X - X`, `F_res = F - F_ego`, `F_ind = m F_res`; the source is read at the projection of `T (X + F_ind)`;
//! - [`consistency`] `mean( [d > 0.03] (1 - sg(m)) |F_res| )` over samples, components and pixels, `d` the sigmoid disparity;
//! - [`sparsity`] mean of `ln(1 + exp(logit))` over static pixels of the batch, by
//!   [`static_on_grid`](dimode_geometry::taped::masks::static_on_grid) as coded or
//!   [`static_pixels`](dimode_geometry::taped::masks::static_pixels);
//! - [`mask_smoothness`] and [`flow_smoothness`]: edge-aware first order of `m` and of `F`, without normalisation;
//! - [`MotionTerms::weighted`]: `ramp (5 consistency + 0.04 sparsity + 0.1 smoothness of m + 0.001 smoothness of F)`, divided by
//!   `2^scale` and by the number of sources; scales are averaged.
//!
//! The mask also serves other losses as a weight, [`still`](dimode_geometry::taped::weighted::still).
//!
//! The penalty on points below the ground stands apart, in [`below_ground`](super::below_ground).

use dimode_autodiff::{Scalar, Shape, Tensor, Var};
use dimode_geometry::Intrinsics;
use dimode_geometry::taped::{MIN_DEPTH, Pose};

use super::masked::batch_mean;
use super::smoothness::edge_aware;

/// Disparities up to this one (sigmoid) count as infinitely far, where no motion can be seen.
const FAR: f64 = 0.03;

/// The flows of a scene in space, all `[n, 3, h, w]`, units of depth.
#[derive(Clone, Copy, Debug)]
pub struct SceneFlow<'t, T: Scalar> {
    /// Points `X` of the target view.
    pub points: Var<'t, T>,
    /// `F_ego`: what the camera's motion does to them.
    pub ego: Var<'t, T>,
    /// `F_res`: what the complete flow has beyond that.
    pub residual: Var<'t, T>,
    /// `F_ind`: the part of it where things move by themselves.
    pub independent: Var<'t, T>,
}

/// Splits the complete flow.
///
/// **Shapes**: `depth` `[n, 1, h, w]`; `complete` `[n, 3, h, w]`, towards the source at hand (the network's flow is negated for the
/// previous frame); `mask` `[n, 1, h, w]`, 1 = moves by itself.
/// **Gradient**: to all.
///
/// # Panics
/// When shapes differ or there is not one camera for each sample.
#[track_caller]
pub fn scene_flow<'t, T: Scalar>(
    depth: Var<'t, T>,
    pose: Pose<'t, T>,
    complete: Var<'t, T>,
    mask: Var<'t, T>,
    intrinsics: &[Intrinsics],
) -> SceneFlow<'t, T> {
    let shape = depth.shape().with_c(3);
    assert!(intrinsics.len() == shape.n(), "scene_flow: {} cameras for depth {}", intrinsics.len(), depth.shape());
    let points = depth.broadcast_to(shape).mul(depth.tape().constant(rays(shape, intrinsics)));
    let ego = displacement(points, pose);
    let residual = complete.sub(ego);
    let independent = residual.mul(mask.broadcast_to(shape));
    SceneFlow { points, ego, residual, independent }
}

impl<'t, T: Scalar> SceneFlow<'t, T> {
    /// Flow in the image to the projection of `T (X + F_ind)`, and the depth there: `[n, 3, h, w]`, u and v in pixels.
    ///
    /// **Domain**: where the depth is not above [`MIN_DEPTH`] the flow is 0 without gradient; mask by the third channel.
    ///
    /// # Panics
    /// When there is not one camera for each sample.
    #[must_use]
    #[track_caller]
    pub fn image_flow(&self, pose: Pose<'t, T>, intrinsics: &[Intrinsics]) -> Var<'t, T> {
        let moved = self.points.add(self.independent);
        image_flow(moved.add(displacement(moved, pose)), intrinsics)
    }

    /// The same with the complete flow instead: the projection of `X + F`.
    ///
    /// # Panics
    /// When there is not one camera for each sample.
    #[must_use]
    #[track_caller]
    pub fn complete_image_flow(&self, intrinsics: &[Intrinsics]) -> Var<'t, T> {
        image_flow(self.points.add(self.ego).add(self.residual), intrinsics)
    }
}

fn rays<T: Scalar>(shape: Shape, intrinsics: &[Intrinsics]) -> Tensor<T> {
    Tensor::from_fn(shape, |n, c, h, w| T::from_f64(intrinsics[n].ray(w as f64, h as f64)[c]))
}

/// `T X - X = (R - I) X + t`: written this way small motions keep their digits.
fn displacement<'t, T: Scalar>(points: Var<'t, T>, pose: Pose<'t, T>) -> Var<'t, T> {
    let (s, tape) = (points.shape(), points.tape());
    let identity = Tensor::from_fn(pose.rotation.shape(), |_, _, i, j| if i == j { T::ONE } else { T::ZERO });
    let columns = points.reshape(Shape::new(s.n(), 1, 3, s.plane()));
    let turned = pose.rotation.sub(tape.constant(identity)).matmul(columns).reshape(s);
    turned.add(pose.translation.broadcast_to(s))
}

/// From the pixels of the target to the projections of points `[n, 3, h, w]`.
#[track_caller]
fn image_flow<'t, T: Scalar>(points: Var<'t, T>, intrinsics: &[Intrinsics]) -> Var<'t, T> {
    let (s, tape) = (points.shape(), points.tape());
    assert!(intrinsics.len() == s.n(), "image_flow: {} cameras for points {s}", intrinsics.len());
    let map = s.with_c(1);
    let rays = tape.constant(rays::<T>(s, intrinsics));
    let depth = points.slice(1, 2, 1);
    let near = T::from_f64(MIN_DEPTH);
    let front = Tensor::from_vec(map, depth.value().data().iter().map(|&z| if z > near { T::ONE } else { T::ZERO }).collect());
    let (one, zero) = (tape.constant(Tensor::full(map, T::ONE)), tape.constant(Tensor::zeros(map)));
    let safe_depth = depth.select(&front, one);
    let along = |c: usize| {
        let focal = Tensor::from_fn(map, |n, _, _, _| T::from_f64([intrinsics[n].fu, intrinsics[n].fv][c]));
        // f (X / Z - x) = f (X - x Z) / Z
        let off = points.slice(1, c, 1).sub(rays.slice(1, c, 1).mul(depth)).select(&front, zero);
        off.div(safe_depth).mul(tape.constant(focal))
    };
    Var::concat(&[along(0), along(1), depth.select(&front, depth.detach())], 1)
}

/// `mean( [d > 0.03] (1 - sg(m)) |F_res| )`: what does not move by itself moves with the camera.
///
/// **Shapes**: `residual` `[n, 3, h, w]`; `mask` and `disparity` (sigmoid) `[n, 1, h, w]`.
/// **Gradient**: to the residual; slope 0 at 0, exactly 0 for far pixels.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn consistency<'t, T: Scalar>(residual: Var<'t, T>, mask: &Tensor<T>, disparity: &Tensor<T>) -> Var<'t, T> {
    let (shape, tape) = (residual.shape(), residual.tape());
    let map = shape.with_c(1);
    assert!(
        mask.shape() == map && disparity.shape() == map,
        "consistency: mask {} and disparity {} do not go with flow {shape}",
        mask.shape(),
        disparity.shape()
    );
    let far = T::from_f64(FAR);
    let still = |(&m, &d): (&T, &T)| if d > far { T::ONE - m } else { T::ZERO };
    let weights = Tensor::from_vec(map, mask.data().iter().zip(disparity.data()).map(still).collect());
    let weights = tape.constant(weights).broadcast_to(shape);
    let zero = tape.constant(Tensor::zeros(shape));
    residual.abs().select(&weights.value(), zero).mul(weights).mean()
}

/// Mean of `ln(1 + exp(logit))` over the static pixels of the batch: the mask's cross entropy against "does not move".
///
/// **Shapes**: both `[n, 1, h, w]`. **Gradient**: `m / count` at static pixels, exactly 0 at others; no static pixel gives 0.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn sparsity<'t, T: Scalar>(logit: Var<'t, T>, static_pixels: &Tensor<T>) -> Var<'t, T> {
    let s = logit.shape();
    assert!(static_pixels.shape() == s, "sparsity: static pixels {} and logits {s} differ", static_pixels.shape());
    let zero = logit.tape().constant(Tensor::zeros(s));
    batch_mean(logit.select(static_pixels, zero).log1p_exp(), static_pixels, 0)
}

/// Edge-aware smoothness of the mask `[n, 1, h, w]` under images.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn mask_smoothness<'t, T: Scalar>(mask: Var<'t, T>, images: &Tensor<T>) -> Var<'t, T> {
    edge_aware(mask, images, 1.0)
}

/// Edge-aware smoothness of the complete flow `[n, 3, h, w]` under images.
///
/// # Panics
/// When sizes differ or a side is shorter than 2 pixels.
#[track_caller]
pub fn flow_smoothness<'t, T: Scalar>(complete: Var<'t, T>, images: &Tensor<T>) -> Var<'t, T> {
    edge_aware(complete, images, 1.0)
}

/// Weights of the four terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionWeights {
    /// Of [`consistency`].
    pub consistency: f64,
    /// Of [`sparsity`].
    pub sparsity: f64,
    /// Of [`mask_smoothness`].
    pub mask_smoothness: f64,
    /// Of [`flow_smoothness`].
    pub flow_smoothness: f64,
}

impl Default for MotionWeights {
    /// Those of the public code.
    fn default() -> Self {
        Self { consistency: 5.0, sparsity: 0.04, mask_smoothness: 0.1, flow_smoothness: 1e-3 }
    }
}

/// The terms of one scale and source.
#[derive(Clone, Copy, Debug)]
pub struct MotionTerms<'t, T: Scalar> {
    /// [`consistency`].
    pub consistency: Var<'t, T>,
    /// [`sparsity`].
    pub sparsity: Var<'t, T>,
    /// [`mask_smoothness`].
    pub mask_smoothness: Var<'t, T>,
    /// [`flow_smoothness`].
    pub flow_smoothness: Var<'t, T>,
}

impl<'t, T: Scalar> MotionTerms<'t, T> {
    /// Their sum with weights times `ramp`, divided by `2^scale` and by the number of sources.
    #[must_use]
    pub fn weighted(&self, weights: &MotionWeights, ramp: f64, scale: u32, sources: usize) -> Var<'t, T> {
        let share = ramp / (f64::from(2_u32.pow(scale)) * sources as f64);
        let terms = [
            (self.consistency, weights.consistency),
            (self.sparsity, weights.sparsity),
            (self.mask_smoothness, weights.mask_smoothness),
            (self.flow_smoothness, weights.flow_smoothness),
        ];
        terms.map(|(term, weight)| term.scale(weight * share)).into_iter().reduce(|a, b| a.add(b)).expect("four terms")
    }
}

/// Share of the motion weights at a step of their phase: `3 step / steps_per_epoch`, from 0 to 1.
///
/// # Panics
/// When an epoch has no step.
#[must_use]
#[track_caller]
pub fn ramp(step: u64, steps_per_epoch: u64) -> f64 {
    assert!(steps_per_epoch > 0, "ramp: an epoch has at least one step");
    (3.0 * step as f64 / steps_per_epoch as f64).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::{random, weighted_sum};
    use dimode_autodiff::{GradCheck, Tape, gradcheck};
    use dimode_geometry::taped::{rigid_flow, so3_exp};

    const MAP: Shape = Shape([2, 1, 4, 5]);
    const VECTOR: Shape = Shape([2, 3, 1, 1]);

    fn cameras() -> [Intrinsics; 2] {
        [[9.0, 8.0, 2.1, 1.4], [7.0, 7.5, 1.8, 1.7]].map(|[a, b, c, d]| Intrinsics::new(a, b, c, d, 5, 4).unwrap())
    }

    /// Depth, rotation vector, translation, complete flow, mask.
    fn inputs() -> [Tensor<f64>; 5] {
        [
            random(1, MAP, 3.0, 5.0),
            random(2, VECTOR, -0.1, 0.1),
            random(3, VECTOR, -0.3, 0.3),
            random(4, MAP.with_c(3), -0.5, 0.5),
            random(5, MAP, 0.1, 0.9),
        ]
    }

    fn split<'t>(v: &[Var<'t, f64>]) -> (SceneFlow<'t, f64>, Pose<'t, f64>) {
        let pose = Pose { rotation: so3_exp(v[1]), translation: v[2] };
        (scene_flow(v[0], pose, v[3], v[4], &cameras()), pose)
    }

    fn largest_difference(a: &Tensor<f64>, b: &Tensor<f64>) -> f64 {
        a.data().iter().zip(b.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn where_nothing_moves_by_itself_the_image_flow_is_the_rigid_flow() {
        let tape = Tape::new();
        let mut inputs = inputs();
        inputs[4] = Tensor::zeros(MAP);
        let v = inputs.map(|x| tape.leaf(x));
        let (scene, pose) = split(&v);
        let rigid = rigid_flow(v[0], pose.rotation, pose.translation, &cameras());
        assert!(largest_difference(&scene.image_flow(pose, &cameras()).value(), &rigid.value()) < 1e-12);
        assert!(largest_difference(&scene.ego.add(scene.residual).value(), &v[3].value()) < 1e-15);
    }

    #[test]
    fn a_mask_of_one_without_rotation_gives_the_complete_flow() {
        let tape = Tape::new();
        let mut inputs = inputs();
        inputs[1] = Tensor::zeros(VECTOR);
        inputs[4] = Tensor::full(MAP, 1.0);
        let v = inputs.map(|x| tape.leaf(x));
        let (scene, pose) = split(&v);
        let [found, complete] = [scene.image_flow(pose, &cameras()), scene.complete_image_flow(&cameras())].map(|f| f.value());
        assert!(largest_difference(&found, &complete) < 1e-12);
    }

    #[test]
    fn gradients_of_the_flows_match_differences() {
        let check = GradCheck { step: 1e-4, rtol: 1e-6, ..GradCheck::default() };
        fn all<'t>(v: &[Var<'t, f64>]) -> Var<'t, f64> {
            let (scene, pose) = split(v);
            weighted_sum(scene.image_flow(pose, &cameras()), 1).add(weighted_sum(scene.independent, 2))
        }
        gradcheck(&inputs(), |_, v| all(v), check).assert_ok();
        gradcheck(
            &inputs()[..4],
            |tape, v| {
                let mask = tape.constant(Tensor::full(MAP, 0.5));
                weighted_sum(split(&[v[0], v[1], v[2], v[3], mask]).0.complete_image_flow(&cameras()), 3)
            },
            check,
        )
        .assert_ok();
    }

    #[test]
    fn points_behind_the_camera_have_no_flow_and_no_gradient() {
        let tape = Tape::new();
        let mut inputs = inputs();
        inputs[2] = Tensor::from_fn(VECTOR, |n, c, _, _| if n == 1 && c == 2 { -9.0 } else { 0.1 });
        inputs[4] = Tensor::zeros(MAP);
        let v = inputs.map(|x| tape.leaf(x));
        let (scene, pose) = split(&v);
        let flow = scene.image_flow(pose, &cameras());
        assert!((0..2).all(|c| flow.value().plane(1, c).iter().all(|&f| f == 0.0)));
        assert!(flow.value().plane(1, 2).iter().all(|&z| z < 0.0));
        let grad = tape.backward(weighted_sum(flow, 1)).wrt(v[0]);
        assert!(grad.plane(1, 0).iter().all(|&g| g == 0.0) && grad.plane(0, 0).iter().all(|&g| g != 0.0));
    }

    #[test]
    fn worked_consistency_leaves_out_far_and_moving_pixels() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 1, 1, 4);
        let residual =
            tape.leaf(Tensor::from_vec(shape.with_c(3), vec![1.0, -1.0, f64::NAN, 2.0, 0.0, 0.0, 9.0, 0.0, -2.0, 1.0, 9.0, 0.0]));
        let mask = Tensor::from_vec(shape, vec![0.5, 0.75, 0.0, 1.0]);
        let disparity = Tensor::from_vec(shape, vec![0.5, 0.04, 0.03, 0.5]);
        let loss = consistency(residual, &mask, &disparity);
        assert_eq!(loss.value().item(), (0.5 * 3.0 + 0.25 * 2.0) / 12.0);
        let grad = tape.backward(loss).wrt(residual);
        let (half, quarter) = (0.5 / 12.0, 0.25 / 12.0);
        assert_eq!(grad.data(), [half, -quarter, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -half, quarter, 0.0, 0.0]);
    }

    #[test]
    fn worked_sparsity_counts_static_pixels_of_the_whole_batch() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(2, 1, 1, 2);
        let logit = tape.leaf(Tensor::from_vec(shape, vec![0.0, f64::NAN, f64::NAN, (3.0_f64).ln()]));
        let loss = sparsity(logit, &Tensor::from_vec(shape, vec![1.0, 0.0, 0.0, 1.0]));
        assert!((loss.value().item() - (2.0_f64.ln() + 4.0_f64.ln()) / 2.0).abs() < 1e-15);
        let grad = tape.backward(loss).wrt(logit);
        assert!((grad.data()[0] - 0.25).abs() < 1e-15 && (grad.data()[3] - 0.375).abs() < 1e-15);
        assert_eq!(grad.data()[1..3], [0.0; 2]);
        let none = sparsity(logit, &Tensor::zeros(shape));
        assert_eq!(none.value().item(), 0.0);
        assert!(tape.backward(none).wrt(logit).data().iter().all(|&g| g == 0.0));
    }

    #[test]
    fn gradients_of_the_terms_match_differences() {
        let image = random::<f64>(6, MAP.with_c(3), 0.0, 1.0);
        let disparity = random::<f64>(7, MAP, 0.0, 0.1);
        let still = Tensor::from_fn(MAP, |n, _, h, w| ((n + h + w) % 2) as f64);
        let logit = random(8, MAP, -1.0, 1.0);
        // Away from 0, where the absolute value has its kink.
        let residual = Tensor::from_vec(
            MAP.with_c(3),
            random::<f64>(9, MAP.with_c(3), -1.0, 1.0).data().iter().map(|x| x + x.signum()).collect(),
        );
        let check = GradCheck { step: 1e-5, rtol: 1e-6, ..GradCheck::default() };
        let report = gradcheck(
            &[residual, logit],
            |_, v| {
                let terms = MotionTerms {
                    consistency: consistency(v[0], &Tensor::full(MAP, 0.3), &disparity),
                    sparsity: sparsity(v[1], &still),
                    mask_smoothness: mask_smoothness(v[1].sigmoid(), &image),
                    flow_smoothness: flow_smoothness(v[0], &image),
                };
                terms.weighted(
                    &MotionWeights { consistency: 1.0, sparsity: 2.0, mask_smoothness: 3.0, flow_smoothness: 4.0 },
                    0.5,
                    1,
                    2,
                )
            },
            check,
        );
        report.assert_ok();
    }

    #[test]
    fn weights_ramp_and_scales() {
        assert_eq!([0, 1, 2, 3, 9].map(|step| ramp(step, 9)), [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0, 1.0]);
        let tape = Tape::<f64>::new();
        let one = tape.constant(Tensor::scalar(1.0));
        let terms = MotionTerms { consistency: one, sparsity: one, mask_smoothness: one, flow_smoothness: one };
        let sum = terms.weighted(&MotionWeights::default(), 0.5, 2, 2).value().item();
        assert!((sum - 5.141 * 0.5 / 8.0).abs() < 1e-15);
    }
}
