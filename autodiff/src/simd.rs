//! Vector registers of either number type, so that a kernel is written once and compiled for every instruction set.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

pub use pulp::{Arch, Simd, WithSimd};

use crate::arccos;

/// Vector arithmetic on an element type under an instruction set `S`; [`Wide`] has the operators for it.
pub trait SimdScalar: Copy {
    /// One register.
    type Reg<S: Simd>: Copy;
    /// A truth value for every lane.
    type Truth<S: Simd>: Copy;
    /// Elements in a register.
    fn lanes<S: Simd>() -> usize;
    /// The same value in every lane.
    fn splat<S: Simd>(simd: S, x: Self) -> Self::Reg<S>;
    /// The first lanes of a slice, which must be at least one register long.
    fn load<S: Simd>(x: &[Self]) -> Self::Reg<S>;
    /// As many whole registers as the slice has.
    fn registers<S: Simd>(x: &[Self]) -> &[Self::Reg<S>];
    /// Writes a register to the start of a slice, which must be at least one register long.
    fn store<S: Simd>(x: &mut [Self], v: Self::Reg<S>);
    /// As many lanes as the slice has elements, zeros behind; the slice may be shorter than a register.
    fn load_part<S: Simd>(simd: S, x: &[Self]) -> Self::Reg<S>;
    /// Writes as many lanes as the slice has elements; it may be shorter than a register.
    fn store_part<S: Simd>(simd: S, x: &mut [Self], v: Self::Reg<S>);
    /// `a * b + c`, rounded once.
    fn fma<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>, c: Self::Reg<S>) -> Self::Reg<S>;
    /// Sum of all lanes.
    fn reduce_sum<S: Simd>(simd: S, a: Self::Reg<S>) -> Self;
    /// `a + b`.
    fn plus<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// `a - b`.
    fn minus<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// `a b`.
    fn times<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// `a / b`.
    fn over<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// Square root.
    fn root<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// Absolute value.
    fn size<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// `-a`.
    fn opposite<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// `a < b`; false where one is NaN.
    fn less<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Truth<S>;
    /// `a <= b`; false where one is NaN.
    fn at_most<S: Simd>(simd: S, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Truth<S>;
    /// Arc cosine of cosines in [-1, 1], radians: to rounding in `f64`, to 5e-7 in `f32`.
    fn arccos<S: Simd>(simd: S, a: Self::Reg<S>) -> Self::Reg<S>;
    /// `a` where `truth` holds, `b` elsewhere.
    fn choose<S: Simd>(simd: S, truth: Self::Truth<S>, a: Self::Reg<S>, b: Self::Reg<S>) -> Self::Reg<S>;
    /// Where both hold.
    fn both<S: Simd>(simd: S, a: Self::Truth<S>, b: Self::Truth<S>) -> Self::Truth<S>;
    /// Where one holds.
    fn either<S: Simd>(simd: S, a: Self::Truth<S>, b: Self::Truth<S>) -> Self::Truth<S>;
    /// Takes numbers in groups of four apart: the first of every group, the second, and so on. The order of the groups is that of
    /// the instruction set, the same in all four.
    fn apart<S: Simd>(simd: S, a: [Self::Reg<S>; 4]) -> [Self::Reg<S>; 4];
    /// Where it does not hold.
    fn contrary<S: Simd>(simd: S, a: Self::Truth<S>) -> Self::Truth<S>;
}

macro_rules! simd_scalar {
    (
        $t:ident, $reg:ident, $truth:ident, $lanes:ident, $splat:ident, $as:ident, $as_mut:ident, $part:ident, $part_store:ident;
        [$($name:ident = $call:ident($($x:ident),*);)*]
        [$($truth_name:ident = $truth_call:ident($($y:ident),*);)*]
        $less:ident, $at_most:ident, $select:ident, $reduce:ident, $apart:ident, $arccos:path
    ) => {
        impl SimdScalar for $t {
            type Reg<S: Simd> = S::$reg;
            type Truth<S: Simd> = S::$truth;
            #[inline(always)]
            fn lanes<S: Simd>() -> usize {
                S::$lanes
            }
            #[inline(always)]
            fn splat<S: Simd>(simd: S, x: Self) -> S::$reg {
                simd.$splat(x)
            }
            #[inline(always)]
            fn load<S: Simd>(x: &[Self]) -> S::$reg {
                S::$as(&x[..S::$lanes]).0[0]
            }
            #[inline(always)]
            fn registers<S: Simd>(x: &[Self]) -> &[S::$reg] {
                S::$as(x).0
            }
            #[inline(always)]
            fn store<S: Simd>(x: &mut [Self], v: S::$reg) {
                S::$as_mut(&mut x[..S::$lanes]).0[0] = v;
            }
            #[inline(always)]
            fn load_part<S: Simd>(simd: S, x: &[Self]) -> S::$reg {
                simd.$part(x)
            }
            #[inline(always)]
            fn store_part<S: Simd>(simd: S, x: &mut [Self], v: S::$reg) {
                simd.$part_store(x, v);
            }
            $(
                #[inline(always)]
                fn $name<S: Simd>(simd: S, $($x: S::$reg),*) -> S::$reg {
                    simd.$call($($x),*)
                }
            )*
            $(
                #[inline(always)]
                fn $truth_name<S: Simd>(simd: S, $($y: S::$truth),*) -> S::$truth {
                    simd.$truth_call($($y),*)
                }
            )*
            #[inline(always)]
            fn less<S: Simd>(simd: S, a: S::$reg, b: S::$reg) -> S::$truth {
                simd.$less(a, b)
            }
            #[inline(always)]
            fn at_most<S: Simd>(simd: S, a: S::$reg, b: S::$reg) -> S::$truth {
                simd.$at_most(a, b)
            }
            #[inline(always)]
            fn arccos<S: Simd>(simd: S, a: S::$reg) -> S::$reg {
                $arccos(simd, a)
            }
            #[inline(always)]
            fn choose<S: Simd>(simd: S, truth: S::$truth, a: S::$reg, b: S::$reg) -> S::$reg {
                simd.$select(truth, a, b)
            }
            #[inline(always)]
            fn apart<S: Simd>(simd: S, a: [S::$reg; 4]) -> [S::$reg; 4] {
                simd.$apart(a)
            }
            #[inline(always)]
            fn reduce_sum<S: Simd>(simd: S, a: S::$reg) -> Self {
                simd.$reduce(a)
            }
        }
    };
}

simd_scalar!(
    f32, f32s, m32s, F32_LANES, splat_f32s, as_simd_f32s, as_mut_simd_f32s, partial_load_f32s, partial_store_f32s;
    [fma = mul_add_e_f32s(a, b, c);
    plus = add_f32s(a, b);
    minus = sub_f32s(a, b);
    times = mul_f32s(a, b);
    over = div_f32s(a, b);
    root = sqrt_f32s(a);
    size = abs_f32s(a);
    opposite = neg_f32s(a);]
    [both = and_m32s(a, b);
    either = or_m32s(a, b);
    contrary = not_m32s(a);]
    less_than_f32s, less_than_or_equal_f32s, select_f32s, reduce_sum_f32s, deinterleave_shfl_f32s, arccos::single
);
simd_scalar!(
    f64, f64s, m64s, F64_LANES, splat_f64s, as_simd_f64s, as_mut_simd_f64s, partial_load_f64s, partial_store_f64s;
    [fma = mul_add_e_f64s(a, b, c);
    plus = add_f64s(a, b);
    minus = sub_f64s(a, b);
    times = mul_f64s(a, b);
    over = div_f64s(a, b);
    root = sqrt_f64s(a);
    size = abs_f64s(a);
    opposite = neg_f64s(a);]
    [both = and_m64s(a, b);
    either = or_m64s(a, b);
    contrary = not_m64s(a);]
    less_than_f64s, less_than_or_equal_f64s, select_f64s, reduce_sum_f64s, deinterleave_shfl_f64s, arccos::double
);

/// Repeats a block with a constant that takes each of the values: loops over registers must be written out before the compiler
/// keeps what they index in registers.
macro_rules! unroll {
    ($k:ident in $($value:literal)* => $body:block) => {$({
        const $k: usize = $value;
        $body
    })*};
}
pub(crate) use unroll;

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
