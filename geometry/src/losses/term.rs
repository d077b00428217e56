//! What a loss returns.

use dimode_autodiff::{Scalar, Tensor, Var};

use crate::taped::masks;

/// Angles of aligned flows, radians.
#[derive(Clone, Debug)]
pub struct Angles<'t, T: Scalar> {
    /// The angle of every pixel, (N,1,H,W); a constant outside the mask.
    pub angle: Var<'t, T>,
    /// Pixels whose angle means something, (N,1,H,W).
    pub mask: Tensor<T>,
}

/// One loss over a batch.
#[derive(Clone, Debug)]
pub struct LossTerm<'t, T: Scalar> {
    /// Value of every image, (N,1,1,1).
    pub per_image: Var<'t, T>,
    /// Usable pixels of every image.
    pub counts: Vec<usize>,
    /// Mean over the images with enough usable pixels, (1,1,1,1); a constant 0 when there is none.
    pub mean: Var<'t, T>,
}

impl<'t, T: Scalar> LossTerm<'t, T> {
    /// Averages over the images whose `mask` keeps at least the part `min_valid_share` of the pixels.
    pub(crate) fn new(per_image: Var<'t, T>, mask: &Tensor<T>, min_valid_share: f64) -> Self {
        Self::from_counts(per_image, masks::counts(mask), mask.shape().plane(), min_valid_share)
    }

    /// As [`LossTerm::new`], from the numbers of usable pixels among those of a `plane`.
    pub(crate) fn from_counts(per_image: Var<'t, T>, counts: Vec<usize>, plane: usize, min_valid_share: f64) -> Self {
        let least = (min_valid_share * plane as f64).ceil().max(1.0) as usize;
        let enough: Vec<bool> = counts.iter().map(|&c| c >= least).collect();
        let images = enough.iter().filter(|&&e| e).count();
        let tape = per_image.tape();
        let shape = per_image.shape();
        let mean = if images == 0 {
            tape.constant(Tensor::scalar(T::ZERO))
        } else {
            let chosen = Tensor::from_fn(shape, |n, _, _, _| if enough[n] { T::ONE } else { T::ZERO });
            let zero = tape.constant(Tensor::zeros(shape));
            per_image.select(&chosen, zero).sum().scale(1.0 / images as f64)
        };
        Self { per_image, counts, mean }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape};

    #[test]
    fn images_with_too_few_pixels_do_not_count() {
        let tape = Tape::<f64>::new();
        let values = tape.leaf(Tensor::from_vec(Shape::new(3, 1, 1, 1), vec![1.0, f64::NAN, 4.0]));
        let mut mask = vec![1.0; 12];
        mask[4..8].fill(0.0);
        let mask = Tensor::from_vec(Shape::new(3, 1, 2, 2), mask);
        let term = LossTerm::new(values, &mask, 0.3);
        assert_eq!((term.mean.value().item(), term.counts), (2.5, vec![4, 0, 4]));
        assert_eq!(tape.backward(term.mean).wrt(values).to_vec(), [0.5, 0.0, 0.5]);
        let none = LossTerm::new(values, &Tensor::zeros(Shape::new(3, 1, 2, 2)), 0.3);
        assert_eq!(none.mean.value().item(), 0.0);
    }
}
