//! Source points from the source depth found at the end of a flow (`D_{s->t}` and `p_s^C`).

use nalgebra::{Vector2, Vector3};

use crate::camera::Intrinsics;

/// Point `p_s^C = D_{s->t}(p_t) K^-1 p~_s` in the source camera's frame.
///
/// **Reading**: `p_s` is homogeneous, and `D_{s->t}` is the source depth read at `p_s`, still measured along the source
/// camera's axis. With exact flow and depth the point is `R P_t + t`.
#[must_use]
pub fn source_point(camera: &Intrinsics, source_pixel: &Vector2<f64>, source_depth: f64) -> Vector3<f64> {
    camera.ray(source_pixel.x, source_pixel.y) * source_depth
}

/// Depths of four neighbouring pixels, and where between them a value is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthCell {
    /// `[row][column]`: upper left, upper right, lower left, lower right.
    pub depths: [[f64; 2]; 2],
    /// Share of the way to the right and down, each in `[0, 1]`.
    pub fraction: Vector2<f64>,
}

impl DepthCell {
    fn bilinear(&self, value: impl Fn(f64) -> f64) -> f64 {
        let (right, down) = (self.fraction.x, self.fraction.y);
        let row = |row: [f64; 2]| value(row[0]) * (1.0 - right) + value(row[1]) * right;
        row(self.depths[0]) * (1.0 - down) + row(self.depths[1]) * down
    }

    /// Bilinear mean of the depths, depth units: what a warp of the depth map reads. Too deep on planes, never too shallow.
    #[must_use]
    pub fn by_depth(&self) -> f64 {
        self.bilinear(|z| z)
    }

    /// Inverse of the bilinear mean of the inverse depths, depth units: exact on planes, whose inverse depth is affine in `u`
    /// and `v`. **Domain**: positive depths.
    #[must_use]
    pub fn by_inverse_depth(&self) -> f64 {
        self.bilinear(f64::recip).recip()
    }
}

/// The plane `1/z = a u + b v + c`, in inverse depth units per pixel: every plane in space that does not hold the camera's centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthPlane {
    /// Slope along a row.
    pub a: f64,
    /// Slope along a column.
    pub b: f64,
    /// Inverse depth at pixel (0, 0).
    pub c: f64,
}

impl InverseDepthPlane {
    /// Depth at a pixel; positive where the plane lies in front of the camera.
    #[must_use]
    pub fn depth(&self, p: &Vector2<f64>) -> f64 {
        (self.a * p.x + self.b * p.y + self.c).recip()
    }

    /// The cell of pixels about `p`.
    #[must_use]
    pub fn cell(&self, p: &Vector2<f64>) -> DepthCell {
        let corner = p.map(f64::floor);
        let at = |u: f64, v: f64| self.depth(&(corner + Vector2::new(u, v)));
        DepthCell { depths: [[at(0.0, 0.0), at(1.0, 0.0)], [at(0.0, 1.0), at(1.0, 1.0)]], fraction: p - corner }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_plane_matches_reference_values() {
        let plane = InverseDepthPlane { a: 0.0, b: 0.001, c: 0.004 };
        let cell = plane.cell(&Vector2::new(7.25, 2.5));
        assert!((cell.by_inverse_depth() - 153.846153846).abs() < 1e-8);
        assert!((cell.by_depth() - 154.761904762).abs() < 1e-8);
    }

    #[test]
    fn whole_pixels_are_read_as_they_are() {
        let plane = InverseDepthPlane { a: 0.001, b: -0.002, c: 0.3 };
        let p = Vector2::new(4.0, 9.0);
        assert!((plane.cell(&p).by_depth() - plane.depth(&p)).abs() < 1e-14);
    }
}
