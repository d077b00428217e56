//! Ray casting from the camera: faces as linear forms of the ray, found by tile.
//!
//! With the camera at the origin and the ray b = (x, y, 1), a point at depth z is z b. For a face, 1/z, s/z and t/z are linear
//! in b, so the test needs no division: the ray hits when 1/z > 0 and 0 <= s/z, t/z <= 1/z (for a triangle s/z + t/z <= 1/z),
//! and the nearest face has the largest 1/z.

use dimode_geometry::{Intrinsics, Se3};
use nalgebra::Vector3;

use super::face::Face;
use super::world::World;

/// Nearest depth that is seen, metres.
const NEAR: f64 = 0.05;
/// Pixels a tile side.
const TILE: usize = 16;

/// A face as seen from one camera. Forms `f` stand for `f[0] x + f[1] y + f[2]`.
pub struct ViewFace {
    /// 1/z.
    pub inverse_depth: [f32; 3],
    /// s/z and t/z.
    pub coordinates: [[f32; 3]; 2],
    /// Largest s + t.
    pub limit: f32,
    /// 1/z in double precision.
    pub inverse_depth_exact: [f64; 3],
    /// Pixels that can see the face: first column, last column, first row, last row.
    pub bounds: [usize; 4],
    /// Largest 1/z of the visible part.
    pub nearest: f32,
    /// Number of the face in the world.
    pub face: usize,
}

/// A form at (x, y).
#[inline(always)]
pub fn form(f: &[f32; 3], x: f32, y: f32) -> f32 {
    f[0] * x + (f[1] * y + f[2])
}

/// A world as seen from one camera.
pub struct View {
    /// The camera.
    pub intrinsics: Intrinsics,
    /// The faces that may be seen.
    pub faces: Vec<ViewFace>,
    tile_columns: usize,
    /// Where the list of each tile starts in `tile_faces`; one more entry than tiles.
    tile_starts: Vec<u32>,
    tile_faces: Vec<u32>,
}

/// The nearest face along a ray.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Index into [`View::faces`].
    pub index: usize,
    /// Depth along the optical axis, metres.
    pub depth: f64,
}

impl View {
    /// What the camera of `frame` may see.
    pub fn new(world: &World, frame: usize, intrinsics: &Intrinsics) -> Self {
        let transforms = world.camera_from(frame);
        let mut faces: Vec<ViewFace> = world
            .faces
            .iter()
            .enumerate()
            .filter_map(|(i, face)| view_face(face, i, &transforms[usize::from(face.moving)], intrinsics))
            .collect();
        // Near faces first: a search can stop once all faces left lie farther than what was found.
        faces.sort_by(|a, b| b.nearest.total_cmp(&a.nearest));
        let mut view = Self {
            intrinsics: *intrinsics,
            faces,
            tile_columns: intrinsics.width.div_ceil(TILE),
            tile_starts: Vec::new(),
            tile_faces: Vec::new(),
        };
        view.fill_tiles();
        view
    }

    /// Lists the faces of each tile.
    fn fill_tiles(&mut self) {
        let columns = self.tile_columns;
        let tiles = columns * self.intrinsics.height.div_ceil(TILE);
        let tiles_of = |face: &ViewFace| {
            let [u0, u1, v0, v1] = face.bounds.map(|x| x / TILE);
            (v0..=v1).flat_map(move |v| (u0..=u1).map(move |u| v * columns + u))
        };
        let mut starts = vec![0u32; tiles + 1];
        for face in &self.faces {
            tiles_of(face).for_each(|tile| starts[tile + 1] += 1);
        }
        for tile in 0..tiles {
            starts[tile + 1] += starts[tile];
        }
        let mut next = starts.clone();
        let mut list = vec![0u32; starts[tiles] as usize];
        for (index, face) in self.faces.iter().enumerate() {
            for tile in tiles_of(face) {
                list[next[tile] as usize] = index as u32;
                next[tile] += 1;
            }
        }
        self.tile_starts = starts;
        self.tile_faces = list;
    }

    /// The ray coordinates (x, y) of a column or row: single precision of the exact value.
    #[inline(always)]
    pub fn ray_x(&self, u: f64) -> f32 {
        ((u - self.intrinsics.u0) / self.intrinsics.fu) as f32
    }

    /// See [`View::ray_x`].
    #[inline(always)]
    pub fn ray_y(&self, v: f64) -> f32 {
        ((v - self.intrinsics.v0) / self.intrinsics.fv) as f32
    }

    /// Depth of the plane of a face along the ray of a pixel, double precision.
    #[inline(always)]
    pub fn depth(&self, index: usize, u: f64, v: f64) -> f64 {
        let [a, b, c] = self.faces[index].inverse_depth_exact;
        let k = &self.intrinsics;
        1.0 / (a * (u - k.u0) / k.fu + b * (v - k.v0) / k.fv + c)
    }

    /// Casts a ray through pixel (u, v), which lies in the image: the nearest face, `None` for the sky.
    pub fn cast(&self, u: f64, v: f64) -> Option<Hit> {
        let column = (u.max(0.0) as usize).min(self.intrinsics.width - 1) / TILE;
        let row = (v.max(0.0) as usize).min(self.intrinsics.height - 1) / TILE;
        let tile = row * self.tile_columns + column;
        let list = &self.tile_faces[self.tile_starts[tile] as usize..self.tile_starts[tile + 1] as usize];
        let (x, y) = (self.ray_x(u), self.ray_y(v));
        let (mut best, mut found) = (0.0f32, usize::MAX);
        for &index in list {
            let face = &self.faces[index as usize];
            if face.nearest < best {
                break;
            }
            let inverse = form(&face.inverse_depth, x, y);
            let s = form(&face.coordinates[0], x, y);
            let t = form(&face.coordinates[1], x, y);
            let inside = s >= 0.0 && t >= 0.0 && s <= inverse && t <= inverse && s + t <= face.limit * inverse;
            if inverse > best && inside {
                (best, found) = (inverse, index as usize);
            }
        }
        (found != usize::MAX).then(|| Hit { index: found, depth: self.depth(found, u, v) })
    }
}

/// A face in the frame of the camera, `None` when it cannot be seen.
fn view_face(face: &Face, number: usize, camera_from: &Se3, intrinsics: &Intrinsics) -> Option<ViewFace> {
    let origin = camera_from.transform(&face.origin);
    let normal = camera_from.rotation * face.normal;
    let distance = normal.dot(&origin);
    if distance > -1e-6 {
        return None;
    }
    let (edge_s, edge_t) = (camera_from.rotation * face.edge_s, camera_from.rotation * face.edge_t);
    let (bounds, nearest) = bounds(&origin, &edge_s, &edge_t, face.limit, intrinsics)?;
    let inverse_depth = normal / distance;
    let cross = edge_s.cross(&edge_t);
    let dual = |axis: Vector3<f64>| axis - axis.dot(&origin) * inverse_depth;
    let s = dual(edge_t.cross(&cross) / edge_s.dot(&edge_t.cross(&cross)));
    let t = dual(cross.cross(&edge_s) / edge_t.dot(&cross.cross(&edge_s)));
    let single = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
    Some(ViewFace {
        inverse_depth: single(inverse_depth),
        coordinates: [single(s), single(t)],
        limit: face.limit as f32,
        inverse_depth_exact: [inverse_depth.x, inverse_depth.y, inverse_depth.z],
        bounds,
        // A little more than the exact value, for rounding.
        nearest: (1.0001 / nearest) as f32,
        face: number,
    })
}

/// Smallest and largest column and row of the part of a polygon that lies beyond [`NEAR`].
fn extent(corners: &[Vector3<f64>; 4], k: &Intrinsics) -> ([f64; 2], [f64; 2]) {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut include = |p: &Vector3<f64>| {
        for (axis, x) in [k.fu * p.x / p.z + k.u0, k.fv * p.y / p.z + k.v0].into_iter().enumerate() {
            low[axis] = low[axis].min(x);
            high[axis] = high[axis].max(x);
        }
    };
    for i in 0..4 {
        let (p, q) = (&corners[i], &corners[(i + 1) % 4]);
        if p.z >= NEAR {
            include(p);
        }
        if (p.z < NEAR) != (q.z < NEAR) {
            include(&(p + (q - p) * ((NEAR - p.z) / (q.z - p.z))));
        }
    }
    (low, high)
}

/// The pixels that a face can cover, with one pixel to spare, and its smallest depth; `None` when outside the image.
fn bounds(
    origin: &Vector3<f64>,
    edge_s: &Vector3<f64>,
    edge_t: &Vector3<f64>,
    limit: f64,
    k: &Intrinsics,
) -> Option<([usize; 4], f64)> {
    let (b, d) = (origin + edge_s, origin + edge_t);
    let c = if limit < 1.5 { d } else { b + edge_t };
    let corners = [*origin, b, c, d];
    if corners.iter().all(|p| p.z < NEAR) {
        return None;
    }
    let (low, high) = extent(&corners, k);
    let size = [k.width as f64, k.height as f64];
    if (0..2).any(|a| high[a] < -1.0 || low[a] > size[a]) {
        return None;
    }
    let first = |a: usize| (low[a] - 1.0).max(0.0) as usize;
    let last = |a: usize| (high[a] + 1.0).clamp(0.0, size[a] - 1.0) as usize;
    let nearest = corners.iter().map(|p| p.z).fold(f64::INFINITY, f64::min).max(NEAR);
    Some(([first(0).min(k.width - 1), last(0), first(1).min(k.height - 1), last(1)], nearest))
}
