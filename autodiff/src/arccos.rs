//! Arc cosine of the cosines in a register.

use pulp::Simd;

use crate::simd::Wide;

/// Coefficients of `arccos(x) / sqrt(1 - x)` for `0 <= x <= 1`, constant first; error of the angle below 2e-8
/// [Abramowitz and Stegun, Handbook of Mathematical Functions, 4.4.46].
const COEFFICIENTS: [f32; 8] = [
    std::f32::consts::FRAC_PI_2,
    -0.214_598_8,
    0.088_978_99,
    -0.050_174_305,
    0.030_891_88,
    -0.017_088_126,
    0.006_670_09,
    -0.001_262_491_1,
];

/// The polynomial, with `arccos(-x) = pi - arccos(x)`.
#[inline(always)]
pub(crate) fn single<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    let x = Wide::<S, f32>::new(simd, x);
    let zero = x.like(0.0);
    let size = x.abs();
    let mut p = x.like(COEFFICIENTS[7]);
    for &c in COEFFICIENTS[..7].iter().rev() {
        p = p.mul_add(size, x.like(c));
    }
    // The roots of cosines that rounding took beyond 1 are those of 1.
    let angle = p * (x.like(1.0) - size).max(zero).sqrt();
    x.less(zero).choose(x.like(std::f32::consts::PI) - angle, angle).reg()
}

/// The library's function, number by number.
#[inline(always)]
pub(crate) fn double<S: Simd>(_: S, x: S::f64s) -> S::f64s {
    let mut one_by_one = [0.0; 16];
    let lanes = &mut one_by_one[..S::F64_LANES];
    S::as_mut_simd_f64s(lanes).0[0] = x;
    lanes.iter_mut().for_each(|x| *x = x.acos());
    S::as_simd_f64s(lanes).0[0]
}

#[cfg(test)]
mod tests {
    use crate::Scalar;
    use crate::simd::{Arch, Simd, Wide, WithSimd};

    struct All<'a, T>(&'a [T]);

    impl<T: Scalar> WithSimd for All<'_, T> {
        type Output = Vec<T>;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Vec<T> {
            let mut out = self.0.to_vec();
            for part in out.chunks_mut(Wide::<S, T>::lanes()) {
                Wide::load_part(simd, part).arccos().store_part(part);
            }
            out
        }
    }

    fn worst<T: Scalar>() -> f64 {
        let cosines: Vec<T> = (0..=20_001).map(|i| T::from_f64((f64::from(i) / 10_000.5 - 1.0).clamp(-1.0, 1.0))).collect();
        let angles = Arch::new().dispatch(All(&cosines));
        cosines.iter().zip(angles).map(|(c, angle)| (c.to_f64().acos() - angle.to_f64()).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn angles_are_right_to_rounding_in_both_types() {
        assert!(worst::<f32>() < 5e-7, "{}", worst::<f32>());
        assert!(worst::<f64>() < 1e-15, "{}", worst::<f64>());
    }
}
