//! The `lateral` world: a long scene 2 to 30 m ahead of a camera that moves sideways along x.

use dimode_geometry::Se3;
use nalgebra::{Vector2, Vector3};

use super::config::Preset;
use super::face::{Placement, rotation_y};
use super::material;
use super::random::{Draw, Smooth};
use super::trajectory;
use super::world::Scene;

/// A scene under construction.
struct Stage {
    scene: Scene,
    draw: Draw,
    /// First and last x of the camera.
    span: [f64; 2],
    skins: Vec<usize>,
    walls: Vec<usize>,
    leaves: Vec<usize>,
}

/// The lateral world of a seed.
pub fn build(seed: u64, frames: usize, moving_object: bool) -> Scene {
    let mut draw = Draw::new(seed, 10 + Preset::Lateral as u64);
    let poses = trajectory::slide(&mut draw, frames);
    let end = poses.last().map_or(0.0, |pose| pose.translation.x);
    let mut scene = Scene::new(poses);
    let skins = (0..14)
        .map(|_| {
            let size = draw.log_range(0.3, 1.6);
            scene.material(material::object(&mut draw, size))
        })
        .collect();
    let walls = (0..6).map(|_| scene.material(material::facade(&mut draw))).collect();
    let leaves = (0..3).map(|_| scene.material(material::foliage(&mut draw))).collect();
    let span = [end.min(0.0), end.max(0.0)];
    let mut stage = Stage { scene, draw, span, skins, walls, leaves };
    stage.ground();
    stage.back();
    stage.things();
    if moving_object {
        stage.moving_box();
    }
    stage.scene
}

impl Stage {
    fn shift(&mut self) -> Vector2<f64> {
        Vector2::new(self.draw.range(0.0, 50.0), self.draw.range(0.0, 50.0))
    }

    fn skin(&mut self) -> usize {
        self.skins[self.draw.index(self.skins.len())]
    }

    fn ground(&mut self) {
        let mut look = material::open_ground(&mut self.draw);
        look.octaves.extend(material::Grain::new(1.0, 0.2, 0.12).stretched(1.0, 8.0).octaves(&mut self.draw));
        let (material, shift) = (self.scene.material(look), self.shift());
        let corner = Vector3::new(self.span[0] - 50.0, 0.0, -3.0);
        let edges = [Vector3::new(self.span[1] - self.span[0] + 100.0, 0.0, 0.0), Vector3::new(0.0, 0.0, 40.0)];
        self.scene.mesh.quad([corner, edges[0], edges[1]], -Vector3::y(), shift, material);
    }

    /// Buildings of uneven depth and height at the back, and a wall behind them at 30 m.
    fn back(&mut self) {
        let mut x = self.span[0] - 40.0;
        while x < self.span[1] + 40.0 {
            let half = Vector3::new(self.draw.range(1.5, 5.0), self.draw.range(2.0, 7.0), self.draw.range(1.0, 3.0));
            let z = self.draw.range(16.0, 26.0);
            let place = Placement::upright(Vector3::new(x + half.x, -half.y, z), self.draw.range(-0.3, 0.3));
            let (wall, top, shift) = (self.walls[self.draw.index(self.walls.len())], self.skin(), self.shift());
            self.scene.mesh.solid_box(&place, half, [wall, top], shift, false);
            let width = 2.0 * half.x + self.draw.range(0.0, 5.0);
            let height = Vector3::new(0.0, -self.draw.range(10.0, 15.0), 0.0);
            let (wall, shift) = (self.walls[self.draw.index(self.walls.len())], self.shift());
            let corner = Vector3::new(x, 0.0, 30.0) + height;
            self.scene.mesh.quad([corner, Vector3::new(width, 0.0, 0.0), -height], -Vector3::z(), shift, wall);
            x += width;
        }
    }

    /// Things of many sizes between 2 and 18 m, denser where they look small; some hang in the air.
    fn things(&mut self) {
        let length = self.span[1] - self.span[0];
        let count = (34.0 + 2.4 * length) as usize;
        for _ in 0..count {
            let z = self.draw.log_range(2.6, 18.0);
            let margin = 0.9 * z;
            let x = self.draw.range(self.span[0] - margin, self.span[1] + margin);
            let size = self.draw.log_range(0.15, 1.3) * (0.45 + 0.06 * z);
            let half = Vector3::from_fn(|_, _| size * self.draw.range(0.5, 1.0));
            if z - half.norm() < 1.7 {
                continue;
            }
            let hanging = self.draw.chance(0.25);
            let y = if hanging { -half.y - self.draw.range(0.8, 3.5) } else { -half.y };
            self.thing(Vector3::new(x, y, z), half, hanging);
        }
    }

    fn thing(&mut self, centre: Vector3<f64>, half: Vector3<f64>, hanging: bool) {
        let place = Placement::upright(centre, self.draw.range(0.0, std::f64::consts::TAU));
        let foot = Placement { position: centre + Vector3::new(0.0, half.y, 0.0), ..place };
        let leaf = self.leaves[self.draw.index(self.leaves.len())];
        let (skin, other, shift) = (self.skin(), self.skin(), self.shift());
        let height = self.draw.range(2.0, 5.0);
        let mesh = &mut self.scene.mesh;
        match self.draw.index(9) {
            0..=3 => mesh.solid_box(&place, half, [skin, other], shift, hanging),
            4 => mesh.prism(&foot, half.x, 2.0 * half.y, 9, skin, shift),
            5 => mesh.ball(&place, half, 1, leaf, shift),
            6 => mesh.cone(&foot, half.x, 2.2 * half.y, 8, leaf, shift),
            _ if hanging => mesh.solid_box(&place, half, [other, skin], shift, true),
            _ => mesh.prism(&foot, (0.2 * half.x).max(0.07), height, 8, other, shift),
        }
    }

    /// A box that slides to and fro in front of the scene.
    fn moving_box(&mut self) {
        let half = Vector3::new(self.draw.range(0.3, 0.8), self.draw.range(0.3, 0.8), 0.4);
        let first = self.scene.mesh.faces.len();
        let (skin, other, shift) = (self.skin(), self.skin(), self.shift());
        let place = Placement::upright(Vector3::new(0.0, -half.y, 0.0), 0.0);
        self.scene.mesh.solid_box(&place, half, [skin, other], shift, true);
        for face in &mut self.scene.mesh.faces[first..] {
            face.moving = true;
        }
        let depth = self.draw.range(4.0, 8.0);
        let sway = [(); 2].map(|()| Smooth::new(&mut self.draw, 3, 18.0, 50.0));
        self.scene.object_poses = self
            .scene
            .poses
            .iter()
            .enumerate()
            .map(|(frame, pose)| {
                let t = frame as f64;
                let x = pose.translation.x + 1.6 * sway[0].bounded(t);
                Se3 {
                    rotation: rotation_y(0.6 * sway[1].at(t)),
                    translation: Vector3::new(x, -0.05, depth + 0.6 * sway[1].bounded(t)),
                }
            })
            .collect();
    }
}
