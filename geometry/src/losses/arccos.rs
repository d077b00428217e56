//! The angle behind a cosine, as printed in `L_pla` and `L_axi`.

use dimode_autodiff::{Scalar, Tensor, Var};

/// `arccos(c)` of cosines that rounding may have taken beyond ±1, radians in `[0, π]`.
///
/// **Gradient**: `-g / √(1 - c²)`, but 0 where the cosine is ±1 to rounding: the true slope is infinite there, and the flow of a
/// car that drives straight ahead is such a place. Values stay as printed.
pub(super) fn arccos<T: Scalar>(cosine: Var<'_, T>) -> Var<'_, T> {
    let clamped = cosine.clamp(-1.0, 1.0);
    let values = clamped.value();
    let has_slope = values.data().iter().map(|c| if c.abs() < T::ONE { T::ONE } else { T::ZERO }).collect();
    clamped.select(&Tensor::from_vec(values.shape(), has_slope), clamped.detach()).acos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape};

    #[test]
    fn ends_have_their_value_and_no_slope() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::from_vec(Shape::new(1, 1, 1, 5), vec![-1.0 - 1e-15, -1.0, 0.6, 1.0, 1.0 + 1e-15]));
        let y = arccos(x);
        let pi = std::f64::consts::PI;
        assert_eq!(y.value().data(), [pi, pi, 0.6_f64.acos(), 0.0, 0.0]);
        let slopes = tape.backward(y.sum()).wrt(x);
        assert_eq!(slopes.data()[..2], [0.0; 2]);
        assert!((slopes.data()[2] + 1.25).abs() < 1e-14);
        assert_eq!(slopes.data()[3..], [0.0; 2]);
    }
}
