//! The `handheld` world: a furnished room, or a courtyard under the sky, around a wandering camera.

use std::f64::consts::{FRAC_PI_2, TAU};

use dimode_geometry::Se3;
use nalgebra::{Vector2, Vector3};

use super::config::Preset;
use super::face::{Placement, rotation_y};
use super::furniture::{self, Piece, Stock};
use super::material;
use super::random::{Draw, Smooth};
use super::trajectory;
use super::world::Scene;

/// Metres that every piece of furniture keeps from the camera; ceilings come as near as 0.4 m.
const CLEARANCE: f64 = 0.85;

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
    stock: Stock,
    /// Centre and radius of every piece on the floor, world (x, z).
    taken: Vec<(Vector2<f64>, f64)>,
}

/// The room or courtyard of a seed.
pub fn build(seed: u64, frames: usize, moving_object: bool) -> Scene {
    let mut draw = Draw::new(seed, 10 + Preset::Handheld as u64);
    let open = draw.chance(0.25);
    let half = Vector2::new(draw.range(2.8, 5.5), draw.range(2.8, 5.5));
    let reach = Vector3::new(0.38 * half.x, 0.4, 0.38 * half.y);
    let poses = trajectory::walk(&mut draw, frames, reach);
    let floor = draw.range(1.35, 1.7);
    let top = floor - if open { draw.range(6.5, 9.0) } else { draw.range(2.5, 3.2) };
    let mut scene = Scene::new(poses);
    let stock = Stock::new(&mut scene, &mut draw);
    let mut room = Room { scene, draw, half, floor, top, open, stock, taken: Vec::new() };
    room.shell();
    room.furnish();
    if moving_object {
        room.moving_box();
    }
    room.scene
}

/// The vertical plane of a wall: looking at it, x is to the right along it, z points away from the room.
#[derive(Clone, Copy)]
struct Wall {
    yaw: f64,
    /// Half its length and its distance from the middle of the room.
    half: f64,
    away: f64,
}

impl Room {
    fn shift(&mut self) -> Vector2<f64> {
        Vector2::new(self.draw.range(0.0, 50.0), self.draw.range(0.0, 50.0))
    }

    fn walls(&self) -> [Wall; 4] {
        [0, 1, 2, 3].map(|quarter| {
            let (half, away) = if quarter % 2 == 0 { (self.half.x, self.half.y) } else { (self.half.y, self.half.x) };
            Wall { yaw: FRAC_PI_2 * quarter as f64, half, away }
        })
    }

    /// Floor, walls and what hangs on them; a ceiling when there is no sky.
    fn shell(&mut self) {
        let looks = if self.open {
            let floor =
                if self.draw.chance(0.5) { material::paving(&mut self.draw) } else { material::open_ground(&mut self.draw) };
            [floor, material::facade(&mut self.draw), material::facade(&mut self.draw), material::ceiling(&mut self.draw)]
        } else {
            let wall = material::paint(&mut self.draw);
            // One wall of a room often has a colour of its own.
            let accent = if self.draw.chance(0.5) { material::paint(&mut self.draw) } else { wall.clone() };
            [material::floor(&mut self.draw), wall, accent, material::ceiling(&mut self.draw)]
        };
        let [floor, wall, accent, ceiling] = looks.map(|look| self.scene.material(look));
        self.level(self.floor, -1.0, floor);
        if !self.open {
            self.level(self.top, 1.0, ceiling);
        }
        let skirting = self.stock.skirting;
        for (i, plane) in self.walls().into_iter().enumerate() {
            let material = if i == 0 { accent } else { wall };
            self.panel(plane, [-plane.half, plane.half], [self.floor, self.top], 0.0, material);
            if !self.open {
                self.panel(plane, [-plane.half, plane.half], [self.floor, self.floor - 0.12], 0.01, skirting);
            }
            self.hangings(plane);
        }
    }

    /// A horizontal plane as large as the room at height `y`, seen from the side of `up`.
    fn level(&mut self, y: f64, up: f64, material: usize) {
        let (x, z) = (self.half.x, self.half.y);
        let (corner, shift) = (Vector3::new(-x, y, -z), self.shift());
        let edges = [Vector3::new(2.0 * x, 0.0, 0.0), Vector3::new(0.0, 0.0, 2.0 * z)];
        self.scene.mesh.quad([corner, edges[0], edges[1]], Vector3::y() * up, shift, material);
    }

    /// A flat rectangle on a wall, `out` metres before it: along x and between two heights (world y, lower first).
    fn panel(&mut self, wall: Wall, x: [f64; 2], y: [f64; 2], out: f64, material: usize) {
        let turn = rotation_y(wall.yaw);
        let corner = turn * Vector3::new(x[0], 0.0, wall.away - out) + Vector3::new(0.0, y[1], 0.0);
        let sides = [turn * Vector3::new(x[1] - x[0], 0.0, 0.0), Vector3::new(0.0, y[0] - y[1], 0.0)];
        let shift = self.shift();
        self.scene.mesh.quad([corner, sides[0], sides[1]], turn * -Vector3::z(), shift, material);
    }

    /// A door, windows and pictures in rows of their own along a wall.
    fn hangings(&mut self, wall: Wall) {
        let mut x = -wall.half + self.draw.range(0.3, 1.0);
        while x < wall.half - 0.6 {
            let (width, low, high, material) = match self.draw.index(6) {
                0 => (0.95, 0.0, 2.05, self.stock.pick_wood(&mut self.draw)),
                1 | 2 => (self.draw.range(0.9, 1.5), 0.9, 2.1, self.stock.pane),
                3 | 4 => {
                    let (width, middle, tall) = (self.draw.range(0.4, 1.0), self.draw.range(1.4, 1.7), self.draw.range(0.3, 0.8));
                    (width, middle - 0.5 * tall, middle + 0.5 * tall, self.stock.pick_thing(&mut self.draw))
                }
                _ => {
                    x += self.draw.range(0.5, 1.5);
                    continue;
                }
            };
            if x + width < wall.half - 0.1 {
                self.panel(wall, [x, x + width], [self.floor - low, self.floor - high], 0.02, material);
            }
            x += width + self.draw.range(0.3, 1.2);
        }
    }

    /// Pieces along the walls with their backs to them, others anywhere; lamps from the ceiling.
    fn furnish(&mut self) {
        for wall in self.walls() {
            let mut x = -wall.half + 0.3;
            while x < wall.half - 0.4 {
                let piece = Piece::at_wall(&mut self.draw, self.open);
                let half = piece.half();
                if x + 2.0 * half.x < wall.half - 0.2 {
                    let ground = rotation_y(wall.yaw) * Vector3::new(x + half.x, 0.0, wall.away - half.z - 0.04);
                    self.stand(piece, Vector2::new(ground.x, ground.z), wall.yaw);
                }
                x += 2.0 * half.x + self.draw.range(0.1, 1.2);
            }
        }
        for _ in 0..14 + self.draw.index(12) {
            let piece = Piece::anywhere(&mut self.draw, self.open);
            let ground = Vector2::from_fn(|i, _| (self.half[i] - 0.5) * self.draw.range(-1.0, 1.0));
            let yaw = self.draw.range(0.0, TAU);
            self.stand(piece, ground, yaw);
        }
        if !self.open {
            for _ in 0..self.draw.index(4) {
                let drop = self.draw.range(0.5, 0.9);
                let piece = Piece::HangingLamp { drop };
                let (half, y) = (piece.half(), self.top + 0.5 * drop);
                let place = Vector3::new(self.half.x * self.draw.range(-0.8, 0.8), y, self.half.y * self.draw.range(-0.8, 0.8));
                if self.is_free(&Placement::upright(place, 0.0), half) {
                    let hook = Placement::upright(Vector3::new(place.x, self.top, place.z), 0.0);
                    furniture::build(piece, &hook, &self.stock, &mut self.draw, &mut self.scene.mesh);
                }
            }
        }
    }

    /// Puts a piece on the floor unless it would come near the camera or (by circles around both) well into another piece.
    fn stand(&mut self, piece: Piece, ground: Vector2<f64>, yaw: f64) {
        let half = piece.half();
        let radius = 0.5 * (half.x + half.z);
        let middle = Vector3::new(ground.x, self.floor - half.y, ground.y);
        let apart = self.taken.iter().all(|(centre, other)| (centre - ground).norm() > radius + other);
        if !apart || !self.is_free(&Placement::upright(middle, yaw), half) {
            return;
        }
        self.taken.push((ground, radius));
        let foot = Placement::upright(Vector3::new(ground.x, self.floor, ground.y), yaw);
        furniture::build(piece, &foot, &self.stock, &mut self.draw, &mut self.scene.mesh);
    }

    /// Whether a box with half sizes `half` stays clear of every camera position.
    fn is_free(&self, place: &Placement, half: Vector3<f64>) -> bool {
        self.distance(place, half) >= CLEARANCE
    }

    /// Metres from a box with half sizes `half` to the nearest camera position.
    fn distance(&self, place: &Placement, half: Vector3<f64>) -> f64 {
        let to = |pose: &Se3| {
            let local = place.rotation.transpose() * (pose.translation - place.position);
            local.abs().zip_map(&half, |x, h| (x - h).max(0.0)).norm()
        };
        self.scene.poses.iter().map(to).fold(f64::INFINITY, f64::min)
    }

    /// A box that swings at eye level, inside the walls, around a place that the camera does not come near; where there is none,
    /// the furthest of many.
    fn moving_box(&mut self) {
        let half = Vector3::from_fn(|_, _| self.draw.range(0.2, 0.4));
        let swing = Vector3::new(0.35, 0.25, 0.35);
        let reach = Vector3::repeat(half.norm()) + swing;
        let room = self.half.map(|half| half - reach.x);
        let mut home = (f64::NEG_INFINITY, Vector3::zeros());
        for _ in 0..200 {
            let candidate = Vector3::new(room[0] * self.draw.range(-1.0, 1.0), 0.0, room[1] * self.draw.range(-1.0, 1.0));
            let distance = self.distance(&Placement::upright(candidate, 0.0), reach);
            if distance > home.0 {
                home = (distance, candidate);
            }
            if distance >= CLEARANCE {
                break;
            }
        }
        let home = home.1;
        let first = self.scene.mesh.faces.len();
        let (skin, other, shift) = (self.stock.pick_thing(&mut self.draw), self.stock.pick_thing(&mut self.draw), self.shift());
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
