//! Values and gradients have the same bits on 1 to 4 threads and when repeated, in `f32` and `f64`.

use dimode_autodiff::gradcheck::{random, weighted_sum};
use dimode_autodiff::{Scalar, Shape, Tape, Tensor, Var, par};

/// Several pieces of work for every operation: more elements than one chunk, and not a multiple of it.
const SHAPE: Shape = Shape::new(2, 3, 97, 131);

/// The bits of a value and of the gradients of a weighted sum of it.
fn bits<T: Scalar>(op: impl for<'t> Fn(Var<'t, T>, Var<'t, T>, &Tensor<T>) -> Var<'t, T>) -> Vec<u64> {
    let tape = Tape::<T>::new();
    let a = tape.leaf(random(1, SHAPE, 0.05, 0.95));
    let b = tape.leaf(random(2, SHAPE, 0.05, 0.95));
    let coin = random::<f64>(3, SHAPE, 0.0, 2.0).data().iter().map(|x| T::from_f64(x.floor())).collect();
    let y = op(a, b, &Tensor::from_vec(SHAPE, coin));
    let grads = tape.backward(weighted_sum(y, 4));
    let all = [y.value(), grads.wrt(a), grads.wrt(b)];
    all.iter().flat_map(|t| t.to_vec()).map(|x| x.to_f64().to_bits()).collect()
}

fn check_type<T: Scalar>(name: &str, op: impl for<'t> Fn(Var<'t, T>, Var<'t, T>, &Tensor<T>) -> Var<'t, T> + Send + Sync) {
    let one = par::with_threads(1, || bits(&op));
    assert!(one.iter().any(|&b| b != 0), "{name}: nothing but zeros");
    for threads in [1, 2, 3, 4] {
        let several = par::with_threads(threads, || bits(&op));
        let first = one.iter().zip(&several).position(|(a, b)| a != b);
        assert!(first.is_none(), "{name} in {}: entry {first:?} differs on {threads} threads", T::NAME);
    }
}

/// One test for each operation, so that a failure names it.
macro_rules! same_bits {
    ($($name:ident: |$a:pat_param, $b:pat_param, $mask:pat_param| $op:expr;)*) => {$(
        #[test]
        fn $name() {
            check_type::<f32>(stringify!($name), |$a, $b, $mask| $op);
            check_type::<f64>(stringify!($name), |$a, $b, $mask| $op);
        }
    )*};
}

same_bits! {
    add: |a, b, _| a.add(b);
    sub: |a, b, _| a.sub(b);
    mul: |a, b, _| a.mul(b);
    div: |a, b, _| a.div(b);
    div_guarded: |a, b, _| a.div_guarded(b, 0.3);
    neg: |a, _, _| a.neg();
    scale: |a, _, _| a.scale(0.3);
    add_scalar: |a, _, _| a.add_scalar(0.3);
    abs: |a, _, _| a.add_scalar(-0.5).abs();
    square: |a, _, _| a.square();
    sqrt: |a, _, _| a.sqrt();
    exp: |a, _, _| a.exp();
    ln: |a, _, _| a.ln();
    recip: |a, _, _| a.recip();
    sigmoid: |a, _, _| a.sigmoid();
    tanh: |a, _, _| a.tanh();
    relu: |a, _, _| a.add_scalar(-0.5).relu();
    elu: |a, _, _| a.add_scalar(-0.5).elu();
    clamp: |a, _, _| a.clamp(0.2, 0.8);
    minimum: |a, b, _| a.minimum(b);
    maximum: |a, b, _| a.maximum(b);
    atan2: |a, b, _| a.atan2(b);
    acos: |a, _, _| a.acos();
    sin: |a, _, _| a.sin();
    cos: |a, _, _| a.cos();
    select: |a, b, mask| a.select(mask, b);
    broadcast_to_rows: |a, _, _| a.slice(2, 0, 1).broadcast_to(SHAPE);
    broadcast_to_columns: |a, _, _| a.slice(3, 0, 1).broadcast_to(SHAPE);
    broadcast_to_channels: |a, _, _| a.slice(1, 0, 1).broadcast_to(SHAPE);
    broadcast_to_all: |a, _, _| a.sum().broadcast_to(SHAPE);
    sum_to_channels: |a, _, _| a.sum_to(Shape::new(1, 3, 1, 1));
    sum_to_row: |a, _, _| a.sum_to(Shape::new(1, 1, 1, 131));
    sum: |a, _, _| a.sum();
    mean: |a, _, _| a.mean();
    mean_hw: |a, _, _| a.mean_hw();
    mean_channels: |a, _, _| a.mean_channels();
    sum_chw: |a, _, _| a.sum_chw();
    masked_mean: |a, _, mask| a.masked_mean(mask);
    weighted_l1: |a, b, mask| a.weighted_l1(b, &Tensor::from_fn(SHAPE.with_c(1), |n, _, h, w| mask.at(n, 0, h, w)), 0.1);
    mean_to_rows: |a, _, _| a.mean_to(Shape::new(2, 3, 97, 1));
    gelu: |a, _, _| a.add_scalar(-0.5).gelu();
    log1p_exp: |a, _, _| a.add_scalar(-0.5).log1p_exp();
    sqrt_guarded: |a, _, _| a.sqrt_guarded(0.3);
    powf: |a, _, _| a.powf(0.4);
    softmax_samples: |a, _, _| a.softmax(0);
    softmax_channels: |a, _, _| a.softmax(1);
    softmax_rows: |a, _, _| a.softmax(2);
    softmax_columns: |a, _, _| a.softmax(3);
    l2_normalise_channels: |a, _, _| a.l2_normalise(1, 1e-12);
    l2_normalise_columns: |a, _, _| a.l2_normalise(3, 1e-12);
    max_axis: |a, _, _| a.max_axis(1).values;
    min_axis: |a, b, _| b.gather(2, &a.min_axis(2).index);
    gather: |a, _, mask| a.gather(1, mask);
    min_max: |a, _, _| a.min_max(1e-8);
    concat_channels: |a, b, _| Var::concat(&[a, b, a], 1);
    concat_columns: |a, b, _| Var::concat(&[a, b], 3);
    slice_rows: |a, _, _| a.slice(2, 5, 90);
    reshape: |a, b, _| a.reshape(Shape::new(1, 6, 131, 97)).mul(b.reshape(Shape::new(1, 6, 131, 97)));
    permute_planes: |a, _, _| a.permute([0, 1, 3, 2]);
    permute_all: |a, _, _| a.permute([3, 0, 2, 1]);
    variable_used_by_many: |a, b, _| a.mul(b).add(a.exp()).sub(b.slice(2, 0, 1).broadcast_to(SHAPE)).mul(a).mean_hw();
}
