//! How far two tensors are apart.

use super::StoredTensor;

/// How far the values of two tensors of equal dimensions are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Largest |a - b|.
    pub largest: f64,
    /// L2 norm of a - b over the larger L2 norm of the two; 0 when both are all zero.
    pub relative: f64,
}

/// How far two tensors are apart; `None` when their dimensions differ. Where both hold the same infinity or both no number they are
/// equal, where one is not finite they are infinitely far apart.
pub fn difference(a: &StoredTensor, b: &StoredTensor) -> Option<Difference> {
    if a.dims != b.dims {
        return None;
    }
    let (mut largest, mut apart, mut sizes) = (0f64, 0f64, [0f64; 2]);
    for (&a, &b) in a.values.iter().zip(&b.values) {
        let equal = a == b || a.is_nan() && b.is_nan();
        let between = if equal { 0.0 } else { (a - b).abs() };
        let between = if between.is_nan() { f64::INFINITY } else { between };
        largest = largest.max(between);
        apart += between * between;
        for (size, value) in sizes.iter_mut().zip([a, b]) {
            *size += if value.is_finite() { value * value } else { 0.0 };
        }
    }
    let size = sizes[0].max(sizes[1]).sqrt();
    let relative = if apart == 0.0 { 0.0 } else { apart.sqrt() / size };
    // Squares of huge values overflow.
    let relative = if relative.is_nan() { f64::INFINITY } else { relative };
    Some(Difference { largest, relative })
}

#[cfg(test)]
mod tests {
    use super::super::ElementType;
    use super::*;

    fn tensor(values: &[f64]) -> StoredTensor {
        StoredTensor { name: "x".into(), element: ElementType::F64, dims: vec![values.len()], values: values.to_vec() }
    }

    fn between(a: &[f64], b: &[f64]) -> Option<Difference> {
        difference(&tensor(a), &tensor(b))
    }

    #[test]
    fn worked_numbers() {
        let found = between(&[3.0, 4.0, 0.0], &[3.0, 1.0, 4.0]).unwrap();
        assert_eq!((found.largest, found.relative), (4.0, 5.0 / 26f64.sqrt()));
        assert_eq!(between(&[0.0, 0.0], &[0.0, -0.0]).unwrap(), Difference { largest: 0.0, relative: 0.0 });
        assert_eq!(between(&[1.0], &[1.0, 2.0]), None);
    }

    #[test]
    fn values_that_are_not_finite_are_equal_to_themselves_alone() {
        let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.0];
        assert_eq!(between(&odd, &odd).unwrap().largest, 0.0);
        for i in 0..3 {
            let mut other = odd;
            other[i] = 0.0;
            let found = between(&odd, &other).unwrap();
            assert_eq!((found.largest, found.relative), (f64::INFINITY, f64::INFINITY), "{i}");
        }
    }
}
