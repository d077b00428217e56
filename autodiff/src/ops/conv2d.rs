//! Two-dimensional convolution (cross-correlation: the kernel is not flipped), strided, padded, dilated, grouped.
//!
//! `y[n, o, i, j] = b[o] + sum over c, u, v of w[o, c, u, v] x[n, g(o) + c, i s + u d - p, j s + v d - p]`
//!
//! vjp: `dx` scatters the same products, `dw[o, c, u, v] = sum over n, i, j of g x`, `db[o] = sum g`. Linear in input, weight
//! and bias. Keeps input and weight, each only when the other one needs its gradient.
//!
//! `conv/choice.rs` says which kernel for which shape. Units of work are cut by the shape alone, so bits do not depend on the
//! number of threads.

use super::conv::layout::Layout;
use super::conv::{After, backward_input, backward_weight, forward};
use super::{kernel, norm};
use crate::activation::{Activate, with_activation};
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin};
use crate::{Activation, Scalar, Shape, Var, par};

/// What lies outside the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PadMode {
    /// Zeros.
    Zero,
    /// The image mirrored without repeating the edge: index -1 reads 1.
    Reflect,
    /// The edge repeated: index -1 reads 0.
    Replicate,
}

/// Attributes of a convolution; each pair is (rows, columns).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv2d {
    /// Step between outputs.
    pub stride: (usize, usize),
    /// Rows and columns added on each side.
    pub padding: (usize, usize),
    /// Step between kernel taps.
    pub dilation: (usize, usize),
    /// Groups of channels that do not mix.
    pub groups: usize,
    /// What the added rows and columns hold.
    pub pad_mode: PadMode,
}

impl Default for Conv2d {
    fn default() -> Self {
        Conv2d { stride: (1, 1), padding: (0, 0), dilation: (1, 1), groups: 1, pad_mode: PadMode::Zero }
    }
}

impl Conv2d {
    /// Equal stride and padding in both directions, no dilation, one group, zero padding.
    pub fn new(stride: usize, padding: usize) -> Self {
        Conv2d { stride: (stride, stride), padding: (padding, padding), ..Self::default() }
    }

    /// The same with mirrored borders.
    pub fn reflect(self) -> Self {
        Conv2d { pad_mode: PadMode::Reflect, ..self }
    }

    /// The same with repeated borders.
    pub fn replicate(self) -> Self {
        Conv2d { pad_mode: PadMode::Replicate, ..self }
    }

    /// Shape of the output for an input and weights `[out, in / groups, kh, kw]`.
    ///
    /// # Panics
    /// When channels, groups or sizes do not fit.
    #[track_caller]
    pub fn output_shape(&self, input: Shape, weight: Shape) -> Shape {
        assert!(
            self.groups > 0 && input.c() == weight.c() * self.groups && weight.n().is_multiple_of(self.groups),
            "conv2d: input {input} and weight {weight} do not fit {} groups (input channels = weight channels x groups)",
            self.groups
        );
        assert!(
            self.stride.0 > 0 && self.stride.1 > 0 && self.dilation.0 > 0 && self.dilation.1 > 0,
            "conv2d: input {input} and weight {weight} with stride {:?} and dilation {:?}; the rule: positive",
            self.stride,
            self.dilation
        );
        if self.pad_mode == PadMode::Reflect {
            assert!(
                self.padding.0 < input.h() && self.padding.1 < input.w(),
                "conv2d: reflect padding {:?} must be smaller than the image {input}",
                self.padding
            );
        }
        let size = |len: usize, pad: usize, k: usize, stride: usize, dilation: usize| {
            let (len, reach) = (len + 2 * pad, dilation * (k - 1) + 1);
            assert!(len >= reach, "conv2d: kernel {weight} (reach {reach}) is larger than the padded input {input}");
            (len - reach) / stride + 1
        };
        Shape::new(
            input.n(),
            weight.n(),
            size(input.h(), self.padding.0, weight.h(), self.stride.0, self.dilation.0),
            size(input.w(), self.padding.1, weight.w(), self.stride.1, self.dilation.1),
        )
    }
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Convolution of `[n, c, h, w]` with weights `[out, c / groups, kh, kw]` and an optional bias `[1, out, 1, 1]`.
    ///
    /// # Panics
    /// When the shapes do not fit (see [`Conv2d::output_shape`]).
    #[track_caller]
    pub fn conv2d(self, weight: Var<'t, T>, bias: Option<Var<'t, T>>, conv: Conv2d) -> Var<'t, T> {
        record("conv2d", self, weight, bias, conv, Activation::Identity)
    }
}

/// Convolution and what follows it, as the operation `op`.
#[track_caller]
pub(crate) fn record<'t, T: Scalar>(
    op: &'static str,
    x: Var<'t, T>,
    weight: Var<'t, T>,
    bias: Option<Var<'t, T>>,
    conv: Conv2d,
    activation: Activation,
) -> Var<'t, T> {
    let parents: Vec<_> = [x, weight].into_iter().chain(bias).collect();
    let (tape, pool) = (x.tape(), x.tape().pool().clone());
    let (x, w) = (x.value(), weight.value());
    let shape = conv.output_shape(x.shape(), w.shape());
    if let Some(bias) = bias {
        let want = Shape::new(1, shape.c(), 1, 1);
        let (x, w) = (x.shape(), w.shape());
        assert!(bias.shape() == want, "{op}: input {x} and weight {w} need a bias {want}, got {}", bias.shape());
    }
    let layout = Layout::new(x.shape(), w.shape(), shape, &conv);
    let bias_value = bias.map(|b| b.value());
    let after = After { bias: bias_value.as_ref().map(|b| b.data()), activation };
    let y = tape.tensor(shape, forward(&layout, x.data(), w.data(), after, &pool));
    // Input and weight are only kept for each other's gradient, the output for the slope of the activation.
    let x = parents[1].requires_grad().then_some(x);
    let w = parents[0].requires_grad().then_some(w);
    let kept = (activation != Activation::Identity).then(|| y.clone());
    tape.push(op, y, &parents, move |g, grads| {
        let before = kept.as_ref().map(|y| {
            let mut before = grads.scratch(shape.len());
            with_activation!(activation, |a| kernel::zip(&mut before, y.data(), g.data(), |y, g| a.back(y, g)));
            before
        });
        let g = before.as_deref().unwrap_or(g.data());
        if let (Some(mut slot), Some(w)) = (grads.slot(0), &w) {
            slot.write(|dx| backward_input(&layout, g, w.data(), dx, &pool));
        }
        if let (Some(mut slot), Some(x)) = (grads.slot(1), &x) {
            backward_weight(&layout, x.data(), g, slot.as_mut_slice(), &pool);
        }
        if grads.len() == 3
            && let Some(mut slot) = grads.slot(2)
        {
            backward_bias(shape, g, slot.as_mut_slice());
        }
        if let Some(before) = before {
            grads.give_back(before);
        }
    })
}

fn backward_bias<T: Scalar>(shape: Shape, g: &[T], db: &mut [T]) {
    let plane = |n: usize, c: usize| &g[(n * shape.c() + c) * shape.plane()..][..shape.plane()];
    let sums = par::map_indices(shape.c(), |c| (0..shape.n()).map(|n| norm::sum(plane(n, c))).sum::<f64>());
    for (d, s) in db.iter_mut().zip(sums) {
        *d += T::from_f64(s);
    }
}

#[derive(Debug)]
struct Convolution(Conv2d);

impl Twin for Convolution {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].conv2d(v[1], v.get(2).copied(), self.0)
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let (conv, image, weight) = (self.0, &x[0], &x[1]);
        let [samples, _, height, width] = image.shape.0;
        let [outputs, channels, rows, columns] = weight.shape.0;
        // Position in the image, or none in a border of zeros.
        let place = |i: usize, len: usize, mode| -> Option<usize> {
            let (mut i, last) = (i as isize, len as isize - 1);
            if i < 0 || i > last {
                i = match mode {
                    PadMode::Zero => return None,
                    PadMode::Reflect if i < 0 => -i,
                    PadMode::Reflect => 2 * last - i,
                    PadMode::Replicate => i.clamp(0, last),
                };
            }
            Some(i as usize)
        };
        let reach = |len: usize, k: usize| len - (k - 1);
        let high = reach(height + 2 * conv.padding.0, conv.dilation.0 * (rows - 1) + 1).div_ceil(conv.stride.0);
        let wide = reach(width + 2 * conv.padding.1, conv.dilation.1 * (columns - 1) + 1).div_ceil(conv.stride.1);
        Plain::from_fn(Shape::new(samples, outputs, high, wide), |[n, o, i, j]| {
            let first = o / (outputs / conv.groups) * channels;
            let mut sum = x.get(2).map_or(N::zero(), |bias| bias.at([0, o, 0, 0]));
            for c in 0..channels {
                for u in 0..rows {
                    for v in 0..columns {
                        let h = (i * conv.stride.0 + u * conv.dilation.0).wrapping_sub(conv.padding.0);
                        let w = (j * conv.stride.1 + v * conv.dilation.1).wrapping_sub(conv.padding.1);
                        if let (Some(h), Some(w)) = (place(h, height, conv.pad_mode), place(w, width, conv.pad_mode)) {
                            sum = sum + weight.at([o, c, u, v]) * image.at([n, first + c, h, w]);
                        }
                    }
                }
            }
            sum
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("conv2d");
    let mut cases = Vec::new();
    let mut add = |conv: Conv2d, [n, c, h, w]: [usize; 4], [o, kh, kw]: [usize; 3], bias: bool| {
        let mut inputs = vec![
            draw.uniform(Shape::new(n, c * conv.groups, h, w), -1.0, 1.0),
            draw.uniform(Shape::new(o * conv.groups, c, kh, kw), -1.0, 1.0),
        ];
        inputs.extend(bias.then(|| draw.uniform(Shape::new(1, o * conv.groups, 1, 1), -1.0, 1.0)));
        cases.push(Case::new(Convolution(conv), inputs));
    };
    let plain = Conv2d::default();
    add(plain, [1, 1, 1, 1], [1, 1, 1], false);
    add(plain, [2, 3, 5, 4], [4, 1, 1], true);
    add(Conv2d { stride: (2, 3), ..plain }, [1, 2, 5, 7], [3, 1, 1], false);
    add(plain, [1, 2, 4, 6], [3, 2, 4], true);
    add(Conv2d { dilation: (2, 3), padding: (2, 3), ..plain }, [1, 2, 5, 4], [2, 3, 3], true);
    add(Conv2d { groups: 3, padding: (1, 1), ..plain }, [2, 1, 4, 3], [1, 3, 3], true);
    add(Conv2d { groups: 2, stride: (2, 1), padding: (0, 2), ..plain }, [1, 2, 5, 3], [3, 3, 5], false);
    for mode in [PadMode::Zero, PadMode::Reflect, PadMode::Replicate] {
        let conv = Conv2d { pad_mode: mode, ..plain };
        add(Conv2d { padding: (1, 1), ..conv }, [2, 3, 4, 5], [2, 3, 3], true);
        add(Conv2d { padding: (1, 1), stride: (2, 2), ..conv }, [1, 2, 7, 4], [3, 3, 3], false);
        add(Conv2d { padding: (3, 2), stride: (1, 2), dilation: (1, 2), ..conv }, [1, 2, 4, 5], [2, 2, 3], true);
        add(Conv2d { padding: (3, 3), stride: (2, 2), ..conv }, [1, 1, 9, 6], [9, 7, 7], false);
        add(Conv2d { padding: (0, 4), ..conv }, [1, 1, 1, 5], [2, 1, 9], true);
        add(Conv2d { padding: (1, 1), stride: (2, 1), dilation: (2, 1), groups: 2, ..conv }, [1, 2, 4, 3], [2, 2, 2], true);
    }
    for mode in [PadMode::Zero, PadMode::Replicate] {
        let conv = Conv2d { pad_mode: mode, padding: (4, 3), stride: (3, 2), ..plain };
        add(conv, [1, 2, 1, 2], [2, 3, 3], true);
    }
    // More outputs than one block of channels, and 2,000 entries.
    add(Conv2d::new(1, 1), [1, 5, 3, 3], [19, 3, 3], true);
    add(Conv2d::new(2, 1), [2, 3, 11, 31], [2, 3, 3], true);
    for (k, bias) in [(0, true), (1, true), (0, false), (2, true)] {
        let mut inputs = vec![draw.uniform(Shape::new(2, 2, 3, 4), -1.0, 1.0), draw.uniform(Shape::new(3, 2, 2, 3), -1.0, 1.0)];
        inputs.extend(bias.then(|| draw.uniform(Shape::new(1, 3, 1, 1), -1.0, 1.0)));
        cases.push(Case::new(Convolution(Conv2d { padding: (1, 0), ..plain }), inputs).constant(k));
    }
    Proof::new("conv2d", cases)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tensor;
    use crate::gradcheck::{random, weighted_sum};
    use crate::ops::testing::close;
    use crate::{GradCheck, Tape, gradcheck};

    /// The definition, written as plain loops.
    fn reference(x: &Tensor<f64>, w: &Tensor<f64>, b: Option<&Tensor<f64>>, conv: &Conv2d) -> Tensor<f64> {
        let shape = conv.output_shape(x.shape(), w.shape());
        let outputs = w.shape().n() / conv.groups;
        let index = |i: isize, len: usize| -> Option<usize> {
            let last = len as isize - 1;
            match conv.pad_mode {
                _ if (0..=last).contains(&i) => Some(i as usize),
                PadMode::Zero => None,
                PadMode::Reflect => Some(if i < 0 { -i } else { 2 * last - i } as usize),
                PadMode::Replicate => Some(i.clamp(0, last) as usize),
            }
        };
        Tensor::from_fn(shape, |n, o, i, j| {
            let mut sum = b.map_or(0.0, |b| b.data()[o]);
            for c in 0..w.shape().c() {
                for u in 0..w.shape().h() {
                    for v in 0..w.shape().w() {
                        let y = (i * conv.stride.0 + u * conv.dilation.0) as isize - conv.padding.0 as isize;
                        let z = (j * conv.stride.1 + v * conv.dilation.1) as isize - conv.padding.1 as isize;
                        if let (Some(y), Some(z)) = (index(y, x.shape().h()), index(z, x.shape().w())) {
                            sum += w.at(o, c, u, v) * x.at(n, o / outputs * w.shape().c() + c, y, z);
                        }
                    }
                }
            }
            sum
        })
    }

    /// Input, weight and attributes of assorted convolutions.
    fn cases() -> Vec<(Shape, Shape, Conv2d)> {
        let c = |stride, padding, dilation, groups, pad_mode| Conv2d { stride, padding, dilation, groups, pad_mode };
        use PadMode::{Reflect, Replicate, Zero};
        vec![
            (Shape::new(1, 1, 1, 1), Shape::new(1, 1, 1, 1), Conv2d::default()),
            (Shape::new(2, 3, 5, 7), Shape::new(4, 3, 3, 3), Conv2d::new(1, 1)),
            (Shape::new(1, 2, 6, 9), Shape::new(9, 2, 3, 3), Conv2d::new(2, 1)),
            (Shape::new(2, 3, 8, 10), Shape::new(11, 3, 7, 7), Conv2d::new(2, 3)),
            (Shape::new(1, 5, 4, 3), Shape::new(3, 5, 1, 1), Conv2d::new(2, 0)),
            (Shape::new(2, 4, 5, 6), Shape::new(6, 2, 3, 3), c((1, 1), (1, 1), (1, 1), 2, Zero)),
            (Shape::new(1, 3, 7, 9), Shape::new(3, 1, 3, 3), c((1, 1), (2, 2), (2, 2), 3, Zero)),
            (Shape::new(1, 2, 4, 5), Shape::new(3, 2, 3, 3), Conv2d::new(1, 1).reflect()),
            (Shape::new(2, 2, 5, 4), Shape::new(2, 2, 3, 3), c((2, 1), (1, 1), (1, 1), 1, Replicate)),
            (Shape::new(1, 2, 5, 6), Shape::new(2, 2, 1, 5), c((1, 1), (0, 2), (1, 1), 1, Zero)),
            (Shape::new(1, 2, 9, 8), Shape::new(2, 2, 3, 2), c((3, 2), (2, 1), (2, 3), 1, Reflect)),
            (Shape::new(1, 1, 1, 9), Shape::new(1, 1, 1, 3), c((1, 1), (0, 1), (1, 1), 1, Zero)),
            (Shape::new(2, 2, 3, 6), Shape::new(17, 2, 3, 3), Conv2d::new(1, 1)),
            (Shape::new(1, 4, 4, 5), Shape::new(12, 2, 1, 2), c((1, 1), (0, 1), (1, 1), 2, Reflect)),
            (Shape::new(1, 1, 2, 11), Shape::new(5, 1, 1, 4), c((1, 3), (0, 2), (1, 1), 1, Replicate)),
            (Shape::new(2, 2, 2, 3), Shape::new(2, 2, 3, 3), c((1, 2), (3, 4), (1, 1), 1, Replicate)),
            (Shape::new(1, 4, 6, 5), Shape::new(4, 1, 3, 3), c((2, 1), (2, 2), (2, 2), 4, Replicate)),
            (Shape::new(1, 3, 1, 1), Shape::new(2, 3, 3, 3), Conv2d::new(1, 1).replicate()),
        ]
    }

    #[test]
    fn values_equal_the_definition() {
        for (i, (xs, ws, conv)) in cases().into_iter().enumerate() {
            let (x, w) = (random::<f64>(1 + i as u64, xs, -1.0, 1.0), random::<f64>(50 + i as u64, ws, -1.0, 1.0));
            let b = random::<f64>(90, Shape::new(1, ws.n(), 1, 1), -1.0, 1.0);
            let tape = Tape::new();
            let y = tape.constant(x.clone()).conv2d(tape.constant(w.clone()), Some(tape.constant(b.clone())), conv).value();
            let want = reference(&x, &w, Some(&b), &conv);
            assert_eq!(y.shape(), want.shape());
            for (a, b) in y.data().iter().zip(want.data()) {
                assert!((a - b).abs() < 1e-12, "case {i}: {a} against {b}");
            }
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for (i, (xs, ws, conv)) in cases().into_iter().enumerate() {
            let x = random(1 + i as u64, xs, -1.0, 1.0);
            let w = random(50 + i as u64, ws, -1.0, 1.0);
            let b = random(90, Shape::new(1, ws.n(), 1, 1), -1.0, 1.0);
            let report = gradcheck(&[x, w, b], |_, v| weighted_sum(v[0].conv2d(v[1], Some(v[2]), conv), 3), GradCheck::default());
            assert!(report.is_ok(), "case {i}: {report}");
        }
    }

    /// Registers of `f32` hold more channels than those of `f64`, and large images are cut into tiles.
    #[test]
    fn gradients_in_single_precision_are_those_in_double_precision() {
        let shapes =
            [([2, 5, 70, 90], [18, 5, 7, 7], 2, 3), ([3, 7, 4, 6], [33, 7, 3, 3], 1, 1), ([2, 6, 9, 9], [3, 6, 3, 3], 1, 1)];
        fn gradients<T: Scalar>(x: &Tensor<f64>, w: &Tensor<f64>, conv: Conv2d) -> [Tensor<f64>; 2] {
            let tape = Tape::<T>::new();
            let (x, w) = (tape.leaf(x.cast()), tape.leaf(w.cast()));
            let grads = tape.backward(weighted_sum(x.conv2d(w, None, conv), 4));
            [grads.wrt(x).cast(), grads.wrt(w).cast()]
        }
        for (xs, ws, stride, padding) in shapes {
            let (x, w) = (random::<f32>(1, Shape(xs), -1.0, 1.0).cast(), random::<f32>(2, Shape(ws), -1.0, 1.0).cast());
            let conv = Conv2d::new(stride, padding);
            let (single, double) = (gradients::<f32>(&x, &w, conv), gradients::<f64>(&x, &w, conv));
            for (single, double) in single.iter().zip(&double) {
                let size = double.data().iter().fold(0.0f64, |m, g| m.max(g.abs()));
                for (a, b) in single.data().iter().zip(double.data()) {
                    assert!((a - b).abs() < 1e-5 * size, "{ws:?}: {a} against {b}");
                }
            }
        }
    }

    #[test]
    fn padded_borders_equal_a_padding_before_the_convolution() {
        let tape = Tape::new();
        let x = tape.constant(random::<f64>(1, Shape::new(2, 3, 5, 7), -1.0, 1.0));
        let w = tape.constant(random(2, Shape::new(4, 3, 3, 3), -1.0, 1.0));
        let inside = |conv: Conv2d| x.conv2d(w, None, conv).value();
        let before = |padded: Var<'_, f64>| padded.conv2d(w, None, Conv2d::new(2, 0)).value();
        close(inside(Conv2d::new(2, 2)).data(), before(x.pad_zero(2)).data());
        close(inside(Conv2d::new(2, 2).reflect()).data(), before(x.pad_reflect(2)).data());
        close(inside(Conv2d::new(2, 2).replicate()).data(), before(x.pad_replicate(2)).data());
    }

    #[test]
    fn bits_do_not_depend_on_the_number_of_threads() {
        let x = random::<f32>(1, Shape::new(3, 16, 33, 47), -1.0, 1.0);
        let w = random::<f32>(2, Shape::new(20, 16, 3, 3), -1.0, 1.0);
        let run = |threads| {
            par::with_threads(threads, || {
                let tape = Tape::new();
                let (x, w) = (tape.leaf(x.clone()), tape.leaf(w.clone()));
                let y = x.conv2d(w, None, Conv2d::new(2, 1));
                let grads = tape.backward(weighted_sum(y, 4));
                (y.value(), grads.wrt(x), grads.wrt(w))
            })
        };
        let one = run(1);
        for threads in [2, 3, 4] {
            assert!(run(threads) == one, "{threads} threads");
        }
    }

    #[test]
    #[should_panic(expected = "do not fit 1 groups")]
    fn rejects_wrong_channels() {
        let tape = Tape::<f32>::new();
        let x = tape.constant(Tensor::zeros(Shape::new(1, 3, 4, 4)));
        x.conv2d(tape.constant(Tensor::zeros(Shape::new(2, 4, 3, 3))), None, Conv2d::new(1, 1));
    }

    #[test]
    #[should_panic(expected = "reflect padding (2, 2) must be smaller than the image")]
    fn rejects_reflection_beyond_the_image() {
        Conv2d::new(1, 2).reflect().output_shape(Shape::new(1, 1, 2, 5), Shape::new(1, 1, 3, 3));
    }
}
