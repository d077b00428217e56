//! Mean of a map over the chosen pixels of a whole batch.

use dimode_autodiff::{Scalar, Shape, Tensor, Var};

/// `(sum of x where the mask is not 0) / count`, all samples together; 0 without gradient unless more than `more_than` entries
/// count.
///
/// **Shapes**: `map` and `mask` are equal; one number. **Gradient**: `1 / count` to the chosen entries, exactly 0 to the others,
/// which may hold anything. **Panics** when the shapes differ.
#[track_caller]
pub fn batch_mean<'t, T: Scalar>(map: Var<'t, T>, mask: &Tensor<T>, more_than: usize) -> Var<'t, T> {
    let (s, count) = (map.shape(), mask.data().iter().filter(|&&m| m != T::ZERO).count());
    let chosen = if count > more_than { mask.clone() } else { Tensor::zeros(mask.shape()) };
    let whole = Shape::new(1, s.n() * s.c(), s.h(), s.w());
    assert!(mask.shape() == s, "batch_mean: mask {} and map {s} differ", mask.shape());
    map.reshape(whole).masked_mean(&chosen.reshaped(whole))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape};

    #[test]
    fn pixels_of_all_samples_weigh_the_same_and_others_do_not_count() {
        let shape = Shape::new(2, 1, 1, 3);
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::from_vec(shape, vec![1.0, 2.0, f64::NAN, 6.0, f64::INFINITY, 8.0]));
        let mask = Tensor::from_vec(shape, vec![1.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
        let mean = batch_mean(x, &mask, 0);
        assert_eq!(mean.value().item(), 3.0);
        let third = 1.0 / 3.0;
        assert_eq!(tape.backward(mean).wrt(x).data(), [third, third, 0.0, third, 0.0, 0.0]);
    }

    #[test]
    fn too_few_pixels_give_nothing() {
        let tape = Tape::<f64>::new();
        let x = tape.leaf(Tensor::full(Shape::new(1, 1, 2, 2), 3.0));
        let mask = Tensor::full(x.shape(), 1.0);
        for (more_than, value) in [(3, 3.0), (4, 0.0)] {
            let mean = batch_mean(x, &mask, more_than);
            assert_eq!(mean.value().item(), value);
            assert_eq!(tape.backward(mean).wrt(x).data(), [value / 12.0; 4]);
        }
    }
}
