//! Minimum over sources with auto-masking: a pixel counts for the source that explains it best, and not at all where an unwarped
//! source explains it better than every warped one.
//!
//! `m(p) = min(identity_1, .., identity_k, warped_1, .., warped_k)`. The gradient goes to the warped map that wins; the first one
//! wins a tie, and identities win ties against warped maps.

use dimode_autodiff::{Scalar, Tensor, Var};

/// The minimum map and who won.
pub struct MinReprojection<'t, T: Scalar> {
    /// Error of the winner, `[n, 1, h, w]`.
    pub error: Var<'t, T>,
    /// Share of pixels won by a warped source.
    pub share: f64,
    /// Who won each pixel, in the order identities, then warped maps; in the order of `error`'s buffer.
    pub winners: Vec<u8>,
    /// The auto-mask: 1 where a warped source won, `[n, 1, h, w]`.
    pub mask: Tensor<T>,
}

/// Per-pixel minimum of error maps `[n, 1, h, w]`: `warped` ones carry gradients, `identities` do not (empty: no auto-mask).
///
/// # Panics
/// When there is no warped map or shapes differ.
#[track_caller]
pub fn min_reprojection<'t, T: Scalar>(warped: &[Var<'t, T>], identities: &[Tensor<T>]) -> MinReprojection<'t, T> {
    let shape = warped.first().expect("min_reprojection: at least one warped map").shape();
    let maps: Vec<Tensor<T>> = warped.iter().map(|w| w.value()).collect();
    for map in maps.iter().chain(identities) {
        assert!(map.shape() == shape, "min_reprojection: maps must have equal shapes, got {shape} and {}", map.shape());
    }
    let tape = warped[0].tape();
    let mut error = tape.scratch(shape.len());
    let mut winners = vec![0; shape.len()];
    error.fill(T::from_f64(f64::INFINITY));
    for (who, map) in identities.iter().chain(&maps).enumerate() {
        for ((e, w), &m) in error.iter_mut().zip(&mut winners).zip(map.data()) {
            // Written so that a NaN wins and is seen, instead of vanishing in a comparison.
            if m < *e || m.is_nan() {
                *e = m;
                *w = who as u8;
            }
        }
    }
    let first = identities.len();
    let warped_won = |&w: &u8| usize::from(w) >= first;
    let share = winners.iter().filter(|w| warped_won(w)).count() as f64 / shape.len() as f64;
    let mask = Tensor::from_vec(shape, winners.iter().map(|w| if warped_won(w) { T::ONE } else { T::ZERO }).collect());
    let output = tape.tensor(shape, error);
    let won = winners.clone();
    let error = tape.push("min_reprojection", output, warped, move |g, grads| {
        for k in 0..grads.len() {
            if let Some(mut slot) = grads.slot(k) {
                for ((d, &g), &w) in slot.as_mut_slice().iter_mut().zip(g.data()).zip(&won) {
                    if usize::from(w) == first + k {
                        *d += g;
                    }
                }
            }
        }
    });
    MinReprojection { error, share, winners, mask }
}

/// The variant that averages over the sources first: the smaller one of the mean warped and the mean identity error
/// (Monodepth2's option `avg_reprojection`). The mean makes no choice between sources, so an occluded one spoils the pixel.
///
/// # Panics
/// When there is no warped map or shapes differ.
#[track_caller]
pub fn average_reprojection<'t, T: Scalar>(warped: &[Var<'t, T>], identities: &[Tensor<T>]) -> MinReprojection<'t, T> {
    let mean = |maps: &[Var<'t, T>]| {
        let sum = maps.iter().copied().reduce(|a, b| a.add(b))?;
        Some(sum.scale(1.0 / maps.len() as f64))
    };
    let average = mean(warped).expect("average_reprojection: at least one warped map");
    let tape = average.tape();
    let constants: Vec<_> = identities.iter().map(|map| tape.constant(map.clone())).collect();
    let still: Vec<_> = mean(&constants).map(|map| map.value()).into_iter().collect();
    min_reprojection(&[average], &still)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::{Shape, Tape};

    #[test]
    fn the_gradient_goes_to_the_winner_only() {
        let shape = Shape::new(1, 1, 1, 4);
        let tape = Tape::<f64>::new();
        let a = tape.leaf(Tensor::from_vec(shape, vec![1.0, 5.0, 2.0, 3.0]));
        let b = tape.leaf(Tensor::from_vec(shape, vec![2.0, 4.0, 2.0, 9.0]));
        let identity = Tensor::from_vec(shape, vec![9.0, 9.0, 9.0, 0.5]);
        let m = min_reprojection(&[a, b], &[identity]);
        assert_eq!(m.error.value().data(), [1.0, 4.0, 2.0, 0.5]);
        assert_eq!(m.share, 0.75);
        assert_eq!((m.winners, m.mask.data()), (vec![1, 2, 1, 0], [1.0, 1.0, 1.0, 0.0].as_slice()));
        let grads = tape.backward(m.error.sum());
        assert_eq!(grads.wrt(a).data(), [1.0, 0.0, 1.0, 0.0]);
        assert_eq!(grads.wrt(b).data(), [0.0, 1.0, 0.0, 0.0]);
    }

    #[test]
    fn the_average_shares_the_gradient_between_the_sources() {
        let shape = Shape::new(1, 1, 1, 2);
        let tape = Tape::<f64>::new();
        let a = tape.leaf(Tensor::from_vec(shape, vec![1.0, 5.0]));
        let b = tape.leaf(Tensor::from_vec(shape, vec![2.0, 4.0]));
        let identities = [3.0, 5.0].map(|first| Tensor::from_vec(shape, vec![first, 1.0]));
        let m = average_reprojection(&[a, b], &identities);
        assert_eq!(m.error.value().data(), [1.5, 1.0]);
        let grads = tape.backward(m.error.sum());
        assert_eq!(grads.wrt(a).data(), [0.5, 0.0]);
        assert_eq!(grads.wrt(b).data(), [0.5, 0.0]);
    }
}
