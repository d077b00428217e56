//! `L_rig` of DCPI-Depth: optical and rigid flow agree, relative to the flow.
//!
//! **Formula** [mengtanZ/DCPI-Depth, `trainer.py`]: the mean of `|f_opt - sg(f_rig)| / |f_opt + 1e-5|` over the components of the batch
//! where that is below 0.5.

use dimode_autodiff::{Scalar, Tensor, Var};

use super::gated::{GUARD, Gated, relative};

/// Relative errors of flow components from here on do not count.
pub const RIGID_GATE: f64 = 0.5;

/// `L_rig`: relative difference of optical and rigid flow, component by component; `rigid` is `[n, 2, h, w]`, pixels.
///
/// **Gradient**: to the optical flow.
///
/// # Panics
/// When shapes differ.
#[track_caller]
pub fn rigid_agreement<'t, T: Scalar>(optical: Var<'t, T>, rigid: &Tensor<T>) -> Gated<'t, T> {
    let difference = optical.sub(optical.tape().constant(rigid.clone()));
    relative(difference, optical.add_scalar(GUARD), None, RIGID_GATE)
}

#[cfg(test)]
mod tests {
    use dimode_autodiff::{Shape, Tape};

    use super::*;

    #[test]
    fn rigid_agreement_is_relative_and_gated() {
        let tape = Tape::<f64>::new();
        let shape = Shape::new(1, 2, 1, 2);
        let flow = tape.leaf(Tensor::from_vec(shape, vec![2.0, 1.0, -1e-5, 4.0]));
        let gated = rigid_agreement(flow, &Tensor::from_vec(shape, vec![1.5, 3.0, 1.0, 4.0]));
        // 0.25; 2 does not count; a denominator of 0 does not count; 0.
        assert!((gated.mean.value().item() - 0.125).abs() < 1e-5);
        assert_eq!(gated.kept.data(), [1.0, 0.0, 0.0, 1.0]);
        let grad = tape.backward(gated.mean).wrt(flow);
        // d/df of (f - 1.5) / f = 1.5 / f^2, over two entries.
        assert!((grad.data()[0] - 1.5 / 8.0).abs() < 1e-5);
        assert_eq!(grad.data()[1..], [0.0; 3]);
    }
}
