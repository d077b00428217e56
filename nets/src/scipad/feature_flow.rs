//! Where the features of one image are found in another, and how sure that is (CAFFE of SCIPaD).

use dimode_autodiff::{Conv2d, Scalar, Shape, Tensor, Var};

use crate::Binder;

/// Radius of the window at 1/4, 1/8 and 1/16 of the size.
pub(super) const RADII: [usize; 3] = [4, 2, 1];

/// The flow of features at one level, all of it constant.
#[derive(Clone, Copy)]
pub(super) struct FeatureFlow<'t, T: Scalar> {
    /// Displacement in cells, **row first**, (N, 2, h, w).
    pub(super) flow: Var<'t, T>,
    /// The largest affinity times the largest weight in the window, (N, 1, h, w).
    pub(super) confidence: Var<'t, T>,
}

/// Correlates features of unit length, (N, C, h, w), in a window of side `2 radius + 1`: the affinities become weights by a softmax
/// over the window, and the flow is the mean offset with these weights. Gives up the values of both features.
pub(super) fn feature_flow<'t, T: Scalar>(
    binder: &Binder<'t, T>,
    target: Var<'t, T>,
    reference: Var<'t, T>,
    radius: usize,
) -> FeatureFlow<'t, T> {
    let affinity = target.last_use(|target| reference.last_use(|reference| target.window_correlation(reference, radius)));
    binder.count_macs(target.shape().c() * affinity.shape().len());
    let weights = affinity.softmax(1);
    let flow = weights.conv2d(binder.tape().constant(offsets(radius)), None, Conv2d::new(1, 0));
    let [affinity, weight] = [affinity, weights].map(|x| {
        let largest = x.max_axis(1);
        x.release();
        largest.values
    });
    FeatureFlow { flow, confidence: affinity.last_use(|affinity| weight.last_use(|weight| affinity.mul(weight))) }
}

/// Row and column offset of each place of the window as the two kernels of a 1x1 convolution, (2, (2 radius + 1)², 1, 1).
fn offsets<T: Scalar>(radius: usize) -> Tensor<T> {
    let side = 2 * radius + 1;
    let offset = |axis, k| if axis == 0 { k / side } else { k % side };
    Tensor::from_fn(Shape::new(2, side * side, 1, 1), |axis, k, _, _| T::from_f64(offset(axis, k) as f64 - radius as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ParamSet;
    use dimode_autodiff::Tape;

    #[test]
    fn a_feature_that_moved_down_and_left_has_that_flow() {
        let tape = Tape::<f64>::new();
        let params = ParamSet::new();
        let binder = Binder::frozen(&tape, &params);
        // One bright feature at row 2, column 3, found again two rows down and one column to the left.
        let spot = |row, column| {
            let value = move |_, _, i, j| if (i, j) == (row, column) { 100.0 } else { 0.0 };
            tape.constant(Tensor::from_fn(Shape::new(1, 1, 6, 6), value))
        };
        let FeatureFlow { flow, confidence } = feature_flow(&binder, spot(2, 3), spot(4, 2), 2);
        assert_eq!(binder.macs(), 25 * 36);
        let (flow, confidence) = (flow.value(), confidence.value());
        assert!((flow.at(0, 0, 2, 3) - 2.0).abs() < 1e-12 && (flow.at(0, 1, 2, 3) + 1.0).abs() < 1e-12);
        assert_eq!(confidence.at(0, 0, 2, 3), 1e4);
        assert!(flow.at(0, 0, 0, 0).abs() < 1e-12, "without any likeness all offsets count the same");
    }
}
