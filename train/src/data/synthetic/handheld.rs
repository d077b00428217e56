//! The `handheld` world: a room, or a courtyard under the sky, full of things at all heights around a wandering camera.

use dimode_geometry::Se3;
use nalgebra::{Vector2, Vector3};

use super::config::Preset;
use super::face::{Placement, rotation_y};
use super::material;
use super::random::{Draw, Smooth};
use super::trajectory::{self, orientation};
use super::world::Scene;

/// Metres every object keeps from the camera.
const CLEARANCE: f64 = 0.95;

/// A room under construction.
struct Room {
    scene: Scene,
    draw: Draw,
    /// Half the floor along x and z.
    half: Vector2<f64>,
    /// World y of floor and ceiling (or of the top of the courtyard's walls).
    floor: f64,
    top: f64,
    open: bool,
    skins: Vec<usize>,
}

/// The room or courtyard of a seed.
pub fn build(seed: u64, frames: usize, moving_object: bool) -> Scene {
    let mut draw = Draw::new(seed, 10 + Preset::Handheld as u64);
    let open = draw.chance(0.25);
    let half = Vector2::new(draw.range(3.2, 6.5), draw.range(3.2, 6.5));
    let reach = Vector3::new(0.38 * half.x, 0.5, 0.38 * half.y);
    let poses = trajectory::walk(&mut draw, frames, reach);
    let floor = draw.range(1.4, 2.0);
    let top = if open { -draw.range(5.0, 7.5) } else { -draw.range(1.4, 2.6) };
    let mut scene = Scene::new(poses);
    let skins = (0..14)
        .map(|_| {
            let size = draw.log_range(0.2, 1.2);
            scene.material(material::object(&mut draw, size))
        })
        .collect();
    let mut room = Room { scene, draw, half, floor, top, open, skins };
    room.shell();
    room.furniture();
    if moving_object {
        room.moving_box();
    }
    room.scene
}

impl Room {
    fn shift(&mut self) -> Vector2<f64> {
        Vector2::new(self.draw.range(0.0, 50.0), self.draw.range(0.0, 50.0))
    }

    fn skin(&mut self) -> usize {
        self.skins[self.draw.index(self.skins.len())]
    }

    fn interior(&mut self) -> usize {
        let material = material::interior(&mut self.draw);
        self.scene.material(material)
    }

    /// Floor, ceiling and walls; each wall of one to three panels.
    fn shell(&mut self) {
        let (x, z) = (self.half.x, self.half.y);
        let edges = [Vector3::new(2.0 * x, 0.0, 0.0), Vector3::new(0.0, 0.0, 2.0 * z)];
        let mut levels = vec![(self.floor, -1.0)];
        if !self.open {
            levels.push((self.top, 1.0));
        }
        for (level, up) in levels {
            let (material, shift) = (self.interior(), self.shift());
            let corner = Vector3::new(-x, level, -z);
            self.scene.mesh.quad([corner, edges[0], edges[1]], Vector3::y() * up, shift, material);
        }
        for quarter in 0..4 {
            let turn = rotation_y(std::f64::consts::FRAC_PI_2 * quarter as f64);
            let (wide, away) = if quarter % 2 == 0 { (x, z) } else { (z, x) };
            let panels = 1 + self.draw.index(3);
            for panel in 0..panels {
                let width = 2.0 * wide / panels as f64;
                let corner = turn * Vector3::new(-wide + width * panel as f64, 0.0, away);
                let corner = Vector3::new(corner.x, self.top, corner.z);
                let sides = [turn * Vector3::new(width, 0.0, 0.0), Vector3::new(0.0, self.floor - self.top, 0.0)];
                let (material, shift) = (self.interior(), self.shift());
                self.scene.mesh.quad([corner, sides[0], sides[1]], turn * -Vector3::z(), shift, material);
            }
        }
    }

    /// Whether a ball stays clear of every camera position.
    fn is_free(&self, centre: Vector3<f64>, radius: f64) -> bool {
        self.scene.poses.iter().all(|pose| (pose.translation - centre).norm() >= radius + CLEARANCE)
    }

    /// Boxes, prisms, balls and cones of many sizes: on the floor, on the walls, hanging, tilted.
    fn furniture(&mut self) {
        let count = 45 + self.draw.index(30);
        for _ in 0..count {
            let size = self.draw.log_range(0.12, 0.9);
            let half = Vector3::from_fn(|_, _| size * self.draw.range(0.45, 1.0));
            let position = Vector3::new(
                self.half.x * self.draw.range(-0.97, 0.97),
                self.draw.range(self.top.max(-3.5), self.floor),
                self.half.y * self.draw.range(-0.97, 0.97),
            );
            let standing = self.draw.chance(0.4);
            let y = if standing { self.floor - half.y } else { position.y };
            let centre = Vector3::new(position.x, y, position.z);
            if self.is_free(centre, half.norm()) {
                self.thing(centre, half, standing);
            }
        }
        self.columns();
    }

    fn thing(&mut self, centre: Vector3<f64>, half: Vector3<f64>, standing: bool) {
        let yaw = self.draw.range(0.0, std::f64::consts::TAU);
        let tilted = !standing && self.draw.chance(0.6);
        let tilt = if tilted { 0.8 } else { 0.0 };
        let place = Placement {
            rotation: orientation(yaw, tilt * self.draw.range(-1.0, 1.0), tilt * self.draw.range(-1.0, 1.0)),
            position: centre,
        };
        let (skin, other, shift) = (self.skin(), self.skin(), self.shift());
        let below = Placement { position: centre + place.rotation * Vector3::new(0.0, half.y, 0.0), ..place };
        let mesh = &mut self.scene.mesh;
        match self.draw.index(8) {
            0..=4 => mesh.solid_box(&place, half, [skin, other], shift, true),
            5 => mesh.prism(&below, 0.7 * half.x, 2.0 * half.y, 9, skin, shift),
            6 => mesh.ball(&place, half, 1, skin, shift),
            _ => mesh.cone(&below, 0.7 * half.x, 2.0 * half.y, 8, skin, shift),
        }
    }

    /// A few posts and beams from floor to ceiling.
    fn columns(&mut self) {
        for _ in 0..2 + self.draw.index(4) {
            let radius = self.draw.range(0.06, 0.3);
            let x = self.half.x * self.draw.range(-0.95, 0.95);
            let z = self.half.y * self.draw.range(-0.95, 0.95);
            let far = |pose: &Se3| (pose.translation.x - x).hypot(pose.translation.z - z) >= radius + CLEARANCE;
            if self.scene.poses.iter().all(far) {
                let (skin, shift) = (self.skin(), self.shift());
                let place = Placement::upright(Vector3::new(x, self.floor, z), self.draw.unit());
                self.scene.mesh.prism(&place, radius, self.floor - self.top, 10, skin, shift);
            }
        }
    }

    /// A box that swings around a place that the camera does not come near.
    fn moving_box(&mut self) {
        let half = Vector3::from_fn(|_, _| self.draw.range(0.2, 0.4));
        let swing = Vector3::new(0.5, 0.25, 0.5);
        let reach = half.norm() + swing.norm();
        let mut home = Vector3::new(0.8 * self.half.x, 0.0, 0.8 * self.half.y);
        for _ in 0..200 {
            let room = [self.half.x - 0.9, self.half.y - 0.9];
            let candidate = Vector3::new(room[0] * self.draw.range(-1.0, 1.0), 0.0, room[1] * self.draw.range(-1.0, 1.0));
            if self.is_free(candidate, reach) {
                home = candidate;
                break;
            }
        }
        let first = self.scene.mesh.faces.len();
        let (skin, other, shift) = (self.skin(), self.skin(), self.shift());
        let place = Placement::upright(Vector3::zeros(), 0.0);
        self.scene.mesh.solid_box(&place, half, [skin, other], shift, true);
        for face in &mut self.scene.mesh.faces[first..] {
            face.moving = true;
        }
        let ways = [(); 3].map(|()| Smooth::new(&mut self.draw, 3, 12.0, 40.0));
        let spin = Smooth::new(&mut self.draw, 2, 30.0, 60.0);
        self.scene.object_poses = (0..self.scene.poses.len())
            .map(|frame| {
                let t = frame as f64;
                Se3 {
                    rotation: rotation_y(spin.at(t)),
                    translation: home + Vector3::from_fn(|i, _| swing[i] * ways[i].bounded(t)),
                }
            })
            .collect();
    }
}
