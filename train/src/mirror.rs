//! Left and right exchanged.

use dimode_autodiff::Tensor;

/// Maps or images `[n, c, h, w]`, each row turned around.
pub fn mirrored(x: &Tensor<f32>) -> Tensor<f32> {
    let mut data = x.data().to_vec();
    data.chunks_exact_mut(x.shape().w()).for_each(<[f32]>::reverse);
    Tensor::from_vec(x.shape(), data)
}

/// Flow `[n, 2, h, w]` in pixels of the mirrored images: rows turned around, horizontal displacement negated.
///
/// # Panics
/// When there are not two channels.
pub fn mirrored_flow(flow: &Tensor<f32>) -> Tensor<f32> {
    let shape = flow.shape();
    assert!(shape.c() == 2, "mirrored_flow: two channels, got {shape}");
    let mut data = mirrored(flow).data().to_vec();
    for sample in data.chunks_exact_mut(2 * shape.plane()) {
        sample[..shape.plane()].iter_mut().for_each(|u| *u = -*u);
    }
    Tensor::from_vec(shape, data)
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
