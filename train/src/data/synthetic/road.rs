//! The ground of a street world: a road that bends with the drive, with markings, kerbs, pavements and open ground.
//!
//! A grid holds, for every point near the drive, the signed distance to it (positive to the right) and the length along it.
//! Both are interpolated linearly, and their gradients turn the pixel footprint into road coordinates.

use nalgebra::Vector2;

use super::material::{self, Grain};
use super::random::Draw;
use super::texture::{Footprint, Material, NoiseTable, Octave, add_octaves, blend, pulse, step};

/// Metres between grid points.
const CELL: f64 = 1.0;
/// Metres from the drive up to which road coordinates exist.
const REACH: f64 = 14.0;

/// A point of the drive on the ground plane.
#[derive(Clone, Copy, Debug)]
pub struct PathPoint {
    /// World (x, z), metres.
    pub position: Vector2<f64>,
    /// Direction of travel, radians from +z towards +x.
    pub heading: f64,
    /// Metres travelled from the first point.
    pub arc: f64,
}

impl PathPoint {
    /// Unit vector of travel.
    pub fn forward(&self) -> Vector2<f64> {
        Vector2::new(self.heading.sin(), self.heading.cos())
    }

    /// Unit vector to the right of travel.
    pub fn right(&self) -> Vector2<f64> {
        Vector2::new(self.heading.cos(), -self.heading.sin())
    }
}

/// Signed distance and length along the drive on a grid.
struct RoadField {
    origin: Vector2<f64>,
    columns: usize,
    rows: usize,
    /// (distance, length) at the grid points; the distance is huge out of reach.
    values: Vec<[f32; 2]>,
}

impl RoadField {
    fn new(path: &[PathPoint]) -> Self {
        let corner = |pick: fn(f64, f64) -> f64, start: f64| {
            path.iter().fold(Vector2::repeat(start), |acc, p| acc.zip_map(&p.position, pick))
        };
        let low = corner(f64::min, f64::INFINITY) - Vector2::repeat(REACH + CELL);
        let high = corner(f64::max, f64::NEG_INFINITY) + Vector2::repeat(REACH + CELL);
        let size = ((high - low) / CELL).map(|x| x.ceil() as usize + 1);
        let mut field = Self { origin: low, columns: size.x, rows: size.y, values: vec![[1e6, 0.0]; size.x * size.y] };
        let mut nearest = vec![f64::INFINITY; size.x * size.y];
        for pair in path.windows(2) {
            field.add_segment(&pair[0], &pair[1], &mut nearest);
        }
        field
    }

    fn add_segment(&mut self, a: &PathPoint, b: &PathPoint, nearest: &mut [f64]) {
        let along = b.position - a.position;
        let length = along.norm().max(1e-9);
        let (along, right) = (along / length, Vector2::new(along.y, -along.x) / length);
        let bound = |x: f64, limit: usize| (x.max(0.0) as usize).min(limit - 1);
        let low = (a.position - self.origin) / CELL - Vector2::repeat(REACH / CELL);
        let high = (a.position - self.origin) / CELL + Vector2::repeat(REACH / CELL);
        for j in bound(low.y, self.rows)..=bound(high.y, self.rows) {
            for i in bound(low.x, self.columns)..=bound(high.x, self.columns) {
                let p = self.origin + CELL * Vector2::new(i as f64, j as f64) - a.position;
                let s = p.dot(&along);
                let distance = (p - along * s.clamp(0.0, length)).norm();
                let index = j * self.columns + i;
                if distance < nearest[index] {
                    nearest[index] = distance;
                    let signed = distance * p.dot(&right).signum();
                    self.values[index] = [signed as f32, (a.arc + s.clamp(0.0, length)) as f32];
                }
            }
        }
    }

    /// (distance, length) and their gradients along world x and z, or `None` out of reach.
    #[inline(always)]
    fn at(&self, x: f32, z: f32) -> Option<([f32; 2], [[f32; 2]; 2])> {
        let gx = (x - self.origin.x as f32) / CELL as f32;
        let gz = (z - self.origin.y as f32) / CELL as f32;
        if !(gx >= 0.0 && gz >= 0.0) {
            return None;
        }
        let (i, j) = (gx as usize, gz as usize);
        if i + 1 >= self.columns || j + 1 >= self.rows {
            return None;
        }
        let (fx, fz) = (gx - i as f32, gz - j as f32);
        let row = |j: usize| [self.values[j * self.columns + i], self.values[j * self.columns + i + 1]];
        let ([a, b], [c, d]) = (row(j), row(j + 1));
        if a[0].abs().max(b[0].abs()).max(c[0].abs()).max(d[0].abs()) > REACH as f32 {
            return None;
        }
        let mut value = [0.0; 2];
        let mut gradient = [[0.0; 2]; 2];
        for k in 0..2 {
            let (near, far) = (a[k] + fx * (b[k] - a[k]), c[k] + fx * (d[k] - c[k]));
            value[k] = near + fz * (far - near);
            let slope_x = b[k] - a[k] + fz * (d[k] - c[k] - b[k] + a[k]);
            gradient[k] = [slope_x / CELL as f32, (far - near) / CELL as f32];
        }
        Some((value, gradient))
    }
}

/// The road surface and what lies beside it.
pub struct Road {
    field: RoadField,
    /// Left and right edge of the carriageway as signed distances.
    pub edges: [f32; 2],
    /// Width of the pavements.
    pub pavement: f32,
    asphalt: [f32; 3],
    asphalt_octaves: Vec<Octave>,
    slabs: Material,
    marking: [f32; 3],
    dash: [f32; 2],
    open: Material,
}

impl Road {
    /// A random road along a drive; `centre` is the signed distance of the centre line, `half` half the carriageway.
    pub fn new(draw: &mut Draw, path: &[PathPoint], centre: f64, half: f64, pavement: f64) -> Self {
        let grey = material::colour(draw, 0.3, 0.5, 0.06);
        let mut octaves = Grain::new(1.6, 0.12, 0.085).octaves(draw);
        octaves.extend(Grain::new(0.9, 0.1, 0.085).stretched(1.0, 5.0).octaves(draw));
        octaves.extend(Grain::new(0.8, 0.2, 0.06).stretched(1.0, 20.0).octaves(draw));
        octaves.extend(Grain::new(0.8, 0.3, 0.06).stretched(6.0, 1.0).octaves(draw));
        for octave in &mut octaves {
            let mean = octave.tint.iter().sum::<f32>() / 3.0;
            octave.tint = octave.tint.map(|c| mean + 0.4 * (c - mean));
        }
        Self {
            field: RoadField::new(path),
            edges: [(centre - half) as f32, (centre + half) as f32],
            pavement: pavement as f32,
            asphalt: grey,
            asphalt_octaves: octaves,
            slabs: material::paving(draw),
            marking: [0.85, 0.85, draw.range(0.5, 0.85) as f32],
            dash: [draw.range(3.0, 8.0) as f32, draw.range(0.3, 0.6) as f32],
            open: material::open_ground(draw),
        }
    }

    /// Albedo of the ground at world (x, z); the footprint is in world coordinates.
    pub fn albedo(&self, table: &NoiseTable, [x, z]: [f32; 2], footprint: &Footprint) -> [f32; 3] {
        let Some(([lateral, arc], gradient)) = self.field.at(x, z) else {
            return self.open.albedo(table, [x, z], footprint);
        };
        let turn = |g: [f32; 2]| [0, 1].map(|k| g[0] * footprint.u[k] + g[1] * footprint.v[k]);
        let local = Footprint { u: turn(gradient[0]), v: turn(gradient[1]) };
        let width = local.width_u();
        let [left, right] = self.edges;
        let on_road = step(left, lateral, width) - step(right, lateral, width);
        let outer = step(left - self.pavement, lateral, width) - step(right + self.pavement, lateral, width);
        let mut colour = [0.0; 3];
        if outer < 0.999 {
            colour = self.open.albedo(table, [x, z], footprint);
        }
        if outer > 0.001 && on_road < 0.999 {
            let slabs = self.slabs.albedo(table, [lateral, arc], &local);
            colour = blend(colour, slabs, outer);
        }
        if on_road > 0.001 {
            colour = blend(colour, self.carriageway(table, [lateral, arc], &local, width), on_road);
        }
        let kerb = |edge: f32| step(edge - 0.12, lateral, width) - step(edge + 0.12, lateral, width);
        blend(colour, [0.62, 0.6, 0.57], 0.8 * (kerb(left) + kerb(right)))
    }

    /// Asphalt with lane markings.
    fn carriageway(&self, table: &NoiseTable, at: [f32; 2], local: &Footprint, width: f32) -> [f32; 3] {
        let colour = add_octaves(self.asphalt, &self.asphalt_octaves, table, at, local);
        let line = |centre: f32, half: f32| step(centre - half, at[0], width) - step(centre + half, at[0], width);
        let [left, right] = self.edges;
        let [period, duty] = self.dash;
        let dashes = pulse(at[1] / period, duty, local.width_v() / period);
        let paint = line(0.5 * (left + right), 0.09) * dashes + line(left + 0.4, 0.07) + line(right - 0.4, 0.07);
        blend(colour, self.marking, 0.85 * paint.min(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A circle of radius 20 m driven to the right.
    fn bend() -> Vec<PathPoint> {
        (0..80)
            .map(|i| {
                let heading = 0.02 * i as f64;
                let position = 20.0 * Vector2::new(1.0 - heading.cos(), heading.sin());
                let arc = 0.4 * i as f64;
                PathPoint { position, heading, arc }
            })
            .collect()
    }

    #[test]
    fn field_holds_distance_and_length_of_a_bend() {
        let field = RoadField::new(&bend());
        let angle = 0.5f64;
        for lateral in [-5.0, -1.0, 0.0, 2.0, 6.0] {
            let radius = 20.0 - lateral;
            let (x, z) = (20.0 - radius * angle.cos(), radius * angle.sin());
            let ([d, s], _) = field.at(x as f32, z as f32).unwrap();
            assert!((f64::from(d) - lateral).abs() < 0.05, "{d} {lateral}");
            assert!((f64::from(s) - 20.0 * angle).abs() < 0.15, "{s}");
        }
        assert!(field.at(-200.0, 0.0).is_none());
        assert!(field.at(19.0, 60.0).is_none());
    }

    #[test]
    fn gradient_of_the_distance_is_a_unit_vector() {
        let field = RoadField::new(&bend());
        let (_, [g, _]) = field.at(1.3, 7.2).unwrap();
        assert!(((g[0] * g[0] + g[1] * g[1]).sqrt() - 1.0).abs() < 0.02);
    }
}
