//! Rasters as plain vectors: colour image, scalar map, flow map.

/// An image: planar channel-height-width, colours red, green, blue in [0, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Number of channels (3 for colour).
    pub channels: usize,
    /// Rows in pixels.
    pub height: usize,
    /// Columns in pixels.
    pub width: usize,
    /// `channels * height * width` values, one plane after the other, rows from the top.
    pub data: Vec<f32>,
}

impl Image {
    /// A black image of the given size.
    pub fn zeros(channels: usize, height: usize, width: usize) -> Self {
        Self { channels, height, width, data: vec![0.0; channels * height * width] }
    }

    /// An image from planar values.
    ///
    /// **Panics** when `data` does not have `channels * height * width` values.
    #[track_caller]
    pub fn from_vec(channels: usize, height: usize, width: usize, data: Vec<f32>) -> Self {
        let expected = channels * height * width;
        assert_eq!(data.len(), expected, "Image::from_vec: {channels}x{height}x{width} needs {expected} values");
        Self { channels, height, width, data }
    }

    /// An image from a function of (channel, row, column).
    pub fn from_fn(channels: usize, height: usize, width: usize, f: impl Fn(usize, usize, usize) -> f32) -> Self {
        let mut data = Vec::with_capacity(channels * height * width);
        for c in 0..channels {
            for v in 0..height {
                data.extend((0..width).map(|u| f(c, v, u)));
            }
        }
        Self { channels, height, width, data }
    }

    /// Pixels of one plane: `height * width`.
    pub fn plane_len(&self) -> usize {
        self.height * self.width
    }

    /// One channel, row by row.
    ///
    /// **Panics** when there is no such channel.
    #[track_caller]
    pub fn plane(&self, channel: usize) -> &[f32] {
        let len = self.plane_len();
        &self.data[channel * len..(channel + 1) * len]
    }

    /// The value at (channel, row, column).
    ///
    /// **Panics** outside the image.
    #[track_caller]
    pub fn at(&self, channel: usize, v: usize, u: usize) -> f32 {
        self.plane(channel)[v * self.width + u]
    }
}

/// One number a pixel, row by row from the top; as depth in metres, 0 means unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Rows in pixels.
    pub height: usize,
    /// Columns in pixels.
    pub width: usize,
    /// `height * width` values.
    pub data: Vec<f32>,
}

impl Map {
    /// A map of zeros.
    pub fn zeros(height: usize, width: usize) -> Self {
        Self { height, width, data: vec![0.0; height * width] }
    }

    /// A map from values, row by row.
    ///
    /// **Panics** when `data` does not have `height * width` values.
    #[track_caller]
    pub fn from_vec(height: usize, width: usize, data: Vec<f32>) -> Self {
        assert_eq!(data.len(), height * width, "Map::from_vec: {height}x{width} needs {} values", height * width);
        Self { height, width, data }
    }

    /// The mirror image: the first column becomes the last.
    pub fn flip_horizontal(&self) -> Self {
        let data = self.data.chunks_exact(self.width).flat_map(|row| row.iter().rev()).copied().collect();
        Self { data, ..*self }
    }

    /// The value at (row, column).
    ///
    /// **Panics** outside the map.
    #[track_caller]
    pub fn at(&self, v: usize, u: usize) -> f32 {
        self.data[v * self.width + u]
    }
}

/// A displacement in pixels for each pixel: `u` to the right, `v` down, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowMap {
    /// Rows in pixels.
    pub height: usize,
    /// Columns in pixels.
    pub width: usize,
    /// Horizontal displacements, `height * width` values.
    pub u: Vec<f32>,
    /// Vertical displacements, `height * width` values.
    pub v: Vec<f32>,
}

impl FlowMap {
    /// A flow of zeros.
    pub fn zeros(height: usize, width: usize) -> Self {
        Self { height, width, u: vec![0.0; height * width], v: vec![0.0; height * width] }
    }

    /// Pixels: `height * width`.
    pub fn len(&self) -> usize {
        self.height * self.width
    }

    /// Whether there is no pixel.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_follow_each_other() {
        let image = Image::from_fn(2, 2, 3, |c, v, u| (100 * c + 10 * v + u) as f32);
        assert_eq!(image.plane(1), &[100.0, 101.0, 102.0, 110.0, 111.0, 112.0]);
        assert_eq!(image.at(0, 1, 2), 12.0);
    }

    #[test]
    #[should_panic(expected = "Image::from_vec: 3x2x2 needs 12 values")]
    fn from_vec_refuses_a_wrong_length() {
        Image::from_vec(3, 2, 2, vec![0.0; 4]);
    }
}
