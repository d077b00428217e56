//! Derivatives of losses over a list of flows by three ways. Every flow is measured in units of its own length, so that short
//! and long flows weigh alike: entries `2 i` and `2 i + 1` are `|f_i| dL/df_i`.

use dimode_autodiff::proof::Dual;
use dimode_autodiff::{Shape, Tape, Tensor, Var};
use nalgebra::Vector2;

use super::forward::V2;

/// A gradient, scaled.
pub(crate) fn scaled(flows: &[Vector2<f64>], gradient: &[Vector2<f64>]) -> Vec<f64> {
    flows.iter().zip(gradient).flat_map(|(f, g)| [g.x * f.norm(), g.y * f.norm()]).collect()
}

/// One number for each component of each flow.
fn each(flows: &[Vector2<f64>], of: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    (0..2 * flows.len()).map(|i| of(i / 2, i % 2)).collect()
}

/// In forward mode.
pub(crate) fn forward(flows: &[Vector2<f64>], loss: impl Fn(&[V2<Dual>]) -> Dual) -> Vec<f64> {
    each(flows, |i, k| {
        let slope = |j: usize, c: usize| if (j, c) == (i, k) { flows[i].norm() } else { 0.0 };
        let dual = |j: usize| [0, 1].map(|c| Dual { value: flows[j][c], slope: slope(j, c) });
        loss(&(0..flows.len()).map(dual).collect::<Vec<_>>()).slope
    })
}

/// By central differences with a step of a millionth of the flow's length.
pub(crate) fn central(flows: &[Vector2<f64>], loss: impl Fn(&[V2<f64>]) -> f64) -> Vec<f64> {
    const STEP: f64 = 1e-6;
    each(flows, |i, k| {
        let at = |sign: f64| {
            let mut moved: Vec<V2<f64>> = flows.iter().map(|&f| f.into()).collect();
            moved[i][k] += sign * STEP * flows[i].norm();
            loss(&moved)
        };
        (at(1.0) - at(-1.0)) / (2.0 * STEP)
    })
}

/// On the tape, with the flows as the pixels of one image, (1,2,1,N).
pub(crate) fn taped_image(flows: &[Vector2<f64>], loss: impl for<'t> Fn(Var<'t, f64>) -> Var<'t, f64>) -> Vec<f64> {
    let n = flows.len();
    let leaf = Tensor::from_fn(Shape::new(1, 2, 1, n), |_, c, _, i| flows[i][c]);
    let gradient = gradient(leaf, loss);
    each(flows, |i, k| gradient.at(0, k, 0, i) * flows[i].norm())
}

/// On the tape, with the flows as images of one pixel each, (N,2,1,1).
pub(crate) fn taped_images(flows: &[Vector2<f64>], loss: impl for<'t> Fn(Var<'t, f64>) -> Var<'t, f64>) -> Vec<f64> {
    let leaf = Tensor::from_fn(Shape::new(flows.len(), 2, 1, 1), |i, c, _, _| flows[i][c]);
    let gradient = gradient(leaf, loss);
    each(flows, |i, k| gradient.at(i, k, 0, 0) * flows[i].norm())
}

fn gradient(x: Tensor<f64>, loss: impl for<'t> Fn(Var<'t, f64>) -> Var<'t, f64>) -> Tensor<f64> {
    let tape = Tape::new();
    let leaf = tape.leaf(x);
    tape.backward(loss(leaf)).wrt(leaf)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::proof::{Number, total};

    fn squares<N: Number>(flows: &[V2<N>]) -> N {
        total(flows.iter().flat_map(|f| [f[0] * f[0], N::constant(3.0) * f[1] * f[1]]))
    }

    #[test]
    fn all_ways_count_in_lengths_of_the_flow() {
        let flows = [Vector2::new(3.0, 4.0), Vector2::new(0.0, -2.0)];
        let expected = [30.0, 120.0, 0.0, -24.0];
        assert_eq!(scaled(&flows, &[Vector2::new(6.0, 24.0), Vector2::new(0.0, -12.0)]), expected);
        assert_eq!(forward(&flows, squares), expected);
        assert!(central(&flows, squares).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6));
        fn taped<'t>(x: Var<'t, f64>) -> Var<'t, f64> {
            x.slice(1, 0, 1).square().add(x.slice(1, 1, 1).square().scale(3.0)).sum()
        }
        assert_eq!(taped_image(&flows, taped), expected);
        assert_eq!(taped_images(&flows, taped), expected);
    }
}
