//! Spatial and normalisation operations give the same bits, forward and backward, on one to four threads and when repeated.

use dimode_autodiff::gradcheck::{random, weighted_sum};
use dimode_autodiff::ops::bilinear_sample::SamplePadding;
use dimode_autodiff::ops::drop_path::keep_mask;
use dimode_autodiff::{Activation, Conv2d, MatMul, Scalar, Shape, Tape, Tensor, Var, par};

/// Bits of the output and of the gradients of all inputs, computed on the given number of threads.
fn bits<T: Scalar>(
    threads: usize,
    inputs: &[[usize; 4]],
    op: impl for<'t> Fn(&[Var<'t, T>]) -> Var<'t, T> + Send + Sync,
) -> Vec<u64> {
    par::with_threads(threads, || {
        let tape = Tape::new();
        let value = |(i, sizes): (usize, &[usize; 4])| {
            // Values up to 20 serve as coordinates, too; they reach beyond the planes on both sides.
            let x: Tensor<T> = random(i as u64, Shape(*sizes), -2.0, 20.0);
            tape.leaf(x)
        };
        let vars: Vec<_> = inputs.iter().enumerate().map(value).collect();
        let y = op(&vars);
        let grads = tape.backward(weighted_sum(y, 5));
        let gradients = vars.iter().map(|&v| grads.wrt(v));
        std::iter::once(y.value()).chain(gradients).flat_map(|t| t.to_vec()).map(|x| x.to_f64().to_bits()).collect()
    })
}

#[track_caller]
fn check<T: Scalar>(inputs: &[[usize; 4]], op: impl for<'t> Fn(&[Var<'t, T>]) -> Var<'t, T> + Send + Sync) {
    let one = bits(1, inputs, &op);
    assert!(one.iter().any(|&bits| bits != 0), "nothing but zeros");
    for threads in [1, 2, 3, 4] {
        assert!(bits(threads, inputs, &op) == one, "{}: {threads} threads give other bits than one", T::NAME);
    }
}

/// The operation gives the same bits for inputs of these sizes, in both number types.
macro_rules! assert_same_bits {
    ($inputs:expr, $op:expr) => {{
        check::<f32>($inputs, $op);
        check::<f64>($inputs, $op);
    }};
}

const X: [usize; 4] = [5, 7, 23, 38];
const VECTOR: [usize; 4] = [1, 7, 1, 1];

#[test]
fn normalisation() {
    assert_same_bits!(&[X], |v| v[0].instance_norm(1e-5));
    assert_same_bits!(&[X, VECTOR, VECTOR], |v| v[0].batch_norm_train(v[1], v[2], 1e-5).y);
    assert_same_bits!(&[X, VECTOR, VECTOR], |v| {
        let mean = random(3, Shape(VECTOR), -1.0, 1.0);
        let var = random(4, Shape(VECTOR), 0.5, 2.0);
        v[0].batch_norm_eval(v[1], v[2], &mean, &var, 1e-5)
    });
    assert_same_bits!(&[X, VECTOR, VECTOR, X], |v| {
        v[0].batch_norm_train_activated(v[1], v[2], 1e-5, Some(v[3]), Activation::Elu).y
    });
    assert_same_bits!(&[X, VECTOR, VECTOR, X], |v| {
        let mean = random(3, Shape(VECTOR), -1.0, 1.0);
        let var = random(4, Shape(VECTOR), 0.5, 2.0);
        v[0].batch_norm_eval_activated(v[1], v[2], [&mean, &var], 1e-5, Some(v[3]), Activation::Relu)
    });
    assert_same_bits!(&[X, VECTOR, VECTOR], |v| v[0].layer_norm(v[1], v[2], 1e-6));
}

#[test]
fn windows() {
    assert_same_bits!(&[X], |v| v[0].max_pool2d(3, 2, 1));
    assert_same_bits!(&[X], |v| v[0].avg_pool2d(3, 2, 1));
    assert_same_bits!(&[X], |v| v[0].avg_pool2d(2, 2, 0));
    assert_same_bits!(&[X], |v| v[0].box_mean(3));
    assert_same_bits!(&[X], |v| v[0].box_mean(7));
}

#[test]
fn resizing_and_padding() {
    assert_same_bits!(&[X], |v| v[0].pad_reflect(3));
    assert_same_bits!(&[X], |v| v[0].pad_replicate(2));
    assert_same_bits!(&[X], |v| v[0].pad_zero(2));
    assert_same_bits!(&[X], |v| v[0].upsample_nearest(2));
    assert_same_bits!(&[X], |v| v[0].resize_nearest(31, 20));
    assert_same_bits!(&[X], |v| v[0].resize_bilinear(46, 76, false));
    assert_same_bits!(&[X], |v| v[0].resize_bilinear(46, 76, true));
}

#[test]
fn products_and_samples() {
    assert_same_bits!(&[X, [1, 1, 9, 38], [1, 9, 1, 1]], |v| v[0].linear(v[1], Some(v[2])));
    assert_same_bits!(&[X, [1, 7, 9, 38]], |v| {
        v[0].matmul_with(v[1], MatMul { transpose_right: true, broadcast: true, ..MatMul::default() })
    });
    assert_same_bits!(&[[1, 1, 301, 70], [1, 1, 70, 290]], |v| v[0].matmul(v[1]));
    assert_same_bits!(&[X, [5, 7, 38, 11]], |v| v[0].matmul(v[1]));
    assert_same_bits!(&[X], |v| v[0].transpose_hw());
    assert_same_bits!(&[X], |v| v[0].drop_path(&keep_mask(5, 0.3, 1, 2), 0.3));
}

/// Every kind of kernel: few and many channels, wide windows, single pixels, steps, gaps, groups, one channel at a time.
#[test]
fn convolutions() {
    macro_rules! conv {
        ($x:expr, $weight:expr, $attributes:expr) => {
            assert_same_bits!(&[$x, $weight, [1, $weight[0], 1, 1]], |v| v[0].conv2d(v[1], Some(v[2]), $attributes))
        };
    }
    conv!([3, 3, 41, 62], [16, 3, 7, 7], Conv2d::new(2, 3));
    conv!([3, 16, 33, 50], [24, 16, 3, 3], Conv2d::new(1, 1));
    conv!([3, 16, 33, 50], [24, 16, 3, 3], Conv2d::new(2, 1));
    conv!([3, 16, 33, 50], [1, 16, 3, 3], Conv2d::new(1, 1).reflect());
    conv!([3, 16, 33, 50], [24, 16, 3, 3], Conv2d::new(1, 1).replicate());
    conv!([2, 96, 13, 20], [80, 96, 3, 3], Conv2d::new(1, 1));
    conv!([3, 32, 33, 50], [24, 32, 3, 3], Conv2d::new(1, 1));
    conv!([3, 40, 33, 50], [24, 40, 1, 1], Conv2d::new(1, 0));
    conv!([3, 40, 33, 50], [24, 40, 1, 1], Conv2d::new(2, 0));
    conv!([3, 12, 33, 50], [24, 4, 3, 3], Conv2d { groups: 3, ..Conv2d::new(1, 1) });
    conv!([3, 24, 33, 50], [24, 1, 3, 3], Conv2d { groups: 24, dilation: (3, 3), ..Conv2d::new(1, 3) });
    assert_same_bits!(&[[3, 16, 33, 50], [24, 16, 3, 3], [1, 24, 1, 1]], |v| {
        v[0].conv2d_activated(v[1], Some(v[2]), Conv2d::new(2, 1), Activation::Elu)
    });
}

#[test]
fn sampling() {
    assert_same_bits!(&[X, [5, 2, 31, 40]], |v| v[0].bilinear_sample(v[1], SamplePadding::Border));
    assert_same_bits!(&[X, [5, 2, 31, 40]], |v| v[0].bilinear_sample(v[1], SamplePadding::Zeros));
}

#[test]
fn correlation_and_lookup() {
    assert_same_bits!(&[[3, 9, 13, 18], [3, 9, 11, 15]], |v| v[0].correlation(v[1]));
    assert_same_bits!(&[[468, 1, 9, 13], [468, 1, 4, 6], [2, 2, 13, 18]], |v| Var::correlation_lookup(&v[..2], v[2], 3));
    assert_same_bits!(&[[3, 9, 31, 47], [3, 9, 31, 47]], |v| v[0].window_correlation(v[1], 2));
    assert_same_bits!(&[[3, 2, 9, 13], [3, 144, 9, 13]], |v| v[0].convex_upsample(v[1], 4));
}
