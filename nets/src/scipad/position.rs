//! Positional features from feature flow, place on the image and point cloud (PCA of SCIPaD).

use dimode_autodiff::{Activation, Scalar, Shape, Tensor, Var};

use super::feature_flow::FeatureFlow;
use crate::layers::{BatchNorm, ConvLayer};
use crate::{Binder, Blueprint};

/// Guard of the range that [`Var::min_max`] divides by.
const RANGE_EPSILON: f64 = 1e-8;

/// 1x1 convolution, **ReLU before batch norm**, 1x1 convolution.
#[derive(Clone, Debug, PartialEq)]
struct Embedding {
    first: ConvLayer,
    norm: BatchNorm,
    second: ConvLayer,
}

impl Embedding {
    fn new(path: &str, inputs: usize, width: usize) -> Self {
        Self {
            first: ConvLayer::new(format!("{path}.0"), inputs, width, 1),
            norm: BatchNorm::new(format!("{path}.2"), width),
            second: ConvLayer::new(format!("{path}.3"), width, width, 1),
        }
    }

    fn declare(&self, blueprint: &mut Blueprint) {
        self.first.declare(blueprint);
        self.norm.declare(blueprint);
        self.second.declare(blueprint);
    }

    fn forward<'t, T: Scalar>(&self, binder: &mut Binder<'t, T>, x: Var<'t, T>) -> Var<'t, T> {
        let x = self.first.activated(binder, x, Activation::Relu);
        let x = x.last_use(|x| self.norm.forward(binder, x));
        x.last_use(|x| self.second.forward(binder, x))
    }
}

/// One embedding of positions and one of points, shared by the three levels.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PositionEncoder {
    position: Embedding,
    point: Embedding,
}

impl PositionEncoder {
    pub(super) fn new(path: &str, width: usize) -> Self {
        Self {
            position: Embedding::new(&format!("{path}.pos_embed"), 2, width),
            point: Embedding::new(&format!("{path}.pc_embed"), 3, width),
        }
    }

    pub(super) fn declare(&self, blueprint: &mut Blueprint) {
        self.position.declare(blueprint);
        self.point.declare(blueprint);
    }

    /// Feature flow (N, 2, h, w) with its confidence, and points (N, 3, H, W) of the target in its camera's frame ->
    /// (N, width, h, w):
    /// `confidence (position(n(flow)) + position(grid)) + point(n(points at this level))`, where `n` maps the whole batch to
    /// [0, 1]. Without points they are zeros.
    ///
    /// In training the running statistics of `position` move twice: by the flows of the batch, then by the one grid.
    pub(super) fn forward<'t, T: Scalar>(
        &self,
        binder: &mut Binder<'t, T>,
        found: FeatureFlow<'t, T>,
        points: Option<Var<'t, T>>,
    ) -> Var<'t, T> {
        let (tape, level) = (binder.tape(), found.flow.shape());
        let flow = found.flow.min_max(RANGE_EPSILON).last_use(|flow| self.position.forward(binder, flow));
        let place = tape.constant(grid(level)).last_use(|grid| self.position.forward(binder, grid));
        let wide = flow.shape();
        let position = flow.last_use(|flow| flow.add(place.broadcast_to(wide)));
        place.release();
        let confidence = found.confidence.broadcast_to(wide);
        let position = position.last_use(|position| confidence.last_use(|confidence| position.mul(confidence)));
        let points = match points {
            Some(points) => {
                let points = points.resize_bilinear(level.h(), level.w(), true);
                points.last_use(|points| points.min_max(RANGE_EPSILON))
            }
            None => tape.constant(Tensor::zeros(level.with_c(3))),
        };
        let points = points.last_use(|points| self.point.forward(binder, points));
        position.last_use(|position| points.last_use(|points| position.add(points)))
    }
}

/// Row and column over the size of the map, from [0, 1) to [-1, 1), **row first**: (1, 2, h, w).
fn grid<T: Scalar>(map: Shape) -> Tensor<T> {
    Tensor::from_fn(Shape::new(1, 2, map.h(), map.w()), |_, axis, i, j| {
        let (at, size) = if axis == 0 { (i, map.h()) } else { (j, map.w()) };
        T::from_f64(2.0 * (at as f64 / size as f64 - 0.5))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_grid_begins_at_minus_one_and_says_rows_first() {
        let grid = grid::<f64>(Shape::new(3, 7, 4, 8));
        assert_eq!(grid.shape(), Shape::new(1, 2, 4, 8));
        assert_eq!([grid.at(0, 0, 0, 5), grid.at(0, 0, 3, 5)], [-1.0, 0.5]);
        assert_eq!([grid.at(0, 1, 2, 0), grid.at(0, 1, 2, 7)], [-1.0, 0.75]);
    }
}
