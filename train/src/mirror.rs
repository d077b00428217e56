//! Left and right exchanged.

use dimode_autodiff::Tensor;

/// Maps or images `[n, c, h, w]`, each row turned around.
pub fn mirrored(x: &Tensor<f32>) -> Tensor<f32> {
    x.beside(x.shape(), |data| {
        data.copy_from_slice(x.data());
        data.chunks_exact_mut(x.shape().w()).for_each(<[f32]>::reverse);
    })
}

/// Flow `[n, 2, h, w]` in pixels of the mirrored images: rows turned around, horizontal displacement negated.
///
/// # Panics
/// When there are not two channels.
pub fn mirrored_flow(flow: &Tensor<f32>) -> Tensor<f32> {
    let shape = flow.shape();
    assert!(shape.c() == 2, "mirrored_flow: two channels, got {shape}");
    flow.beside(shape, |data| {
        data.copy_from_slice(flow.data());
        data.chunks_exact_mut(2 * shape.plane()).for_each(|sample| mirror_flow(sample, shape.w()));
    })
}

/// The flow of one sample in place, both planes.
pub(crate) fn mirror_flow(sample: &mut [f32], width: usize) {
    sample.chunks_exact_mut(width).for_each(<[f32]>::reverse);
    let plane = sample.len() / 2;
    sample[..plane].iter_mut().for_each(|u| *u = -*u);
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_autodiff::Shape;

    #[test]
    fn mirroring_turns_the_horizontal_flow_around() {
        let flow = Tensor::from_vec(Shape::new(2, 2, 1, 2), vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
        assert_eq!(mirrored_flow(&flow).data(), [-2.0, -1.0, 4.0, 3.0, -6.0, -5.0, 8.0, 7.0]);
        assert_eq!(mirrored_flow(&mirrored_flow(&flow)), flow);
    }
}
