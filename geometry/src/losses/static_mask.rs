//! Choice of the pixels that belong to the static scene.

use dimode_autodiff::{Scalar, Tensor};
use serde::{Deserialize, Serialize};

use crate::taped::masks;

/// Which pixels count as part of the static scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StaticMask {
    /// All.
    None,
    /// [`masks::static_pixels`]: squared difference of rigid and optical flow below its mean over the image.
    Mean,
    /// [`masks::static_on_grid`], as Dynamo-Depth has it: the mean over the whole batch, distances in units of a sampling grid.
    DynamoGrid,
    /// [`masks::agreeing`] within 5 pixels, as DF-VO tells moving things.
    Agreeing,
    /// [`masks::relatively_static`]: squared difference relative to the flow below four times its mean. Large flows may be
    /// far off at first.
    Relative,
}

impl StaticMask {
    /// The static pixels among those of `within`, (N,1,H,W). The flows are (N,C,H,W), pixels.
    ///
    /// **Panics** when the sizes differ.
    #[must_use]
    #[track_caller]
    pub fn among<T: Scalar>(self, within: Tensor<T>, rigid: &Tensor<T>, optical: &Tensor<T>) -> Tensor<T> {
        match self {
            Self::None => within,
            Self::Mean => masks::static_pixels(rigid, optical, Some(&within)),
            Self::DynamoGrid => masks::all_of(&[&within, &masks::static_on_grid(rigid, optical)]),
            Self::Agreeing => masks::all_of(&[&within, &masks::agreeing(rigid, optical, 5.0)]),
            Self::Relative => masks::relatively_static(rigid, optical, Some(&within)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;

    #[test]
    fn each_choice_drops_what_its_test_drops() {
        // Off by 4 px of 20 and by 3 px of 1, then by 1 px of 10 five times; the last pixel is not asked for.
        let optical = [20.0, 1.0, 10.0, 10.0, 10.0, 10.0, 10.0, 1.0];
        let error = [4.0, 3.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0];
        let map = |values: [f64; 8]| Tensor::from_fn(Shape::new(1, 2, 1, 8), |_, c, _, u| if c == 0 { values[u] } else { 0.0 });
        let (flow, rigid) = (map(optical), map(std::array::from_fn(|i| optical[i] + error[i])));
        let within = Tensor::from_fn(Shape::new(1, 1, 1, 8), |_, _, _, u| if u < 7 { 1.0 } else { 0.0 });
        let kept = |mask: StaticMask| mask.among(within.clone(), &rigid, &flow).to_vec();
        assert_eq!(kept(StaticMask::None), [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        assert_eq!(kept(StaticMask::Mean), [0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        assert_eq!(kept(StaticMask::Agreeing), [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        assert_eq!(kept(StaticMask::Relative), [1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
    }

    #[test]
    fn the_grid_of_dynamo_pools_the_batch_and_counts_sides() {
        // The same error along the shorter side is a larger part of it; the mean is that of both images.
        let error = |n: usize, c: usize| if n == 1 { 0.1 } else { [1.0, 0.0][c] };
        let rigid = Tensor::from_fn(Shape::new(2, 2, 2, 5), |n, c, v, _| if v == 0 { error(n, c) } else { error(n, 1 - c) });
        let optical = Tensor::<f64>::zeros(rigid.shape());
        let kept = StaticMask::DynamoGrid.among(masks::everywhere(rigid.shape()), &rigid, &optical);
        assert_eq!(kept.plane(0, 0), [[1.0; 5], [0.0; 5]].concat());
        assert_eq!(kept.plane(1, 0), [1.0; 10]);
    }
}
