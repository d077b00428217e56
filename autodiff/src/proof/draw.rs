//! Reproducible shapes and inputs for proofs.

use crate::{Shape, Tensor, gradcheck, rng};

/// Draws sizes and tensors from a seed, always in the same order.
#[derive(Clone, Debug)]
pub struct Draw {
    seed: u64,
    count: u64,
}

impl Draw {
    /// A new sequence; the name of the operation makes a good seed.
    pub fn new(name: &str) -> Self {
        let seed =
            name.bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| (hash ^ byte as u64).wrapping_mul(0x0100_0000_01b3));
        Draw { seed, count: 0 }
    }

    fn next(&mut self) -> u64 {
        self.count += 1;
        rng::splitmix64(self.seed, self.count)
    }

    /// A whole number from `lo` to `hi`, both included.
    pub fn size(&mut self, lo: usize, hi: usize) -> usize {
        lo + (self.next() % (hi - lo + 1) as u64) as usize
    }

    /// A shape with sizes up to `most`.
    pub fn shape(&mut self, most: [usize; 4]) -> Shape {
        Shape(most.map(|size| self.size(1, size)))
    }

    /// Numbers uniform in `[lo, hi)`.
    pub fn uniform(&mut self, shape: Shape, lo: f64, hi: f64) -> Tensor<f64> {
        gradcheck::random(self.next(), shape, lo, hi)
    }

    /// Numbers in `lo..hi`, moved out of the band of half width 0.05 around each kink.
    pub fn away(&mut self, shape: Shape, lo: f64, hi: f64, kinks: &[f64]) -> Tensor<f64> {
        let drawn = self.uniform(shape, lo, hi);
        let away = |&x: &f64| kinks.iter().fold(x, |x, &kink| if (x - kink).abs() < 0.05 { kink + 0.1 } else { x });
        Tensor::from_vec(shape, drawn.data().iter().map(away).collect())
    }

    /// Numbers between about -1 and 1, any two of them at least 1 / count apart, in random order.
    pub fn distinct(&mut self, shape: Shape) -> Tensor<f64> {
        let keys = self.uniform(shape, 0.0, 1.0);
        let mut order: Vec<usize> = (0..shape.len()).collect();
        order.sort_by(|&a, &b| keys.data()[a].total_cmp(&keys.data()[b]));
        let mut values = vec![0.0; shape.len()];
        for (rank, &i) in order.iter().enumerate() {
            values[i] = (2.0 * rank as f64 + keys.data()[i]) / shape.len() as f64 - 1.0;
        }
        Tensor::from_vec(shape, values)
    }

    /// Two tensors whose entries differ by at least 0.5, in both directions.
    pub fn apart(&mut self, shape: Shape) -> [Tensor<f64>; 2] {
        let (first, gap) = (self.uniform(shape, -1.0, 1.0), self.weights(shape));
        let second = first.data().iter().zip(gap.data()).map(|(x, gap)| x + gap).collect();
        [first, Tensor::from_vec(shape, second)]
    }

    /// Whole numbers from 0 to below `end`.
    pub fn whole(&mut self, shape: Shape, end: usize) -> Tensor<f64> {
        Tensor::from_vec(shape, self.uniform(shape, 0.0, end as f64).data().iter().map(|x| x.floor()).collect())
    }

    /// Numbers of both signs with magnitudes in `[0.5, 1.5)`, so that each counts.
    pub fn weights(&mut self, shape: Shape) -> Tensor<f64> {
        let drawn = self.uniform(shape, -1.0, 1.0);
        Tensor::from_vec(shape, drawn.data().iter().map(|&x| x + if x < 0.0 { -0.5 } else { 0.5 }).collect())
    }
}

/// Shapes for an operation that takes any: one number, single axes, odd and non-square ones, and one of 2046 entries.
pub fn shapes(draw: &mut Draw) -> Vec<Shape> {
    let mut shapes = vec![
        Shape::SCALAR,
        Shape::new(1, 1, 1, 7),
        Shape::new(1, 1, 5, 1),
        Shape::new(1, 6, 1, 1),
        Shape::new(3, 1, 1, 2),
        Shape::new(2, 3, 5, 3),
    ];
    shapes.extend((0..5).map(|_| draw.shape([3, 4, 5, 7])));
    shapes.push(Shape::new(2, 3, 11, 31));
    shapes
}

/// Pairs of a shape and the same with size one along some axes: every choice of axes, and every kind of shape.
pub fn some_axes(draw: &mut Draw) -> Vec<(Shape, Shape)> {
    let reduced = |shape: Shape, choice: usize| {
        let mut small = shape;
        for axis in (0..4).filter(|axis| choice >> axis & 1 == 1) {
            small = small.with_axis(axis, 1);
        }
        (shape, small)
    };
    let mut pairs: Vec<_> = (0..16).map(|choice| reduced(draw.shape([3, 4, 5, 6]).with_axis(1, 3), choice)).collect();
    pairs.extend(shapes(draw).into_iter().enumerate().map(|(i, shape)| reduced(shape, 5 * i % 16)));
    // Two thousand entries on the small side.
    pairs.push(reduced(Shape::new(2, 2, 23, 44), 1));
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_name_draws_the_same_and_another_does_not() {
        let draw = |name| Draw::new(name).uniform(Shape::new(1, 1, 2, 3), 0.0, 1.0);
        assert_eq!(draw("abs"), draw("abs"));
        assert_ne!(draw("abs"), draw("add"));
    }

    #[test]
    fn distinct_numbers_keep_their_distance() {
        let mut values = Draw::new("x").distinct(Shape::new(2, 3, 5, 3)).to_vec();
        values.sort_by(f64::total_cmp);
        assert!(values.windows(2).all(|pair| pair[1] - pair[0] >= 0.99 / 90.0));
    }
}
