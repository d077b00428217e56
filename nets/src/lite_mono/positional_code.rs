//! Positional code of the first stage: waves of rows and columns, projected to the channels.

use std::f64::consts::TAU;

use dimode_autodiff::{Scalar, Shape, Tensor, Var};

use crate::layers::ConvLayer;
use crate::{Binder, Blueprint};

/// Waves of each axis.
const WAVES: usize = 32;
/// Ratio of the longest and the shortest period, nearly.
const TEMPERATURE: f64 = 10_000.0;
/// Added to the number of rows or columns.
const EPSILON: f64 = 1e-6;

/// `token_projection` of 64 waves: with `a = 2 pi (i + 1) / (rows + 1e-6)` and `T_k = 10000^(2 (k div 2) / 32)`, wave `k` of row
/// `i` is `sin(a / T_k)` for even `k` and `cos(a / T_k)` for odd; 32 waves of the rows, then 32 of the columns.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PositionalCode {
    projection: ConvLayer,
}

impl PositionalCode {
    /// The code stored under `path`.
    pub(super) fn new(path: &str, channels: usize) -> Self {
        let projection = ConvLayer::new(format!("{path}.token_projection"), 2 * WAVES, channels, 1);
        Self { projection: projection.kaiming() }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.projection.declare(blueprint);
    }

    /// The code for maps of `shape`, the same for all samples.
    ///
    /// A wave depends on the row alone or on the column alone. Rows and columns are projected each by their half of the
    /// weights, and only the sum has the size of the map.
    pub(super) fn forward<'t, T: Scalar>(&self, binder: &Binder<'t, T>, shape: Shape) -> Var<'t, T> {
        let (height, width) = (shape.h(), shape.w());
        let weight = binder.param(&self.projection.weight_path());
        let bias = binder.param(&self.projection.bias_path());
        let options = self.projection.options();
        let rows = binder.tape().constant(waves(height).reshaped(Shape::new(1, WAVES, height, 1)));
        let columns = binder.tape().constant(waves(width).reshaped(Shape::new(1, WAVES, 1, width)));
        let rows = rows.conv2d(weight.slice(1, 0, WAVES), Some(bias), options);
        let columns = columns.conv2d(weight.slice(1, WAVES, WAVES), None, options);
        binder.count_macs(shape.len() * self.projection.macs_per_output());
        let spread = |part: Var<'t, T>| part.last_use(|part| part.broadcast_to(shape));
        spread(rows).last_use(|rows| spread(columns).last_use(|columns| rows.add(columns)))
    }
}

/// The waves of `count` rows or columns, (1, 32, count, 1).
fn waves<T: Scalar>(count: usize) -> Tensor<T> {
    Tensor::from_fn(Shape::new(1, WAVES, count, 1), |_, k, i, _| {
        let angle = TAU * (i + 1) as f64 / (count as f64 + EPSILON);
        let period = TEMPERATURE.powf((2 * (k / 2)) as f64 / WAVES as f64);
        let (sine, cosine) = (angle / period).sin_cos();
        T::from_f64(if k.is_multiple_of(2) { sine } else { cosine })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Tape;

    /// Convolution over the 64 maps of the definition.
    #[test]
    fn rows_and_columns_apart_give_the_code_of_the_definition() {
        let code = PositionalCode::new("net:pos", 5);
        let mut blueprint = Blueprint::new();
        code.declare(&mut blueprint);
        let params = blueprint.init::<f64>(3);
        let tape = Tape::new();
        let binder = Binder::frozen(&tape, &params);
        let shape = Shape::new(2, 5, 4, 7);
        let wave = |k: usize, a: f64| {
            let angle = a / 10_000f64.powf((k / 2) as f64 / 16.0);
            if k.is_multiple_of(2) { angle.sin() } else { angle.cos() }
        };
        let maps = Tensor::from_fn(Shape::new(2, 64, 4, 7), |_, k, i, j| match k {
            0..32 => wave(k, (i + 1) as f64 / (4.0 + 1e-6) * TAU),
            _ => wave(k - 32, (j + 1) as f64 / (7.0 + 1e-6) * TAU),
        });
        let expected = code.projection.forward(&binder, tape.constant(maps)).value();
        let macs = binder.macs();
        let found = code.forward(&binder, shape).value();
        assert_eq!(binder.macs(), 2 * macs);
        for (a, b) in found.data().iter().zip(expected.data()) {
            assert!((a - b).abs() < 1e-14, "{a} against {b}");
        }
    }
}
