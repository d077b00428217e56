//! The losses of the network that learns to remove rotation (SC-Depth V2, auto-rectify; JiawangBian/sc_depth_pl,
//! `SC_DepthV2.py`), as functions of the rotations it said.
//!
//! The network says Euler angles: `r1` of (target, reference), `r2` of (target, reference after removal of `r1` by
//! [`derotate`](dimode_geometry::taped::derotate())), `r3` of (an image that was turned by known angles `g`, reference).
//!
//! **Formula**: consistency `mean |r3 - g|`, triplet `mean max(|r2| - |r1| + 0.05, 0)` entry by entry, both of weight 1. The known
//! angles are `sg(r1)` when `0.02 < mean |r1| < 0.1`, else drawn from U(-0.05, 0.05).

use dimode_autodiff::{Scalar, Tensor, Var, rng};

/// By how much the second rotation is to be smaller, radians.
const MARGIN: f64 = 0.05;
/// Mean absolute angle between which the network's own rotation is used for supervision, radians.
const TRUSTED: [f64; 2] = [0.02, 0.1];
/// Largest angle that is drawn otherwise, radians.
const DRAWN: f64 = 0.05;

/// The rotation that the third pass has to find.
#[derive(Clone, Debug, PartialEq)]
pub enum Supervision<T: Scalar> {
    /// The first pass's own, without gradient; the turned image is the rectified reference, without gradient.
    Own(Tensor<T>),
    /// A random one, by which the reference is to be turned.
    Drawn(Tensor<T>),
}

impl<T: Scalar> Supervision<T> {
    /// The rule for the angles of the first pass, all together; random ones come from the seed.
    #[must_use]
    pub fn of(first: &Tensor<T>, seed: u64) -> Self {
        let mean = first.data().iter().map(|x| x.to_f64().abs()).sum::<f64>() / first.shape().len() as f64;
        if TRUSTED[0] < mean && mean < TRUSTED[1] {
            return Supervision::Own(first.clone());
        }
        Supervision::Drawn(rng::uniform(seed, first.shape(), -DRAWN, DRAWN))
    }

    /// The angles.
    #[must_use]
    pub fn angles(&self) -> &Tensor<T> {
        match self {
            Supervision::Own(angles) | Supervision::Drawn(angles) => angles,
        }
    }
}

/// `mean |r3 - g|`, radians.
///
/// **Shapes**: equal, usually `[n, 3, 1, 1]`. **Gradient**: to `third`, 0 where it agrees. **Panics** when shapes differ.
#[track_caller]
pub fn rotation_consistency<'t, T: Scalar>(third: Var<'t, T>, known: &Tensor<T>) -> Var<'t, T> {
    third.sub(third.tape().constant(known.clone())).abs().mean()
}

/// `mean max(|r2| - |r1| + 0.05, 0)`, radians: what is left after removal must be smaller, by a margin, than what there was.
///
/// **Shapes**: equal, usually `[n, 3, 1, 1]`. **Gradient**: to both; it also pushes `r1` away from 0. **Panics** when shapes differ.
#[track_caller]
pub fn rotation_triplet<'t, T: Scalar>(first: Var<'t, T>, second: Var<'t, T>) -> Var<'t, T> {
    second.abs().sub(first.abs()).add_scalar(MARGIN).relu().mean()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::gradcheck::random;
    use dimode_autodiff::{GradCheck, Shape, Tape, gradcheck};

    fn angles(x: [f64; 3]) -> Tensor<f64> {
        Tensor::from_vec(Shape::new(1, 3, 1, 1), x.to_vec())
    }

    #[test]
    fn worked_values() {
        let tape = Tape::new();
        let r3 = tape.leaf(angles([0.03, -0.01, 0.02]));
        let known = angles([0.0, -0.01, 0.05]);
        let consistency = rotation_consistency(r3, &known);
        assert!((consistency.value().item() - 0.02).abs() < 1e-15);
        let third = 1.0 / 3.0;
        assert_eq!(tape.backward(consistency).wrt(r3).data(), [third, 0.0, -third]);
        let (r1, r2) = (tape.leaf(angles([0.1, -0.02, 0.0])), tape.leaf(angles([0.01, 0.03, -0.01])));
        // 0.01 - 0.1 + 0.05 < 0; 0.03 - 0.02 + 0.05; 0.01 - 0 + 0.05
        let triplet = rotation_triplet(r1, r2);
        assert!((triplet.value().item() - 0.04).abs() < 1e-15);
        let grads = tape.backward(triplet);
        assert_eq!(grads.wrt(r2).data(), [0.0, third, -third]);
        assert_eq!(grads.wrt(r1).data(), [0.0, third, 0.0]);
    }

    #[test]
    fn gradients_match_finite_differences() {
        let rotations: Vec<_> = (1..4).map(|seed| random(seed, Shape::new(3, 3, 1, 1), -0.1, 0.1)).collect();
        let known = random::<f64>(9, Shape::new(3, 3, 1, 1), -0.1, 0.1);
        let check = GradCheck { step: 1e-6, ..GradCheck::default() };
        gradcheck(&rotations, |_, v| rotation_triplet(v[0], v[1]).add(rotation_consistency(v[2], &known)), check).assert_ok();
    }

    #[test]
    fn moderate_rotations_supervise_themselves_and_others_are_drawn() {
        let moderate = angles([0.05, -0.04, 0.03]);
        assert_eq!(Supervision::of(&moderate, 1), Supervision::Own(moderate));
        for extreme in [angles([0.001, 0.0, 0.0]), angles([0.4, 0.2, -0.3])] {
            let drawn = Supervision::of(&extreme, 1);
            assert!(matches!(drawn, Supervision::Drawn(_)) && drawn != Supervision::of(&extreme, 2));
            assert_eq!(drawn, Supervision::of(&extreme, 1));
            assert!(drawn.angles().data().iter().all(|x| x.abs() <= 0.05));
        }
    }
}
