//! Registers with operators.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use pulp::Simd;

use super::SimdScalar;

/// One register of numbers, with operators: formulas over it read like formulas over one number.
#[derive(Clone, Copy)]
pub struct Wide<S: Simd, T: SimdScalar> {
    simd: S,
    reg: T::Reg<S>,
}

/// One truth value for every lane of a [`Wide`].
#[derive(Clone, Copy)]
pub struct Truths<S: Simd, T: SimdScalar> {
    simd: S,
    truth: T::Truth<S>,
}

impl<S: Simd, T: SimdScalar> Wide<S, T> {
    /// A register with operators.
    #[inline(always)]
    pub(crate) fn new(simd: S, reg: T::Reg<S>) -> Self {
        Self { simd, reg }
    }

    /// The register.
    #[inline(always)]
    pub(crate) fn reg(self) -> T::Reg<S> {
        self.reg
    }

    /// Numbers in a register.
    pub const fn lanes() -> usize {
        size_of::<T::Reg<S>>() / size_of::<T>()
    }

    /// The same number in every lane.
    #[inline(always)]
    pub fn splat(simd: S, x: T) -> Self {
        Self { simd, reg: T::splat(simd, x) }
    }

    /// The first numbers of a slice.
    ///
    /// # Panics
    /// When it is shorter than a register.
    #[inline(always)]
    pub fn load(simd: S, x: &[T]) -> Self {
        Self { simd, reg: T::load::<S>(x) }
    }

    /// All numbers of a slice shorter than a register, zeros behind.
    #[inline(always)]
    pub fn load_part(simd: S, x: &[T]) -> Self {
        Self { simd, reg: T::load_part(simd, x) }
    }

    /// Writes to the start of a slice.
    ///
    /// # Panics
    /// When it is shorter than a register.
    #[inline(always)]
    pub fn store(self, x: &mut [T]) {
        T::store::<S>(x, self.reg);
    }

    /// Fills a slice shorter than a register.
    #[inline(always)]
    pub fn store_part(self, x: &mut [T]) {
        T::store_part(self.simd, x, self.reg);
    }

    /// The same number in every lane, of the instruction set of `self`.
    #[inline(always)]
    pub fn like(self, x: T) -> Self {
        Self::splat(self.simd, x)
    }

    /// `self * a + b`, rounded once.
    #[inline(always)]
    pub fn mul_add(self, a: Self, b: Self) -> Self {
        Self { reg: T::fma(self.simd, self.reg, a.reg, b.reg), ..self }
    }

    /// Square root.
    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self { reg: T::root(self.simd, self.reg), ..self }
    }

    /// Absolute value.
    #[inline(always)]
    pub fn abs(self) -> Self {
        Self { reg: T::size(self.simd, self.reg), ..self }
    }

    /// Where `self < other`; nowhere that one is NaN.
    #[inline(always)]
    pub fn less(self, other: Self) -> Truths<S, T> {
        Truths { simd: self.simd, truth: T::less(self.simd, self.reg, other.reg) }
    }

    /// Where `self > other`; nowhere that one is NaN.
    #[inline(always)]
    pub fn greater(self, other: Self) -> Truths<S, T> {
        other.less(self)
    }

    /// Where `self <= other`; nowhere that one is NaN.
    #[inline(always)]
    pub fn at_most(self, other: Self) -> Truths<S, T> {
        Truths { simd: self.simd, truth: T::at_most(self.simd, self.reg, other.reg) }
    }

    /// Arc cosine of cosines in [-1, 1], radians: to rounding in `f64`, to 5e-7 in `f32`.
    #[inline(always)]
    pub fn arccos(self) -> Self {
        Self { reg: T::arccos(self.simd, self.reg), ..self }
    }

    /// The smaller one; `other` where one is NaN.
    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        self.less(other).choose(self, other)
    }

    /// The larger one; `other` where one is NaN.
    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        other.less(self).choose(self, other)
    }

    /// Takes numbers in groups of four, as many groups as a register has lanes, apart: the first of every group, the second, the
    /// third and the fourth. The order of the groups is that of the instruction set, the same in all four registers; groups that
    /// hold their number tell it.
    #[inline(always)]
    pub fn apart(simd: S, groups: &[[T; 4]]) -> [Self; 4] {
        let (flat, lanes) = (groups.as_flattened(), Self::lanes());
        let (a, b) = (T::load::<S>(flat), T::load::<S>(&flat[lanes..]));
        let (c, d) = (T::load::<S>(&flat[2 * lanes..]), T::load::<S>(&flat[3 * lanes..]));
        let [a, b, c, d] = T::apart(simd, [a, b, c, d]);
        [Self { simd, reg: a }, Self { simd, reg: b }, Self { simd, reg: c }, Self { simd, reg: d }]
    }

    /// Sum of all lanes.
    #[inline(always)]
    pub fn sum(self) -> T {
        T::reduce_sum(self.simd, self.reg)
    }
}

impl<S: Simd, T: SimdScalar> Truths<S, T> {
    /// `a` where it holds, `b` elsewhere; what the other one is there does not matter.
    #[inline(always)]
    pub fn choose(self, a: Wide<S, T>, b: Wide<S, T>) -> Wide<S, T> {
        Wide { simd: self.simd, reg: T::choose(self.simd, self.truth, a.reg, b.reg) }
    }
}

macro_rules! operator {
    ($operator:ident $method:ident $call:ident) => {
        impl<S: Simd, T: SimdScalar> $operator for Wide<S, T> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self { reg: T::$call(self.simd, self.reg, other.reg), ..self }
            }
        }
    };
}

operator!(Add add plus);
operator!(Sub sub minus);
operator!(Mul mul times);
operator!(Div div over);

impl<S: Simd, T: SimdScalar> Neg for Wide<S, T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { reg: T::opposite(self.simd, self.reg), ..self }
    }
}

impl<S: Simd, T: SimdScalar> BitAnd for Truths<S, T> {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self { truth: T::both(self.simd, self.truth, other.truth), ..self }
    }
}

impl<S: Simd, T: SimdScalar> BitOr for Truths<S, T> {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self { truth: T::either(self.simd, self.truth, other.truth), ..self }
    }
}

impl<S: Simd, T: SimdScalar> Not for Truths<S, T> {
    type Output = Self;
    #[inline(always)]
    fn not(self) -> Self {
        Self { truth: T::contrary(self.simd, self.truth), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scalar;
    use pulp::Scalar as OneLane;
    use pulp::{Arch, WithSimd};

    /// Every operation at once, on two slices of any length.
    struct All<'a, T> {
        a: &'a [T],
        b: &'a [T],
    }

    impl<T: Scalar> WithSimd for All<'_, T> {
        type Output = Vec<Vec<T>>;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Vec<Vec<T>> {
            let lanes = Wide::<S, T>::lanes();
            let mut out = vec![vec![T::ZERO; self.a.len()]; 13];
            for start in (0..self.a.len()).step_by(lanes) {
                let end = self.a.len().min(start + lanes);
                let whole = end - start == lanes;
                let read = |x: &[T]| match whole {
                    true => Wide::load(simd, &x[start..]),
                    false => Wide::load_part(simd, &x[start..end]),
                };
                let (a, b) = (read(self.a), read(self.b));
                let (yes, no) = (a.like(T::ONE), a.like(T::ZERO));
                let above = a.greater(no);
                let results = [
                    a + b,
                    a - b,
                    a * b,
                    a / b,
                    -a,
                    a.mul_add(b, a),
                    a.abs().sqrt(),
                    a.min(b),
                    a.max(b),
                    a.less(b).choose(yes, no),
                    a.at_most(b).choose(yes, no),
                    (above & b.greater(no)).choose(yes, no),
                    (!above | b.greater(no)).choose(yes, no),
                ];
                for (out, result) in out.iter_mut().zip(results) {
                    match whole {
                        true => result.store(&mut out[start..]),
                        false => result.store_part(&mut out[start..end]),
                    }
                }
            }
            out
        }
    }

    fn every_operation_equals_that_of_one_number<T: Scalar>() {
        let number = |i: usize, step: usize| T::from_f64((i * step % 23) as f64 / 4.0 - 2.75);
        let mut a: Vec<T> = (0..37).map(|i| number(i, 7)).collect();
        let b: Vec<T> = (0..37).map(|i| number(i, 5)).collect();
        a[11] = T::from_f64(f64::NAN);
        let truth = |x: bool| if x { T::ONE } else { T::ZERO };
        let expected = |a: T, b: T| {
            [
                a + b,
                a - b,
                a * b,
                a / b,
                -a,
                a.mul_add(b, a),
                a.abs().sqrt(),
                if a < b { a } else { b },
                if b < a { a } else { b },
                truth(a < b),
                truth(a <= b),
                truth(a > T::ZERO && b > T::ZERO),
                truth(a.is_nan() || a <= T::ZERO || b > T::ZERO),
            ]
        };
        let widest = Arch::new().dispatch(All { a: &a, b: &b });
        let narrowest = All { a: &a, b: &b }.with_simd(OneLane::new());
        for found in [widest, narrowest] {
            for i in 0..a.len() {
                for (k, want) in expected(a[i], b[i]).into_iter().enumerate() {
                    let got = found[k][i];
                    assert!(got == want || (got.is_nan() && want.is_nan()), "operation {k} of {} and {}: {got}", a[i], b[i]);
                }
            }
        }
    }

    /// Groups `(4 i, 4 i + 1, 4 i + 2, 4 i + 3)` taken apart.
    struct Apart<T>(std::marker::PhantomData<T>);

    impl<T: Scalar> WithSimd for Apart<T> {
        type Output = [Vec<T>; 4];
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> [Vec<T>; 4] {
            let lanes = Wide::<S, T>::lanes();
            let groups: Vec<[T; 4]> = (0..lanes).map(|i| std::array::from_fn(|k| T::from_usize(4 * i + k))).collect();
            Wide::apart(simd, &groups).map(|numbers| {
                let mut out = vec![T::ZERO; lanes];
                numbers.store(&mut out);
                out
            })
        }
    }

    fn groups_come_apart_in_one_order<T: Scalar>() {
        for found in [
            Arch::new().dispatch(Apart::<T>(std::marker::PhantomData)),
            Apart(std::marker::PhantomData).with_simd(OneLane::new()),
        ] {
            let mut firsts: Vec<usize> = found[0].iter().map(|x| x.to_f64() as usize).collect();
            for (k, numbers) in found.iter().enumerate() {
                assert!(numbers.iter().zip(&firsts).all(|(x, &first)| x.to_f64() as usize == first + k));
            }
            firsts.sort_unstable();
            assert!(firsts.iter().enumerate().all(|(i, &first)| first == 4 * i));
        }
    }

    #[test]
    fn groups_of_four_come_apart_in_one_order() {
        groups_come_apart_in_one_order::<f32>();
        groups_come_apart_in_one_order::<f64>();
    }

    #[test]
    fn every_operation_of_a_register_equals_that_of_one_number() {
        every_operation_equals_that_of_one_number::<f32>();
        every_operation_equals_that_of_one_number::<f64>();
    }
}
