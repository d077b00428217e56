//! How far a flow field is from a uniform shift and from an affine map.

use nalgebra::Vector2;

/// Mean of a flow field and what is left of the field without it, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uniformity {
    /// Mean flow: the uniform shift that fits best.
    pub mean: Vector2<f64>,
    /// Root of the mean squared distance from that shift.
    pub rms_deviation: f64,
}

/// Mean and deviation of a flow field; `None` for an empty one.
///
/// **Formula**: `m = E[f]`, `sqrt(E |f - m|^2)`.
#[must_use]
pub fn uniformity(flows: &[Vector2<f64>]) -> Option<Uniformity> {
    let count = flows.len() as f64;
    let mean = flows.iter().sum::<Vector2<f64>>() / count;
    let square = flows.iter().map(|f| (f - mean).norm_squared()).sum::<f64>() / count;
    (!flows.is_empty()).then(|| Uniformity { mean, rms_deviation: square.sqrt() })
}

/// Second difference of a field at three pixels of equal distance on a line, pixels; zero everywhere exactly for affine fields.
#[must_use]
pub fn second_difference(before: &Vector2<f64>, at: &Vector2<f64>, after: &Vector2<f64>) -> Vector2<f64> {
    before - at * 2.0 + after
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shift_is_uniform_and_two_shifts_are_not() {
        let (a, b) = (Vector2::new(3.0, 1.0), Vector2::new(3.0, 5.0));
        assert_eq!(uniformity(&[a, a]), Some(Uniformity { mean: a, rms_deviation: 0.0 }));
        assert_eq!(uniformity(&[a, b]), Some(Uniformity { mean: Vector2::new(3.0, 3.0), rms_deviation: 2.0 }));
        assert_eq!(uniformity(&[]), None);
    }

    #[test]
    fn a_parabola_bends_by_twice_the_squared_step() {
        let f = |u: f64| Vector2::new(u * u, 7.0 - 2.0 * u);
        assert_eq!(second_difference(&f(1.0), &f(4.0), &f(7.0)), Vector2::new(18.0, 0.0));
    }
}
