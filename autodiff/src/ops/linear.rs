//! Linear layer on the last axis: `y[.., o] = Σ x[.., i] w[o, i] + b[o]`.
//!
//! Vector-Jacobian products: `gx = g w`, `gw = gᵀ x` and `gb = Σ g` over all rows. Linear in input, weight and bias. Keeps input and
//! weight, each only when the other one needs its gradient.
//!
//! Rows are cut into blocks of fixed size; the contributions of the blocks to `gw` are added in their order.

use super::reduce::reduce;
use crate::gemm::View;
use crate::proof::{Case, Draw, Number, Plain, Proof, Twin, total};
use crate::{Scalar, Shape, Tensor, Var, par};

/// Rows of one unit of work.
const ROWS: usize = 512;

/// Block `i` of the rows of a matrix with `cols` columns.
fn block<T>(data: &[T], i: usize, cols: usize) -> View<'_, T> {
    let rest = &data[i * ROWS * cols..];
    let rows = ROWS.min(rest.len() / cols);
    View::new(&rest[..rows * cols], rows, cols)
}

fn forward<T: Scalar>(x: &[T], weight: View<'_, T>, bias: Option<&[T]>, y: &mut [T]) {
    par::for_each_chunk(y, ROWS * weight.rows, |i, y| {
        if let Some(bias) = bias {
            y.chunks_exact_mut(bias.len()).for_each(|row| row.copy_from_slice(bias));
        }
        T::gemm(y, block(x, i, weight.cols), weight.t(), bias.is_some());
    });
}

fn backward_input<T: Scalar>(grad_y: &[T], weight: View<'_, T>, grad_x: &mut [T]) {
    par::for_each_chunk(grad_x, ROWS * weight.cols, |i, grad_x| {
        T::gemm(grad_x, block(grad_y, i, weight.rows), weight, false);
    });
}

/// Adds to the gradient of the `outputs` x `inputs` weights.
fn backward_weight<T: Scalar>(x: &[T], grad_y: &[T], grad_w: &mut [T], [outputs, inputs]: [usize; 2]) {
    let blocks = (x.len() / inputs).div_ceil(ROWS);
    let parts = par::map_indices(blocks, |i| {
        let mut part = vec![T::ZERO; outputs * inputs];
        T::gemm(&mut part, block(grad_y, i, outputs).t(), block(x, i, inputs), false);
        part
    });
    for part in parts {
        grad_w.iter_mut().zip(part).for_each(|(w, part)| *w += part);
    }
}

/// Writes the gradient of the bias.
fn backward_bias<T: Scalar>(grad_y: &Tensor<T>, grad_b: &mut [T]) {
    let outputs = grad_y.shape().w();
    reduce(grad_y.data(), grad_y.shape(), grad_b, Shape::new(1, 1, 1, outputs), 1.0);
}

impl<'t, T: Scalar> Var<'t, T> {
    /// Linear map of the last axis, the same for all rows.
    ///
    /// **Shapes**: `[n, c, h, inputs]` to `[n, c, h, outputs]`; `weight` `[1, 1, outputs, inputs]`, `bias` `[1, outputs, 1, 1]`, as
    /// matrices and vectors are stored in weight files.
    ///
    /// **Gradient**: `g w` to the input, `gᵀ x` to the weight, the sum of `g` over the rows to the bias.
    ///
    /// **Panics** when the shapes do not fit. Equals PyTorch's `linear`.
    #[track_caller]
    pub fn linear(self, weight: Var<'t, T>, bias: Option<Var<'t, T>>) -> Var<'t, T> {
        let (x, w) = (self.value(), weight.value());
        let (input, [_, _, outputs, inputs]) = (x.shape(), w.shape().0);
        assert!(
            w.shape().planes() == 1 && inputs == input.w(),
            "linear: input {input} and weight {}; the rule: [n, c, h, inputs] and [1, 1, outputs, inputs]",
            w.shape()
        );
        if let Some(bias) = bias {
            let wanted = Shape::new(1, outputs, 1, 1);
            assert!(bias.shape() == wanted, "linear: weight {} needs a bias of shape {wanted}, got {}", w.shape(), bias.shape());
        }
        let shape = input.with_axis(3, outputs);
        let mut y = self.tape().scratch(shape.len());
        let bias_value = bias.map(|b| b.value());
        forward(x.data(), View::new(w.data(), outputs, inputs), bias_value.as_ref().map(|b| b.data()), &mut y);
        let y = self.tape().tensor(shape, y);
        let x = weight.requires_grad().then_some(x);
        let w = self.requires_grad().then_some(w);
        let parents: Vec<_> = [self, weight].into_iter().chain(bias).collect();
        self.tape().push("linear", y, &parents, move |g, grads| {
            if let (Some(mut slot), Some(w)) = (grads.slot(0), &w) {
                slot.write(|out| backward_input(g.data(), View::new(w.data(), outputs, inputs), out));
            }
            if let (Some(mut slot), Some(x)) = (grads.slot(1), &x) {
                backward_weight(x.data(), g.data(), slot.as_mut_slice(), [outputs, inputs]);
            }
            if grads.len() == 3
                && let Some(mut slot) = grads.slot(2)
            {
                slot.write(|out| backward_bias(g, out));
            }
        })
    }
}

#[derive(Clone, Copy, Debug)]
struct Linear;

impl Twin for Linear {
    fn tape<'t, T: Scalar>(&self, v: &[Var<'t, T>]) -> Var<'t, T> {
        v[0].linear(v[1], v.get(2).copied())
    }

    fn plain<N: Number>(&self, x: &[Plain<N>]) -> Plain<N> {
        let [outputs, inputs] = [x[1].shape.h(), x[1].shape.w()];
        Plain::from_fn(x[0].shape.with_axis(3, outputs), |[n, c, h, o]| {
            let products = total((0..inputs).map(|i| x[0].at([n, c, h, i]) * x[1].at([0, 0, o, i])));
            x.get(2).map_or(products, |bias| products + bias.at([0, o, 0, 0]))
        })
    }
}

pub(crate) fn proof() -> Proof {
    let mut draw = Draw::new("linear");
    let mut cases = Vec::new();
    for (i, (shape, outputs)) in [
        ([1, 1, 1, 1], 1),
        ([2, 3, 4, 5], 3),
        ([1, 1, 7, 2], 9),
        ([3, 1, 1, 6], 4),
        ([1, 2, 5, 1], 3),
        ([2, 1, 3, 17], 5),
        ([2, 2, 3, 4], 3),
        ([1, 1, 1, 40], 7),
        // Several units of rows.
        ([2, 5, 67, 2], 3),
        ([1, 1, 1002, 2], 2),
    ]
    .into_iter()
    .enumerate()
    {
        for bias in [false, true] {
            let (shape, weight) = (Shape(shape), Shape::new(1, 1, outputs, shape[3]));
            let mut inputs = vec![draw.uniform(shape, -1.0, 1.0), draw.uniform(weight, -1.0, 1.0)];
            inputs.extend(bias.then(|| draw.uniform(Shape::new(1, outputs, 1, 1), -1.0, 1.0)));
            let case = Case::new(Linear, inputs);
            cases.push(if i == 6 { case.constant(usize::from(bias)) } else { case });
        }
    }
    Proof::new("linear", cases)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::ROWS;
    use crate::ops::planes::testing::{noise, tensor};
    use crate::ops::testing::{self, close, random};
    use crate::{MatMul, Shape, Tape};

    #[test]
    fn worked_numbers() {
        let tape = Tape::new();
        let x = tape.leaf(tensor([1, 1, 2, 2], &[1.0, 2.0, 3.0, 4.0]));
        let weight = tape.leaf(tensor([1, 1, 3, 2], &[1.0, 0.0, 0.0, 1.0, 2.0, -1.0]));
        let bias = tape.leaf(tensor([1, 3, 1, 1], &[10.0, 20.0, 30.0]));
        let y = x.linear(weight, Some(bias));
        close(y.value().data(), &[11.0, 22.0, 30.0, 13.0, 24.0, 32.0]);
        close(x.linear(weight, None).value().data(), &[1.0, 2.0, 0.0, 3.0, 4.0, 2.0]);
        let g = tape.constant(tensor([1, 1, 2, 3], &[1.0, 0.0, 2.0, 0.0, 1.0, 0.0]));
        let grads = tape.backward(y.mul(g).sum());
        close(grads.wrt(x).data(), &[5.0, -2.0, 0.0, 1.0]);
        close(grads.wrt(weight).data(), &[1.0, 2.0, 3.0, 4.0, 2.0, 4.0]);
        close(grads.wrt(bias).data(), &[1.0, 1.0, 2.0]);
    }

    #[test]
    fn many_rows_equal_one_matrix_product() {
        let rows = 2 * ROWS + 3;
        let tape = Tape::new();
        let x = tape.leaf(noise(1, [1, 1, rows, 3]));
        let weight = tape.leaf(noise(2, [1, 1, 2, 3]));
        let g = tape.constant(noise(3, [1, 1, rows, 2]));
        let ours = x.linear(weight, None);
        let plain = x.matmul_with(weight, MatMul { transpose_right: true, ..MatMul::default() });
        close(ours.value().data(), plain.value().data());
        let (got, want) = (tape.backward(ours.mul(g).sum()), tape.backward(plain.mul(g).sum()));
        close(got.wrt(x).data(), want.wrt(x).data());
        close(got.wrt(weight).data(), want.wrt(weight).data());
    }

    #[test]
    fn equals_a_one_by_one_convolution_of_the_channels() {
        let tape = Tape::new();
        let x = tape.constant(noise(1, [2, 3, 4, 5]));
        let (weight, bias) = (noise(2, [1, 1, 6, 3]), tape.constant(noise(3, [1, 6, 1, 1])));
        let kernel = tape.constant(weight.reshaped(Shape::new(6, 3, 1, 1)));
        let want = x.conv2d(kernel, Some(bias), crate::Conv2d::default());
        let got = x.permute([0, 2, 3, 1]).linear(tape.constant(weight), Some(bias)).permute([0, 3, 1, 2]);
        close(got.value().data(), want.value().data());
    }

    #[test]
    #[should_panic(expected = "linear: input [1, 1, 2, 3] and weight [1, 1, 4, 2]; the rule: [n, c, h, inputs]")]
    fn another_number_of_inputs_is_refused() {
        let tape = Tape::new();
        tape.constant(noise(1, [1, 1, 2, 3])).linear(tape.constant(noise(2, [1, 1, 4, 2])), None);
    }

    #[test]
    #[should_panic(expected = "linear: weight [1, 1, 4, 3] needs a bias of shape [1, 4, 1, 1], got [1, 3, 1, 1]")]
    fn bias_of_another_size_is_refused() {
        let tape = Tape::new();
        let (weight, bias) = (tape.constant(noise(2, [1, 1, 4, 3])), tape.constant(noise(3, [1, 3, 1, 1])));
        tape.constant(noise(1, [1, 1, 2, 3])).linear(weight, Some(bias));
    }

    proptest! {
        #![proptest_config(testing::cases())]
        #[test]
        fn gradient_matches_finite_differences(
            shape in testing::shapes(), outputs in 1..6usize, with_bias in any::<bool>(), seed in any::<u64>()
        ) {
            let mut inputs = vec![
                random(seed, shape, -1.0, 1.0),
                random(seed ^ 1, Shape::new(1, 1, outputs, shape.w()), -1.0, 1.0),
            ];
            inputs.extend(with_bias.then(|| random(seed ^ 2, Shape::new(1, outputs, 1, 1), -1.0, 1.0)));
            testing::check(&inputs, |v| v[0].linear(v[1], v.get(2).copied()));
        }

        #[test]
        fn adjoint_law_holds_in_input_and_weight(shape in testing::shapes(), outputs in 1..6usize, seed in any::<u64>()) {
            let matrix = Shape::new(1, 1, outputs, shape.w());
            testing::check_adjoint(shape, seed, |x| x.linear(x.tape().constant(random(seed ^ 1, matrix, -1.0, 1.0)), None));
            testing::check_adjoint(matrix, seed, |w| w.tape().constant(random(seed ^ 1, shape, -1.0, 1.0)).linear(w, None));
        }
    }
}
