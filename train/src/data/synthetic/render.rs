//! One frame: which face each sample sees, its colour, and the exact depth of each pixel.
//!
//! Samples lie on a grid of half a pixel. A pixel is the mean of the 3x3 samples around its centre with weights 1 2 1 along
//! each axis, so that silhouettes are smooth. Textures are band-limited for a whole pixel: the samples of a pixel that see one
//! face share one colour.

use super::raycast::{View, ViewFace, form};
use super::texture::{Footprint, blend};
use super::world::{Surface, World};
use crate::data::{Image, Map};

/// Marks a sample that sees the sky.
const SKY: u32 = u32::MAX;

/// For each sample of the half-pixel grid, the face it sees.
struct Samples {
    columns: usize,
    seen: Vec<u32>,
}

/// A frame as rendered, before exposure and noise.
pub struct Rendered {
    /// Colours in [0, 1].
    pub image: Image,
    /// Depth at the pixel centres, 0 for the sky.
    pub depth: Map,
}

impl Samples {
    /// The nearest face for every sample. Sample (i, j) lies at pixel (i/2 - 1/2, j/2 - 1/2).
    fn new(view: &View) -> Self {
        let (width, height) = (view.intrinsics.width, view.intrinsics.height);
        let (columns, rows) = (2 * width + 1, 2 * height + 1);
        let place = |i: usize| 0.5 * i as f64 - 0.5;
        let xs: Vec<f32> = (0..columns).map(|i| view.ray_x(place(i))).collect();
        let ys: Vec<f32> = (0..rows).map(|j| view.ray_y(place(j))).collect();
        let mut nearest = vec![0.0f32; columns * rows];
        let mut seen = vec![SKY; columns * rows];
        for (index, face) in view.faces.iter().enumerate() {
            let [u0, u1, v0, v1] = face.bounds;
            let (first, last) = (2 * u0, 2 * u1 + 2);
            for (j, &y) in ys.iter().enumerate().take(2 * v1 + 3).skip(2 * v0) {
                let row = j * columns + first..=j * columns + last;
                let (nearest, seen) = (&mut nearest[row.clone()], &mut seen[row]);
                scan(face, index as u32, &xs[first..=last], y, nearest, seen);
            }
        }
        Self { columns, seen }
    }
}

/// Tests one face against the samples of a row.
#[inline(always)]
fn scan(face: &ViewFace, index: u32, xs: &[f32], y: f32, nearest: &mut [f32], seen: &mut [u32]) {
    let at = |f: &[f32; 3]| (f[0], f[1] * y + f[2]);
    let (a, s, t) = (at(&face.inverse_depth), at(&face.coordinates[0]), at(&face.coordinates[1]));
    for ((&x, nearest), seen) in xs.iter().zip(nearest).zip(seen) {
        let inverse = a.0 * x + a.1;
        let s = s.0 * x + s.1;
        let t = t.0 * x + t.1;
        let hit =
            (inverse > *nearest) & (s >= 0.0) & (t >= 0.0) & (s <= inverse) & (t <= inverse) & (s + t <= face.limit * inverse);
        *nearest = if hit { inverse } else { *nearest };
        *seen = if hit { index } else { *seen };
    }
}

/// Renders a frame of a world.
pub fn render(world: &World, view: &View, frame: usize, night: bool) -> Rendered {
    let samples = Samples::new(view);
    let shader = Shader::new(world, view, frame, night);
    let (width, height) = (view.intrinsics.width, view.intrinsics.height);
    let plane = width * height;
    let mut image = Image::zeros(3, height, width);
    let mut depth = Map::zeros(height, width);
    for v in 0..height {
        for u in 0..width {
            let pixel = v * width + u;
            let colour = resolve(&samples, &shader, u, v);
            for (channel, value) in colour.into_iter().enumerate() {
                image.data[channel * plane + pixel] = value.clamp(0.0, 1.0);
            }
            let centre = samples.seen[(2 * v + 1) * samples.columns + 2 * u + 1];
            if centre != SKY {
                depth.data[pixel] = view.depth(centre as usize, u as f64, v as f64) as f32;
            }
        }
    }
    Rendered { image, depth }
}

/// The colour of a pixel: each face seen by its 3x3 samples once, at the mean place of these samples.
#[inline(always)]
fn resolve(samples: &Samples, shader: &Shader<'_>, u: usize, v: usize) -> [f32; 3] {
    let row = |j: usize| {
        let start = (2 * v + j) * samples.columns + 2 * u;
        [samples.seen[start], samples.seen[start + 1], samples.seen[start + 2]]
    };
    let seen = [row(0), row(1), row(2)];
    let centre = seen[1][1];
    let place = (u as f32, v as f32);
    if seen.iter().flatten().all(|&face| face == centre) {
        return shader.shade(centre, place.0, place.1);
    }
    mixed(&seen, shader, place)
}

/// The colour of a pixel that sees several faces.
#[inline(never)]
fn mixed(seen: &[[u32; 3]; 3], shader: &Shader<'_>, (u, v): (f32, f32)) -> [f32; 3] {
    const WEIGHTS: [f32; 3] = [0.25, 0.5, 0.25];
    let mut done = [false; 9];
    let mut colour = [0.0f32; 3];
    for first in 0..9 {
        if done[first] {
            continue;
        }
        let face = seen[first / 3][first % 3];
        let (mut weight, mut du, mut dv) = (0.0, 0.0, 0.0);
        for (other, done) in done.iter_mut().enumerate().skip(first) {
            let (j, i) = (other / 3, other % 3);
            if seen[j][i] == face {
                *done = true;
                let w = WEIGHTS[i] * WEIGHTS[j];
                weight += w;
                du += w * (0.5 * i as f32 - 0.5);
                dv += w * (0.5 * j as f32 - 0.5);
            }
        }
        let shade = shader.shade(face, u + du / weight, v + dv / weight);
        for (c, s) in colour.iter_mut().zip(shade) {
            *c += weight * s;
        }
    }
    colour
}

/// Everything that turns a face and a pixel into a colour.
struct Shader<'a> {
    world: &'a World,
    view: &'a View,
    /// World from camera, single precision, rows.
    rotation: [[f32; 3]; 3],
    /// Pixel steps as ray steps, and the principal point.
    steps: [f32; 2],
    centre: [f32; 2],
    night: bool,
}

impl<'a> Shader<'a> {
    fn new(world: &'a World, view: &'a View, frame: usize, night: bool) -> Self {
        let k = &view.intrinsics;
        let r = &world.poses[frame].rotation;
        let row = |i: usize| [r[(i, 0)] as f32, r[(i, 1)] as f32, r[(i, 2)] as f32];
        Self {
            world,
            view,
            rotation: [row(0), row(1), row(2)],
            steps: [(1.0 / k.fu) as f32, (1.0 / k.fv) as f32],
            centre: [k.u0 as f32, k.v0 as f32],
            night,
        }
    }

    /// Colour of the face (or sky) at pixel (u, v), which may lie a little outside the face.
    #[inline(always)]
    fn shade(&self, index: u32, u: f32, v: f32) -> [f32; 3] {
        let (x, y) = ((u - self.centre[0]) * self.steps[0], (v - self.centre[1]) * self.steps[1]);
        if index == SKY {
            return self.sky(x, y);
        }
        let seen = &self.view.faces[index as usize];
        let depth = 1.0 / form(&seen.inverse_depth, x, y).max(1e-4);
        let face = &self.world.faces[seen.face];
        let [s, t] = [0, 1].map(|i| form(&seen.coordinates[i], x, y) * depth);
        let [ds, dt] = [(0, s), (1, t)]
            .map(|(i, value)| [0, 1].map(|k| (seen.coordinates[i][k] - value * seen.inverse_depth[k]) * depth * self.steps[k]));
        let texture = face.texture.map(|p| [p.x as f32, p.y as f32]);
        let at = [0, 1].map(|k| texture[0][k] + s * texture[1][k] + t * texture[2][k]);
        let step = |k: usize| [0, 1].map(|p| ds[p] * texture[1][k] + dt[p] * texture[2][k]);
        let footprint = Footprint { u: step(0), v: step(1) };
        let albedo = match &self.world.surfaces[face.material] {
            Surface::Plain(material) => material.albedo(&self.world.table, at, &footprint),
            Surface::Road(road) => road.albedo(&self.world.table, at, &footprint),
        };
        let light = self.world.light_on[seen.face];
        let light = if self.night { light * headlight(x, y, depth) } else { light };
        let colour = albedo.map(|c| c * light);
        if self.world.light.clear == f32::INFINITY || self.night {
            return colour;
        }
        let distance = depth * (1.0 + x * x + y * y).sqrt();
        blend(colour, self.world.light.sky[0], 1.0 - (-distance / self.world.light.clear).exp())
    }

    /// Sky colour along a ray: a gradient with soft clouds, fixed to the world's directions.
    fn sky(&self, x: f32, y: f32) -> [f32; 3] {
        let direction = self.rotation.map(|r| r[0] * x + r[1] * y + r[2]);
        let length = direction.iter().map(|d| d * d).sum::<f32>().sqrt();
        let [dx, dy, dz] = direction.map(|d| d / length);
        let up = (-dy).max(0.0);
        let [horizon, zenith] = self.world.light.sky;
        let (a, b) = (dx / (up + 0.5), dz / (up + 0.5));
        let cloud = self.world.table.at(3.0 * a, 3.0 * b) + 0.5 * self.world.table.at(6.0 * a + 9.0, 6.0 * b);
        let clear = blend(horizon, zenith, (1.6 * up).min(1.0));
        let colour = blend(clear, [0.93, 0.93, 0.94], (0.35 + 0.5 * cloud).clamp(0.0, 0.8));
        if self.night { colour.map(|c| 0.05 * c) } else { colour }
    }
}

/// Share of the day's light that a surface point gets at night: a faint rest, and a cone of light from the camera that falls
/// off with distance and towards the sides. It moves with the camera, so brightness constancy does not hold.
fn headlight(x: f32, y: f32, depth: f32) -> f32 {
    let aside = (x * x + 2.0 * (y - 0.08) * (y - 0.08)) / 0.3;
    let cone = 1.0 / (1.0 + aside * aside);
    let distance = depth * depth * (1.0 + x * x + y * y);
    0.12 + 1.5 * cone * 70.0 / (70.0 + distance)
}
