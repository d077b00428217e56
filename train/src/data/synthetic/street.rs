//! The `street` world: a road along a drawn drive, with everything built around it.

use dimode_geometry::Se3;
use nalgebra::{Vector2, Vector3};

use super::config::Preset;
use super::face::Placement;
use super::material;
use super::random::Draw;
use super::road::{PathPoint, Road};
use super::street_objects as objects;
use super::trajectory::{self, Drive};
use super::world::{Scene, Surface};

/// Metres every object keeps from the path.
const CLEARANCE: f64 = 1.15;

/// Radius of the ring of far walls from which blocks along the drive hide it, metres.
const FAR: f64 = 70.0;

/// A street under construction.
pub struct Street {
    /// What has been built.
    pub scene: Scene,
    /// The random draws.
    pub draw: Draw,
    /// The path of the drive.
    path: Vec<PathPoint>,
    /// Places to stay away from: the path and the camera positions.
    keep_out: Vec<Vector2<f64>>,
    /// Facade materials.
    walls: Vec<usize>,
    /// Object materials.
    pub skins: Vec<usize>,
    /// Materials of leaves.
    pub leaves: Vec<usize>,
    /// Left and right edge of the road and the width of the pavements.
    edges: [f64; 2],
    pavement: f64,
    /// First and last length along the path where things are built.
    span: [f64; 2],
}

/// The street world of a seed.
pub fn build(seed: u64, frames: usize, moving_object: bool) -> Scene {
    let mut draw = Draw::new(seed, 10 + Preset::Street as u64);
    let drive = trajectory::drive(&mut draw, frames);
    let centre = draw.range(-2.4, -1.4);
    // From an alley to an avenue.
    let half = -centre + draw.log_range(1.7, 6.5);
    let pavement = draw.range(1.6, 3.0);
    let road = Road::new(&mut draw, &drive.path, centre, half, pavement);
    let mut street = Street::new(draw, &drive, [centre - half, centre + half], pavement);
    street.ground_and_backdrop(road);
    street.facades();
    objects::fill(&mut street);
    if moving_object {
        street.moving_car(&drive);
    }
    street.scene
}

impl Street {
    fn new(mut draw: Draw, drive: &Drive, edges: [f64; 2], pavement: f64) -> Self {
        let mut scene = Scene::new(drive.poses.clone());
        let walls = (0..7).map(|_| scene.material(material::facade(&mut draw))).collect();
        let skins = (0..14)
            .map(|_| {
                let size = draw.range(0.6, 1.6);
                scene.material(material::object(&mut draw, size))
            })
            .collect();
        let leaves = (0..3).map(|_| scene.material(material::foliage(&mut draw))).collect();
        let cameras = drive.poses.iter().map(|p| Vector2::new(p.translation.x, p.translation.z));
        let keep_out = drive.path.iter().map(|p| p.position).chain(cameras).collect();
        let end = drive.path.last().map_or(0.0, |p| p.arc);
        Self { scene, draw, path: drive.path.clone(), keep_out, walls, skins, leaves, edges, pavement, span: [1.0, end - 2.0] }
    }

    /// A random member of a list of materials.
    pub fn pick(&mut self, list: &[usize]) -> usize {
        list[self.draw.index(list.len())]
    }

    /// A random texture offset, metres.
    pub fn shift(&mut self) -> Vector2<f64> {
        Vector2::new(self.draw.range(0.0, 50.0), self.draw.range(0.0, 50.0))
    }

    /// First and last length along the path where things are built.
    pub fn span(&self) -> [f64; 2] {
        self.span
    }

    /// Left and right edge of the carriageway, signed distances from the path.
    pub fn edges(&self) -> [f64; 2] {
        self.edges
    }

    /// Width of the pavements.
    pub fn pavement(&self) -> f64 {
        self.pavement
    }

    /// Position and heading at a length along the path and a distance to its right.
    pub fn at(&self, arc: f64, lateral: f64) -> (Vector2<f64>, f64) {
        let point = along(&self.path, arc);
        (point.position + point.right() * lateral, point.heading)
    }

    /// Whether an upright box (half sizes across and along its heading) stays `clearance` away from the
    /// path and all camera positions.
    pub fn is_clear(&self, centre: Vector2<f64>, heading: f64, half: [f64; 2], clearance: f64) -> bool {
        let (s, c) = heading.sin_cos();
        self.keep_out.iter().all(|point| {
            let d = point - centre;
            let across = (d.x * c - d.y * s).abs() - half[0];
            let along = (d.x * s + d.y * c).abs() - half[1];
            across.max(0.0).hypot(along.max(0.0)) >= clearance
        })
    }

    /// [`Street::is_clear`] with the clearance of objects.
    pub fn is_free(&self, centre: Vector2<f64>, heading: f64, half: [f64; 2]) -> bool {
        self.is_clear(centre, heading, half, CLEARANCE)
    }

    /// Ground, a ring of far walls of uneven height, and tall blocks between them and the street.
    fn ground_and_backdrop(&mut self, road: Road) {
        let centre = self.path.iter().map(|p| p.position).sum::<Vector2<f64>>() / self.path.len() as f64;
        let frames = self.scene.poses.iter().map(|p| Vector2::new(p.translation.x, p.translation.z));
        let reach = frames.map(|p| (p - centre).norm()).fold(0.0, f64::max);
        let radius = reach.max(14.0) + 34.0;
        let size = 2.2 * radius;
        self.scene.surfaces.push(Surface::Road(Box::new(road)));
        let ground = self.scene.surfaces.len() - 1;
        let corner = Vector3::new(centre.x - 0.5 * size, 0.0, centre.y - 0.5 * size);
        let edges = [Vector3::new(size, 0.0, 0.0), Vector3::new(0.0, 0.0, size)];
        self.scene.mesh.quad([corner, edges[0], edges[1]], -Vector3::y(), Vector2::zeros(), ground);
        // Texture coordinates of the ground are world (x, z).
        if let Some(face) = self.scene.mesh.faces.last_mut() {
            let along = Vector2::new(size, 0.0);
            face.texture = [Vector2::new(corner.x, corner.z), along, along.yx()];
        }
        self.ring(centre, radius);
        if radius < FAR {
            self.blocks(centre, radius);
        } else {
            self.blocks_along();
        }
    }

    fn ring(&mut self, centre: Vector2<f64>, radius: f64) {
        let count = 26;
        for i in 0..count {
            let angle = |k: usize| std::f64::consts::TAU * k as f64 / count as f64;
            let corner = |k: usize| {
                let (s, c) = angle(k).sin_cos();
                Vector3::new(centre.x + radius * s, 0.0, centre.y + radius * c)
            };
            let (a, b) = (corner(i), corner(i + 1));
            let height = Vector3::new(0.0, -self.draw.range(15.0, 30.0), 0.0);
            let inward = Vector3::new(centre.x, 0.0, centre.y) - a;
            let (shift, material) = (self.shift(), self.pick(&self.walls.clone()));
            self.scene.mesh.quad([a + height, b - a, -height], inward, shift, material);
        }
    }

    fn blocks(&mut self, centre: Vector2<f64>, radius: f64) {
        let count = (0.004 * radius * radius * std::f64::consts::PI) as usize;
        for _ in 0..count {
            let angle = self.draw.range(0.0, std::f64::consts::TAU);
            let distance = radius * self.draw.unit().sqrt();
            let ground = centre + distance * Vector2::new(angle.sin(), angle.cos());
            let half = [self.draw.range(2.0, 5.0), self.draw.range(2.0, 5.0)];
            let yaw = self.draw.range(0.0, std::f64::consts::TAU);
            if self.is_clear(ground, yaw, half, 12.0) {
                let height = self.draw.range(4.0, 18.0);
                self.building(ground, yaw, half, height);
            }
        }
    }

    /// Tall blocks on both sides all along a drive so long that the ring of walls is too far to be seen.
    fn blocks_along(&mut self) {
        let mut arc = self.span[0] - 20.0;
        while arc < self.span[1] + 50.0 {
            let lateral = self.draw.sign() * self.draw.range(15.0, 48.0);
            let (ground, heading) = self.at(arc, lateral);
            let half = [self.draw.range(3.0, 6.0), self.draw.range(4.0, 9.0)];
            if self.is_clear(ground, heading, half, 12.0) {
                let height = self.draw.range(9.0, 24.0) + 0.15 * lateral.abs();
                self.building(ground, heading, half, height);
            }
            arc += 2.5;
        }
        // The street ends at a wall.
        let (ground, heading) = self.at(self.span[1] + 12.0, 0.0);
        self.building(ground, heading, [35.0, 2.0], 20.0);
    }

    fn building(&mut self, ground: Vector2<f64>, yaw: f64, half: [f64; 2], height: f64) {
        let place = Placement::upright(Vector3::new(ground.x, -0.5 * height, ground.y), yaw);
        let size = Vector3::new(half[0], 0.5 * height, half[1]);
        let (wall, top, shift) = (self.pick(&self.walls.clone()), self.pick(&self.skins.clone()), self.shift());
        self.scene.mesh.solid_box(&place, size, [wall, top], shift, false);
    }

    /// Rows of buildings of uneven depth, height and distance on both sides, with gaps.
    fn facades(&mut self) {
        for side in [-1.0, 1.0] {
            let edge = if side < 0.0 { -self.edges[0] } else { self.edges[1] } + self.pavement;
            let setback = edge + self.draw.log_range(0.3, 8.0);
            let mut arc = self.span[0];
            while arc < self.span[1] {
                let length = self.draw.range(3.5, 12.0);
                let distance = setback + self.draw.range(0.0, 3.5);
                self.facade(side, arc + 0.5 * length, 0.5 * length, distance);
                let gap = if self.draw.chance(0.3) { self.draw.range(1.5, 9.0) } else { 0.0 };
                arc += length + gap;
            }
        }
    }

    fn facade(&mut self, side: f64, arc: f64, half_length: f64, distance: f64) {
        let depth = self.draw.range(2.0, 4.0);
        let height = self.draw.log_range(2.2, 14.0);
        let (ground, yaw) = self.at(arc, side * (distance + depth));
        let half = [depth, half_length];
        if !self.is_clear(ground, yaw, half, 2.2) {
            return;
        }
        self.building(ground, yaw, half, height);
        // Awnings, bays and balconies that stand out of the front.
        for _ in 0..self.draw.index(3) {
            let out = self.draw.range(0.3, 1.1);
            let half = Vector3::new(out, self.draw.range(0.1, 0.9), self.draw.range(0.5, 1.6).min(half_length));
            let along = self.draw.range(-1.0, 1.0) * (half_length - half.z);
            let (ground, yaw) = self.at(arc + along, side * distance);
            let y = -self.draw.range(2.6, 3.0f64.max(height - 1.0)) - half.y;
            let place = Placement::upright(Vector3::new(ground.x, y, ground.y), yaw);
            let (skin, shift) = (self.pick(&self.skins.clone()), self.shift());
            if self.is_clear(ground, yaw, [half.x, half.z], 1.6) {
                self.scene.mesh.solid_box(&place, half, [skin, skin], shift, true);
            }
        }
    }

    /// A car that drives on its own: ahead in the same lane, or towards the camera in the other lane.
    fn moving_car(&mut self, drive: &Drive) {
        let first = self.scene.mesh.faces.len();
        objects::car_at(self, &Placement::upright(Vector3::zeros(), 0.0));
        for face in &mut self.scene.mesh.faces[first..] {
            face.moving = true;
        }
        let oncoming = self.draw.chance(0.5);
        let (start, speed) = (self.draw.range(14.0, 26.0), self.draw.range(0.3, 0.7));
        let lateral = if oncoming { 0.5 * (self.edges[0] + self.edges[1]) - 1.6 } else { 0.0 };
        let gap = super::random::Smooth::new(&mut self.draw, 3, 15.0, 50.0);
        self.scene.object_poses = (0..drive.poses.len())
            .map(|frame| {
                let camera = drive.path[drive.first + frame].arc;
                let arc = if oncoming {
                    drive.path[drive.first].arc + start - speed * frame as f64
                } else {
                    camera + 9.0 + 2.0 * gap.bounded(frame as f64)
                };
                let (ground, heading) = self.at(arc, lateral.min(if oncoming { -3.0 } else { 0.0 }));
                let turn = if oncoming { std::f64::consts::PI } else { 0.0 };
                Se3 { rotation: super::face::rotation_y(heading + turn), translation: Vector3::new(ground.x, 0.0, ground.y) }
            })
            .collect();
    }
}

/// The point at a length along a path, interpolated; beyond the ends the path goes straight on.
fn along(path: &[PathPoint], arc: f64) -> PathPoint {
    let next = path.partition_point(|p| p.arc < arc).clamp(1, path.len() - 1);
    let (a, b) = (&path[next - 1], &path[next]);
    let w = (arc - a.arc) / (b.arc - a.arc);
    PathPoint {
        position: a.position + w * (b.position - a.position),
        heading: a.heading + w.clamp(0.0, 1.0) * (b.heading - a.heading),
        arc,
    }
}
