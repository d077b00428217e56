//! The shape of a tensor: four sizes `[n, c, h, w]`.

use std::fmt;

/// Sizes `[n, c, h, w]`: samples, channels, rows, columns.
///
/// Lower ranks are special cases: a scalar is `[1, 1, 1, 1]`, a per-channel vector `[1, c, 1, 1]`, a per-sample vector
/// `[n, c, 1, 1]`, a batch of matrices `[n, 1, rows, columns]`, convolution weights `[out, in / groups, kh, kw]`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Shape(pub [usize; 4]);

impl Shape {
    /// The shape of one number.
    pub const SCALAR: Shape = Shape([1, 1, 1, 1]);

    /// A shape from its four sizes.
    pub const fn new(n: usize, c: usize, h: usize, w: usize) -> Self {
        Shape([n, c, h, w])
    }

    /// Samples.
    pub const fn n(self) -> usize {
        self.0[0]
    }

    /// Channels.
    pub const fn c(self) -> usize {
        self.0[1]
    }

    /// Rows.
    pub const fn h(self) -> usize {
        self.0[2]
    }

    /// Columns.
    pub const fn w(self) -> usize {
        self.0[3]
    }

    /// Elements of one plane, `h * w`.
    pub const fn plane(self) -> usize {
        self.0[2] * self.0[3]
    }

    /// Planes, `n * c`.
    pub const fn planes(self) -> usize {
        self.0[0] * self.0[1]
    }

    /// All elements.
    pub const fn len(self) -> usize {
        self.planes() * self.plane()
    }

    /// Whether some axis has size zero.
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// The same shape with another number of channels.
    pub const fn with_c(self, c: usize) -> Self {
        Shape([self.0[0], c, self.0[2], self.0[3]])
    }

    /// The same samples and channels over planes of another size.
    pub const fn with_plane(self, h: usize, w: usize) -> Self {
        Shape([self.0[0], self.0[1], h, w])
    }

    /// The same shape with another size of one axis (0 to 3 for n, c, h, w).
    pub const fn with_axis(self, axis: usize, size: usize) -> Self {
        let mut sizes = self.0;
        sizes[axis] = size;
        Shape(sizes)
    }

    /// Indices `[n, c, h, w]` of the element at a position in the row-major buffer.
    pub const fn unravel(self, position: usize) -> [usize; 4] {
        let [_, c, h, w] = self.0;
        [position / (c * h * w), position / (h * w) % c, position / w % h, position % w]
    }

    /// Position of an element in the row-major buffer.
    pub const fn index(self, n: usize, c: usize, h: usize, w: usize) -> usize {
        ((n * self.0[1] + c) * self.0[2] + h) * self.0[3] + w
    }
}

impl fmt::Debug for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [n, c, h, w] = self.0;
        write!(f, "[{n}, {c}, {h}, {w}]")
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

/// Panics unless two operands have the same shape; `op` names the operation.
#[track_caller]
pub(crate) fn assert_same(op: &str, left: Shape, right: Shape) {
    assert!(
        left == right,
        "{op}: operands must have equal shapes, got {left} and {right}; broadcast_to makes a repetition explicit"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn index_is_row_major() {
        let shape = Shape::new(2, 3, 4, 5);
        assert_eq!(shape.len(), 120);
        assert_eq!(shape.index(0, 0, 0, 1), 1);
        assert_eq!(shape.index(1, 2, 3, 4), 119);
        assert_eq!(format!("{shape}"), "[2, 3, 4, 5]");
        assert_eq!(shape.with_axis(2, 9), Shape::new(2, 3, 9, 5));
    }

    #[test]
    #[should_panic(expected = "add: operands must have equal shapes, got [1, 1, 2, 3] and [1, 1, 3, 2]")]
    fn unequal_shapes_are_named() {
        assert_same("add", Shape::new(1, 1, 2, 3), Shape::new(1, 1, 3, 2));
    }
}
