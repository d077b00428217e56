//! Flat faces, the one primitive of all scenes, and the solids made of them.

use nalgebra::{Matrix3, Vector2, Vector3};

/// A parallelogram or triangle `origin + s edge_s + t edge_t`, `s, t` in [0, 1], for a triangle also `s + t <= 1`.
/// Visible from the side its normal points to.
#[derive(Clone, Debug)]
pub struct Face {
    /// The corner at s = t = 0, metres.
    pub origin: Vector3<f64>,
    /// The edge along s, metres.
    pub edge_s: Vector3<f64>,
    /// The edge along t, metres.
    pub edge_t: Vector3<f64>,
    /// Unit normal, towards the visible side.
    pub normal: Vector3<f64>,
    /// 2 for a parallelogram, 1 for a triangle: the largest `s + t`.
    pub limit: f64,
    /// Texture coordinates in metres at the origin, and what s and t add to them.
    pub texture: [Vector2<f64>; 3],
    /// Number of the material.
    pub material: usize,
    /// Whether the face belongs to the moving object; then its geometry is in the frame of that object.
    pub moving: bool,
}

/// Where a solid stands: a rotation and the world position of its local origin.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// World from local rotation.
    pub rotation: Matrix3<f64>,
    /// World position of the local origin.
    pub position: Vector3<f64>,
}

impl Placement {
    /// Upright, turned by `yaw` (radians, from +z towards +x).
    pub fn upright(position: Vector3<f64>, yaw: f64) -> Self {
        Self { rotation: rotation_y(yaw), position }
    }
}

/// Rotation about the vertical axis that takes +z to (sin a, 0, cos a).
pub fn rotation_y(a: f64) -> Matrix3<f64> {
    let (s, c) = a.sin_cos();
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// A growing list of faces.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// The faces, in the order in which they were added.
    pub faces: Vec<Face>,
}

impl Mesh {
    /// Adds one face whose visible side is the one from which `towards` is seen; `shift` moves its texture.
    #[allow(clippy::too_many_arguments)]
    fn add(
        &mut self,
        origin: Vector3<f64>,
        edge_s: Vector3<f64>,
        edge_t: Vector3<f64>,
        outward: Vector3<f64>,
        limit: f64,
        shift: Vector2<f64>,
        material: usize,
    ) {
        let raw = edge_s.cross(&edge_t);
        let normal = raw.normalize() * raw.dot(&outward).signum();
        let along = edge_s.normalize();
        let across = normal.cross(&along);
        let texture = [shift, Vector2::new(edge_s.norm(), 0.0), Vector2::new(edge_t.dot(&along), edge_t.dot(&across).abs())];
        self.faces.push(Face { origin, edge_s, edge_t, normal, limit, texture, material, moving: false });
    }

    /// A parallelogram seen from the side to which `outward` points.
    pub fn quad(
        &mut self,
        [origin, edge_s, edge_t]: [Vector3<f64>; 3],
        outward: Vector3<f64>,
        shift: Vector2<f64>,
        material: usize,
    ) {
        self.add(origin, edge_s, edge_t, outward, 2.0, shift, material);
    }

    /// A triangle with the given corners, seen from the side to which `outward` points.
    pub fn triangle(&mut self, [a, b, c]: [Vector3<f64>; 3], outward: Vector3<f64>, shift: Vector2<f64>, material: usize) {
        self.add(a, b - a, c - a, outward, 1.0, shift, material);
    }

    /// A box with half sizes `half` around its local origin: four sides and top in `materials[0]` and `materials[1]`, and
    /// the underside as the top when `closed`.
    pub fn solid_box(&mut self, place: &Placement, half: Vector3<f64>, materials: [usize; 2], shift: Vector2<f64>, closed: bool) {
        let axis = |i: usize| place.rotation.column(i).into_owned() * half[i];
        let (x, y, z) = (axis(0), axis(1), axis(2));
        // (outward half axis, edge s, edge t = down where there is a down, material)
        let sides = [
            (-z, x, y, materials[0]),
            (x, z, y, materials[0]),
            (z, -x, y, materials[0]),
            (-x, -z, y, materials[0]),
            (-y, x, z, materials[1]),
            (y, x, z, materials[1]),
        ];
        let count = if closed { 6 } else { 5 };
        for (i, (out, s, t, material)) in sides.into_iter().take(count).enumerate() {
            let corner = place.position + out - s - t;
            let shift = shift + Vector2::new(7.3 * i as f64, 0.0);
            self.quad([corner, 2.0 * s, 2.0 * t], out, shift, material);
        }
    }

    /// An upright prism with `sides` faces around its local y axis, radius `radius`, from y = -height to y = 0.
    pub fn prism(&mut self, place: &Placement, radius: f64, height: f64, sides: usize, material: usize, shift: Vector2<f64>) {
        let up = place.rotation.column(1).into_owned() * -height;
        let rim = |i: usize| {
            let (s, c) = (std::f64::consts::TAU * i as f64 / sides as f64).sin_cos();
            place.position + place.rotation * Vector3::new(radius * s, 0.0, radius * c)
        };
        for i in 0..sides {
            let (a, b) = (rim(i), rim(i + 1));
            let out = 0.5 * (a + b) - place.position;
            let shift = shift + Vector2::new((b - a).norm() * i as f64, 0.0);
            self.quad([a + up, b - a, -up], out, shift, material);
            self.triangle([place.position + up, a + up, b + up], up, shift, material);
            self.triangle([place.position, a, b], -up, shift, material);
        }
    }

    /// An upright cone or pyramid with `sides` faces, base radius `radius` at y = 0, tip at y = -height.
    pub fn cone(&mut self, place: &Placement, radius: f64, height: f64, sides: usize, material: usize, shift: Vector2<f64>) {
        let tip = place.position - place.rotation.column(1).into_owned() * height;
        let rim = |i: usize| {
            let (s, c) = (std::f64::consts::TAU * i as f64 / sides as f64).sin_cos();
            place.position + place.rotation * Vector3::new(radius * s, 0.0, radius * c)
        };
        for i in 0..sides {
            let (a, b) = (rim(i), rim(i + 1));
            let shift = shift + Vector2::new((b - a).norm() * i as f64, 0.0);
            self.triangle([a, b, tip], 0.5 * (a + b) - place.position, shift, material);
            let down = place.position - tip;
            self.triangle([place.position, a, b], down, shift, material);
        }
    }

    /// An ellipsoid of flat triangles around its local origin, half sizes `half`: an octahedron refined `refine` times.
    pub fn ball(&mut self, place: &Placement, half: Vector3<f64>, refine: usize, material: usize, shift: Vector2<f64>) {
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        let mut triangles = Vec::new();
        for (sx, sy, sz) in (0..8).map(|i| (i & 1, i >> 1 & 1, i >> 2 & 1)) {
            let sign = |bit: i32| f64::from(1 - 2 * bit);
            triangles.push([x * sign(sx), y * sign(sy), z * sign(sz)]);
        }
        for _ in 0..refine {
            triangles = triangles.into_iter().flat_map(split_on_sphere).collect();
        }
        // One affine map from local position to texture coordinates for all triangles: no seams between them.
        let texture_of = |p: Vector3<f64>| Vector2::new(p.x + 0.7 * p.z, p.y + 0.7 * p.z);
        for corners in triangles {
            let local = corners.map(|p| p.component_mul(&half));
            let world = local.map(|p| place.position + place.rotation * p);
            let centre = (world[0] + world[1] + world[2]) / 3.0;
            self.triangle(world, centre - place.position, shift, material);
            if let Some(face) = self.faces.last_mut() {
                let [a, b, c] = local.map(texture_of);
                face.texture = [shift + a, b - a, c - a];
            }
        }
    }
}

/// The four triangles between the corners and the edge midpoints of a triangle on the unit sphere.
fn split_on_sphere([a, b, c]: [Vector3<f64>; 3]) -> [[Vector3<f64>; 3]; 4] {
    let mid = |p: Vector3<f64>, q: Vector3<f64>| (p + q).normalize();
    let (ab, bc, ca) = (mid(a, b), mid(b, c), mid(c, a));
    [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solids_are_closed_and_point_outward() {
        let place = Placement::upright(Vector3::new(1.0, 2.0, 3.0), 0.7);
        let shift = Vector2::zeros();
        let mut meshes = [(); 3].map(|()| Mesh::default());
        meshes[0].solid_box(&place, Vector3::new(1.0, 2.0, 0.5), [0, 0], shift, true);
        meshes[1].prism(&place, 0.5, 2.0, 7, 0, shift);
        meshes[2].ball(&place, Vector3::new(1.0, 0.5, 2.0), 2, 0, shift);
        for mesh in meshes {
            let area = |f: &Face| f.edge_s.cross(&f.edge_t).norm() * if f.limit < 1.5 { 0.5 } else { 1.0 };
            let sum: Vector3<f64> = mesh.faces.iter().map(|f| f.normal * area(f)).sum();
            assert!(sum.norm() < 1e-9, "the normals of a closed solid cancel: {sum}");
            let centre = place.position;
            let inward = mesh.faces.iter().filter(|f| (f.origin - centre).dot(&f.normal) < -1e-9);
            assert_eq!(inward.count(), 0);
        }
    }

    #[test]
    fn texture_coordinates_are_metres() {
        let mut mesh = Mesh::default();
        let (s, t) = (Vector3::new(3.0, 0.0, 0.0), Vector3::new(0.0, 4.0, 0.0));
        mesh.quad([Vector3::zeros(), s, t], -Vector3::z(), Vector2::zeros(), 0);
        assert_eq!(mesh.faces[0].texture[1], Vector2::new(3.0, 0.0));
        assert_eq!(mesh.faces[0].texture[2], Vector2::new(0.0, 4.0));
        assert_eq!(mesh.faces[0].normal, -Vector3::z());
    }
}
