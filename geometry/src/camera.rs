//! Pinhole camera without skew.
//!
//! Camera axes: x right, y down, z forward. Pixel centres are integers, `u` counts columns and
//! `v` rows, so the first pixel covers `[-0.5, 0.5]`.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::error::GeometryError;

/// Calibration of one camera at one image size, all in pixels (eq. `intrinsic_matrix`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal length along a row, pixels.
    pub fu: f64,
    /// Focal length along a column, pixels.
    pub fv: f64,
    /// Column of the principal point.
    pub u0: f64,
    /// Row of the principal point.
    pub v0: f64,
    /// Columns of the image the numbers belong to.
    pub width: usize,
    /// Rows of the image the numbers belong to.
    pub height: usize,
}

impl Intrinsics {
    /// Checks and stores a calibration.
    ///
    /// # Errors
    /// [`GeometryError::Intrinsics`] when a focal length is not finite and positive, the principal
    /// point is not finite, or the image is empty.
    pub fn new(fu: f64, fv: f64, u0: f64, v0: f64, width: usize, height: usize) -> Result<Self, GeometryError> {
        let reject = |field, value, requirement| Err(GeometryError::Intrinsics { field, value, requirement });
        for (field, value) in [("fu", fu), ("fv", fv)] {
            if !(value.is_finite() && value > 0.0) {
                return reject(field, value, "a focal length is finite and positive");
            }
        }
        for (field, value) in [("u0", u0), ("v0", v0)] {
            if !value.is_finite() {
                return reject(field, value, "the principal point is finite");
            }
        }
        for (field, value) in [("width", width), ("height", height)] {
            if value == 0 {
                return reject(field, 0.0, "the image has at least one pixel");
            }
        }
        Ok(Self { fu, fv, u0, v0, width, height })
    }

    /// Viewing ray `K^-1 (u, v, 1)`: direction with third component 1, camera frame.
    #[must_use]
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        Vector3::new((u - self.u0) / self.fu, (v - self.v0) / self.fv, 1.0)
    }

    /// Pixel of a camera-frame point; `None` unless the point lies in front of the camera.
    #[must_use]
    pub fn project(&self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        (point.z > 0.0).then(|| Vector2::new(self.fu * point.x / point.z + self.u0, self.fv * point.y / point.z + self.v0))
    }

    /// The matrix `K`.
    #[must_use]
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fu, 0.0, self.u0, 0.0, self.fv, self.v0, 0.0, 0.0, 1.0)
    }

    /// The matrix `K^-1`.
    #[must_use]
    pub fn inverse_matrix(&self) -> Matrix3<f64> {
        Matrix3::new(1.0 / self.fu, 0.0, -self.u0 / self.fu, 0.0, 1.0 / self.fv, -self.v0 / self.fv, 0.0, 0.0, 1.0)
    }

    /// Principal point in pixels.
    #[must_use]
    pub fn principal_point(&self) -> Vector2<f64> {
        Vector2::new(self.u0, self.v0)
    }

    /// The camera after the image was resampled to `width` x `height`.
    ///
    /// The outer image borders stay where they are, hence the half-pixel terms of the centre.
    ///
    /// # Panics
    /// When a size is zero.
    #[must_use]
    #[track_caller]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        assert!(width > 0 && height > 0, "Intrinsics::resized: target size {width}x{height} is empty");
        let su = width as f64 / self.width as f64;
        let sv = height as f64 / self.height as f64;
        Self { fu: self.fu * su, fv: self.fv * sv, u0: (self.u0 + 0.5) * su - 0.5, v0: (self.v0 + 0.5) * sv - 0.5, width, height }
    }

    /// The camera after cutting out the window with first pixel (`x0`, `y0`).
    ///
    /// # Panics
    /// When the window is empty or leaves the image.
    #[must_use]
    #[track_caller]
    pub fn cropped(&self, x0: usize, y0: usize, width: usize, height: usize) -> Self {
        assert!(
            width > 0 && height > 0 && x0 + width <= self.width && y0 + height <= self.height,
            "Intrinsics::cropped: window {width}x{height} at ({x0}, {y0}) does not fit {}x{}",
            self.width,
            self.height
        );
        Self { u0: self.u0 - x0 as f64, v0: self.v0 - y0 as f64, width, height, ..*self }
    }

    /// The camera after mirroring the columns: `u0` becomes `W - 1 - u0`.
    #[must_use]
    pub fn flipped_horizontal(&self) -> Self {
        Self { u0: self.width as f64 - 1.0 - self.u0, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kitti() -> Intrinsics {
        Intrinsics::new(371.2, 368.64, 320.0, 96.0, 640, 192).unwrap()
    }

    #[test]
    fn ray_matches_reference_value() {
        let ray = kitti().ray(451.0, 63.0);
        assert!((ray.x - 0.352909482759).abs() < 1e-12);
        assert!((ray.y + 0.0895182291667).abs() < 1e-12);
        assert_eq!(ray.z, 1.0);
    }

    #[test]
    fn matrix_times_inverse_is_identity() {
        let k = kitti();
        let product = k.matrix() * k.inverse_matrix();
        assert!((product - Matrix3::identity()).abs().max() < 1e-12);
    }

    #[test]
    fn projection_undoes_the_ray_and_refuses_points_behind() {
        let k = kitti();
        let p = k.project(&(k.ray(12.25, 170.5) * 7.0)).unwrap();
        assert!((p - Vector2::new(12.25, 170.5)).norm() < 1e-10);
        assert!(k.project(&Vector3::new(1.0, 1.0, 0.0)).is_none());
        assert!(k.project(&Vector3::new(1.0, 1.0, -2.0)).is_none());
    }

    #[test]
    fn resize_keeps_the_view_of_the_image_borders() {
        let k = kitti();
        let small = k.resized(320, 64);
        let (full, half) = (k.ray(-0.5, 191.5), small.ray(-0.5, 63.5));
        assert!((full - half).norm() < 1e-12);
    }

    #[test]
    fn crop_shifts_pixels() {
        let k = kitti();
        let crop = k.cropped(10, 20, 100, 50);
        assert!((k.ray(17.0, 29.0) - crop.ray(7.0, 9.0)).norm() < 1e-12);
        assert_eq!((crop.width, crop.height), (100, 50));
    }

    #[test]
    fn flip_mirrors_the_ray_and_is_an_involution() {
        let k = kitti();
        let flipped = k.flipped_horizontal();
        let (a, b) = (k.ray(100.0, 3.0), flipped.ray(539.0, 3.0));
        assert!((a.x + b.x).abs() < 1e-12);
        assert!((flipped.flipped_horizontal().u0 - k.u0).abs() < 1e-12);
    }

    #[test]
    fn bad_calibrations_are_named() {
        for (fu, u0, w) in [(0.0, 1.0, 2), (f64::NAN, 1.0, 2), (1.0, f64::INFINITY, 2), (1.0, 1.0, 0)] {
            assert!(Intrinsics::new(fu, 1.0, u0, 1.0, w, 2).is_err());
        }
        let message = Intrinsics::new(1.0, -3.0, 0.0, 0.0, 2, 2).unwrap_err().to_string();
        assert!(message.contains("fv") && message.contains("-3"), "{message}");
    }
}
