//! What is proved: an operation, its twin, and the inputs to try.

use std::fmt::Debug;

use super::{Draw, Dual, Number, Plain, shapes};
use crate::{Scalar, Shape, Tensor, Var};

/// An operation with its attributes, written twice: on the tape and as a plain loop.
///
/// The `Debug` form tells the attributes in messages.
pub trait Twin: Debug + Send + Sync {
    /// The operation under proof.
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T>;

    /// The same function by its definition, without kernels and without tape.
    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N>;
}

/// A [`Twin`] behind a pointer, with its number types spelled out.
pub(crate) trait Subject: Debug + Send + Sync {
    fn double<'t>(&self, v: &[Var<'t, f64>]) -> Var<'t, f64>;
    fn single<'t>(&self, v: &[Var<'t, f32>]) -> Var<'t, f32>;
    fn value(&self, x: &[Plain<f64>]) -> Plain<f64>;
    fn tangent(&self, x: &[Plain<Dual>]) -> Plain<Dual>;
}

impl<W: Twin> Subject for W {
    fn double<'t>(&self, v: &[Var<'t, f64>]) -> Var<'t, f64> {
        self.tape(v)
    }

    fn single<'t>(&self, v: &[Var<'t, f32>]) -> Var<'t, f32> {
        self.tape(v)
    }

    fn value(&self, x: &[Plain<f64>]) -> Plain<f64> {
        self.plain(x)
    }

    fn tangent(&self, x: &[Plain<Dual>]) -> Plain<Dual> {
        self.plain(x)
    }
}

/// One set of inputs and attributes.
pub struct Case {
    pub(crate) subject: Box<dyn Subject>,
    pub(crate) inputs: Vec<Tensor<f64>>,
    pub(crate) moves: Vec<bool>,
}

impl Case {
    /// A case whose inputs are all differentiated. Keep them away from kinks.
    pub fn new(twin: impl Twin + 'static, inputs: impl Into<Vec<Tensor<f64>>>) -> Self {
        let inputs = inputs.into();
        Case { subject: Box::new(twin), moves: vec![true; inputs.len()], inputs }
    }

    /// The same without gradient to input `k`: a mask or an index, or a parent whose gradient is not wanted.
    pub fn constant(mut self, k: usize) -> Self {
        self.moves[k] = false;
        self
    }

    /// Attributes and shapes, for messages.
    pub fn label(&self) -> String {
        let shapes: Vec<Shape> = self.inputs.iter().map(Tensor::shape).collect();
        format!("{:?} of {shapes:?}", self.subject)
    }

    /// Whether the case is compared with differences, which cost four evaluations for each entry.
    pub fn is_small(&self) -> bool {
        self.entries() <= 400
    }

    /// Entries of the largest input that is differentiated.
    pub fn largest(&self) -> usize {
        self.inputs.iter().zip(&self.moves).filter(|(_, moves)| **moves).map(|(x, _)| x.shape().len()).max().unwrap_or(0)
    }

    /// Entries that are differentiated.
    pub(crate) fn entries(&self) -> usize {
        self.inputs.iter().zip(&self.moves).filter(|(_, moves)| **moves).map(|(x, _)| x.shape().len()).sum()
    }
}

/// An operation with all its cases.
pub struct Proof {
    pub(crate) op: &'static str,
    pub(crate) cases: Vec<Case>,
    pub(crate) single_bound: f64,
}

impl Proof {
    /// A proof of the operation with this name.
    pub fn new(op: &'static str, cases: impl IntoIterator<Item = Case>) -> Self {
        Proof { op, cases: cases.into_iter().collect(), single_bound: 1e-5 }
    }

    /// The proof of an elementwise operation with one operand, over all kinds of shapes with entries in `lo..hi`.
    pub fn unary<W: Twin + Copy + 'static>(op: &'static str, twin: W, [lo, hi]: [f64; 2], kinks: &[f64]) -> Self {
        let mut draw = Draw::new(op);
        let cases: Vec<Case> = shapes(&mut draw).into_iter().map(|s| Case::new(twin, [draw.away(s, lo, hi, kinks)])).collect();
        Proof::new(op, cases)
    }

    /// The proof of an elementwise operation with two operands; each operand alone is differentiated as well.
    pub fn binary<W: Twin + Copy + 'static>(
        op: &'static str,
        twin: W,
        mut inputs: impl FnMut(&mut Draw, Shape) -> [Tensor<f64>; 2],
    ) -> Self {
        let mut draw = Draw::new(op);
        let mut cases: Vec<Case> = shapes(&mut draw).into_iter().map(|s| Case::new(twin, inputs(&mut draw, s))).collect();
        for k in [0, 1] {
            let shape = draw.shape([3, 4, 5, 6]);
            cases.push(Case::new(twin, inputs(&mut draw, shape)).constant(k));
        }
        Proof::new(op, cases)
    }

    /// Joins the cases of another proof of the same operation.
    pub fn and(mut self, other: Proof) -> Self {
        self.cases.extend(other.cases);
        self
    }

    /// The bound on the relative error of `f32` against `f64`; 1e-5 unless set.
    pub fn single_bound(self, bound: f64) -> Self {
        Proof { single_bound: bound, ..self }
    }

    /// Name of the operation.
    pub fn op(&self) -> &'static str {
        self.op
    }

    /// The cases.
    pub fn cases(&self) -> &[Case] {
        &self.cases
    }
}
