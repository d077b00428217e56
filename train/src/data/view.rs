//! A picture together with its camera: whatever changes the pixels changes the intrinsics.

use dimode_geometry::Intrinsics;

use super::resample::{resize_image, resize_map_nearest};
use super::{Image, Map};

/// An image, the camera in pixels of that image, and its depth where known; all of one size.
#[derive(Clone, Debug)]
pub struct View {
    /// The picture.
    pub image: Image,
    /// The camera in pixels of the picture.
    pub intrinsics: Intrinsics,
    /// Depth in metres, 0 unknown.
    pub depth: Option<Map>,
}

impl View {
    /// A view from parts of one size.
    ///
    /// **Panics** when the sizes differ.
    #[track_caller]
    pub fn new(image: Image, intrinsics: Intrinsics, depth: Option<Map>) -> Self {
        let size = (image.width, image.height);
        let camera = (intrinsics.width, intrinsics.height);
        assert_eq!(size, camera, "View::new: (width, height) of the image and of the intrinsics");
        if let Some(map) = &depth {
            assert_eq!(size, (map.width, map.height), "View::new: (width, height) of the image and of the depth");
        }
        Self { image, intrinsics, depth }
    }

    /// The view at a new size: colours antialiased, depth nearest (its metres do not change), intrinsics scaled.
    ///
    /// **Panics** when the new size is empty.
    #[track_caller]
    pub fn resize(&self, width: usize, height: usize) -> Self {
        Self {
            image: resize_image(&self.image, width, height),
            intrinsics: self.intrinsics.resized(width, height),
            depth: self.depth.as_ref().map(|map| resize_map_nearest(map, width, height)),
        }
    }

    /// The window of `width` x `height` pixels whose first pixel is (column `x0`, row `y0`).
    ///
    /// **Panics** when the window is empty or leaves the image.
    #[track_caller]
    pub fn crop(&self, x0: usize, y0: usize, width: usize, height: usize) -> Self {
        let (old_width, old_height) = (self.image.width, self.image.height);
        assert!(
            width > 0 && height > 0 && x0 + width <= old_width && y0 + height <= old_height,
            "View::crop: {width}x{height} at ({x0}, {y0}) of {old_width}x{old_height}"
        );
        let rows = |plane: &[f32]| window(plane, old_width, [x0, y0, width, height]);
        let data = (0..self.image.channels).flat_map(|c| rows(self.image.plane(c))).collect();
        Self {
            image: Image::from_vec(self.image.channels, height, width, data),
            intrinsics: self.intrinsics.cropped(x0, y0, width, height),
            depth: self.depth.as_ref().map(|map| Map::from_vec(height, width, rows(&map.data))),
        }
    }

    /// The largest centred window with the shape (width to height) of the given size.
    ///
    /// **Panics** when the size is empty.
    #[track_caller]
    pub fn center_crop_to_shape(&self, width: usize, height: usize) -> Self {
        let (x0, y0, w, h) = center_window(self.image.width, self.image.height, width, height);
        self.crop(x0, y0, w, h)
    }

    /// The mirror image: u becomes W - 1 - u, and so does the principal point.
    pub fn flip_horizontal(&self) -> Self {
        let image = &self.image;
        let data = image.data.chunks_exact(image.width).flat_map(|row| row.iter().rev()).copied().collect();
        Self {
            image: Image::from_vec(image.channels, image.height, image.width, data),
            intrinsics: self.intrinsics.flipped_horizontal(),
            depth: self.depth.as_ref().map(Map::flip_horizontal),
        }
    }
}

/// The part of a map in the largest centred window with the shape (width to height) of the given size, as
/// [`View::center_crop_to_shape`] cuts it.
///
/// **Panics** when the size is empty.
#[track_caller]
pub fn crop_map_to_shape(map: &Map, width: usize, height: usize) -> Map {
    let (x0, y0, w, h) = center_window(map.width, map.height, width, height);
    Map::from_vec(h, w, window(&map.data, map.width, [x0, y0, w, h]))
}

/// The window of a plane, row by row.
fn window(plane: &[f32], old_width: usize, [x0, y0, width, height]: [usize; 4]) -> Vec<f32> {
    (y0..y0 + height).flat_map(|v| &plane[v * old_width + x0..][..width]).copied().collect()
}

/// (x0, y0, width, height) of the largest centred window of an image with the shape of another size.
#[track_caller]
fn center_window(width: usize, height: usize, like_width: usize, like_height: usize) -> (usize, usize, usize, usize) {
    assert!(like_width > 0 && like_height > 0, "center_crop_to_shape: shape {like_width}x{like_height}");
    let part = |whole: usize, numerator: usize, denominator: usize| ((whole * numerator + denominator / 2) / denominator).max(1);
    if width * like_height > height * like_width {
        let narrow = part(height, like_width, like_height).min(width);
        ((width - narrow) / 2, 0, narrow, height)
    } else {
        let low = part(width, like_height, like_width).min(height);
        (0, (height - low) / 2, width, low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn view(width: usize, height: usize) -> View {
        let camera =
            Intrinsics::new(0.8 * width as f64, 0.9 * width as f64, 0.47 * width as f64, 0.55 * height as f64, width, height);
        let image = Image::from_fn(3, height, width, |c, v, u| (c as f32 + u as f32 + 1000.0 * v as f32) * 1e-5);
        let depth = Map::from_vec(height, width, (0..width * height).map(|i| i as f32).collect());
        View::new(image, camera.unwrap(), Some(depth))
    }

    #[test]
    fn crop_moves_pixels_and_principal_point_together() {
        let (old, new) = (view(20, 10), view(20, 10).crop(3, 2, 11, 7));
        assert_eq!((new.image.width, new.image.height, new.intrinsics.width), (11, 7, 11));
        assert_eq!(new.image.at(2, 4, 5), old.image.at(2, 6, 8));
        assert_eq!(new.depth.unwrap().at(4, 5), old.depth.unwrap().at(6, 8));
        assert_eq!(new.intrinsics.u0, old.intrinsics.u0 - 3.0);
    }

    #[test]
    fn flip_mirrors_pixels_and_principal_point_and_twice_is_nothing() {
        let (old, new) = (view(21, 10), view(21, 10).flip_horizontal());
        assert_eq!(new.image.at(1, 4, 3), old.image.at(1, 4, 17));
        assert_eq!(new.depth.as_ref().unwrap().at(4, 3), old.depth.as_ref().unwrap().at(4, 17));
        assert_eq!(new.intrinsics.u0, 20.0 - old.intrinsics.u0);
        let back = new.flip_horizontal();
        assert_eq!(back.image, old.image);
        assert!((back.intrinsics.u0 - old.intrinsics.u0).abs() < 1e-12);
    }

    #[test]
    fn a_point_keeps_its_colour_under_every_change() {
        // The image is a ramp, so the colour at a projected point tells where in the old image it lies.
        let old = view(120, 80);
        let colour = |view: &View, point: Vector3<f64>| {
            let p = view.intrinsics.project(&point).unwrap();
            let (u, v) = (p.x.floor() as usize, p.y.floor() as usize);
            let (a, b) = ((p.x - u as f64) as f32, (p.y - v as f64) as f32);
            let row = |v| view.image.at(0, v, u) * (1.0 - a) + view.image.at(0, v, u + 1) * a;
            row(v) * (1.0 - b) + row(v + 1) * b
        };
        let point = Vector3::new(0.13, -0.11, 1.0);
        let mirrored = Vector3::new(-0.13, -0.11, 1.0);
        let expected = colour(&old, point);
        let near = |value: f32| (value - expected).abs() < 1e-4;
        assert!(near(colour(&old.resize(75, 61), point)));
        assert!(near(colour(&old.resize(201, 90), point)));
        assert!(near(colour(&old.crop(20, 10, 90, 60), point)));
        assert!(near(colour(&old.center_crop_to_shape(2, 2).resize(50, 50), point)));
        assert!(near(colour(&old.flip_horizontal(), mirrored)));
    }

    #[test]
    fn center_windows_have_the_wanted_shape() {
        assert_eq!(center_window(1226, 370, 128, 64), (243, 0, 740, 370));
        assert_eq!(center_window(100, 100, 128, 64), (0, 25, 100, 50));
        assert_eq!(center_window(128, 64, 128, 64), (0, 0, 128, 64));
        assert_eq!(center_window(5, 3, 1000, 1), (0, 1, 5, 1));
    }

    #[test]
    #[should_panic(expected = "View::crop: 5x5 at (18, 0) of 20x10")]
    fn a_window_outside_is_a_programming_error() {
        let _ = view(20, 10).crop(18, 0, 5, 5);
    }
}
