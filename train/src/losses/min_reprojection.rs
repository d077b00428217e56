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
    let mut winner = vec![u8::MAX; shape.len()];
    error.fill(T::from_f64(f64::INFINITY));
    let candidates = identities.iter().map(|map| (u8::MAX, map)).chain(maps.iter().enumerate().map(|(k, m)| (k as u8, m)));
    for (who, map) in candidates {
        for ((e, w), &m) in error.iter_mut().zip(&mut winner).zip(map.data()) {
            // Written so that a NaN wins and is seen, instead of vanishing in a comparison.
            if m < *e || m.is_nan() {
                *e = m;
                *w = who;
            }
        }
    }
    let share = winner.iter().filter(|&&w| w != u8::MAX).count() as f64 / shape.len() as f64;
    let output = tape.tensor(shape, error);
    let error = tape.push("min_reprojection", output, warped, move |g, grads| {
        for k in 0..grads.len() {
            if let Some(mut slot) = grads.slot(k) {
                for ((d, &g), &w) in slot.as_mut_slice().iter_mut().zip(g.data()).zip(&winner) {
                    if w == k as u8 {
                        *d += g;
                    }
                }
            }
        }
    });
    MinReprojection { error, share }
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
        let grads = tape.backward(m.error.sum());
        assert_eq!(grads.wrt(a).data(), [1.0, 0.0, 1.0, 0.0]);
        assert_eq!(grads.wrt(b).data(), [0.0, 1.0, 0.0, 0.0]);
    }
}
