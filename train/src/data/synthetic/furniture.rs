//! What stands in a room: pieces of everyday sizes, built of boxes, prisms, cones and balls.

use nalgebra::{Vector2, Vector3};

use super::face::{Mesh, Placement};
use super::material;
use super::random::Draw;
use super::texture::Material;
use super::world::Scene;

/// Materials of a room's things.
pub struct Stock {
    woods: Vec<usize>,
    fabrics: Vec<usize>,
    things: Vec<usize>,
    leaves: Vec<usize>,
    /// White wood of skirting boards.
    pub skirting: usize,
    /// Glass of windows.
    pub pane: usize,
}

impl Stock {
    /// A random stock, added to the scene.
    pub fn new(scene: &mut Scene, draw: &mut Draw) -> Self {
        let mut stock = |draw: &mut Draw, n: usize, make: fn(&mut Draw) -> Material| -> Vec<usize> {
            (0..n)
                .map(|_| {
                    let look = make(draw);
                    scene.material(look)
                })
                .collect()
        };
        Stock {
            woods: stock(draw, 3, material::wood),
            fabrics: stock(draw, 3, material::fabric),
            things: stock(draw, 6, |draw| material::object(draw, 0.5)),
            leaves: stock(draw, 2, material::foliage),
            skirting: stock(draw, 1, material::ceiling)[0],
            pane: stock(draw, 1, material::pane)[0],
        }
    }

    /// One of the woods.
    pub fn pick_wood(&self, draw: &mut Draw) -> usize {
        self.woods[draw.index(self.woods.len())]
    }

    /// One of the skins of small things.
    pub fn pick_thing(&self, draw: &mut Draw) -> usize {
        self.things[draw.index(self.things.len())]
    }

    fn pick_fabric(&self, draw: &mut Draw) -> usize {
        self.fabrics[draw.index(self.fabrics.len())]
    }

    fn pick_leaf(&self, draw: &mut Draw) -> usize {
        self.leaves[draw.index(self.leaves.len())]
    }
}

/// A piece and its size in metres. All have their back at +z.
#[derive(Clone, Copy, Debug)]
pub enum Piece {
    /// A closed box: width, depth, height.
    Cabinet { width: f64, depth: f64, height: f64 },
    /// A slab on four legs with a few things on it: width, depth.
    Table { width: f64, depth: f64 },
    /// A seat, a back, four legs.
    Chair,
    /// A soft seat with back and arms: width.
    Sofa { width: f64 },
    /// A box or a ball on the floor: its size.
    Thing { size: f64 },
    /// A pot with leaves: radius of the leaves.
    Plant { radius: f64 },
    /// A pole with a shade.
    StandingLamp,
    /// A shade below the ceiling, `drop` metres long with its cable; its foot is at the ceiling.
    HangingLamp { drop: f64 },
}

impl Piece {
    /// One that has its back to a wall.
    pub fn at_wall(draw: &mut Draw, open: bool) -> Piece {
        match draw.index(if open { 3 } else { 8 }) {
            0 => Piece::Plant { radius: draw.range(0.25, 0.5) },
            1 => Piece::Table { width: draw.range(0.8, 1.6), depth: draw.range(0.5, 0.8) },
            2 => Piece::Thing { size: draw.range(0.3, 0.6) },
            3 => Piece::Sofa { width: draw.range(1.4, 2.2) },
            4 => Piece::StandingLamp,
            _ => {
                let height = if draw.chance(0.5) { draw.range(0.7, 1.1) } else { draw.range(1.8, 2.2) };
                Piece::Cabinet { width: draw.range(0.6, 1.6), depth: draw.range(0.35, 0.6), height }
            }
        }
    }

    /// One that stands free.
    pub fn anywhere(draw: &mut Draw, open: bool) -> Piece {
        match draw.index(if open { 6 } else { 8 }) {
            0 => Piece::Table { width: draw.range(0.8, 1.8), depth: draw.range(0.6, 1.0) },
            1 | 2 => Piece::Chair,
            3 | 4 => Piece::Thing { size: draw.range(0.25, 0.6) },
            5 => Piece::Plant { radius: draw.range(0.25, 0.5) },
            6 => Piece::StandingLamp,
            _ => Piece::Sofa { width: draw.range(0.8, 1.8) },
        }
    }

    /// Half its size along its own x, y, z.
    pub fn half(&self) -> Vector3<f64> {
        let size = match *self {
            Piece::Cabinet { width, depth, height } => [width, height, depth],
            Piece::Table { width, depth } => [width, 1.0, depth],
            Piece::Chair => [0.46, 0.95, 0.46],
            Piece::Sofa { width } => [width, 0.85, 0.9],
            Piece::Thing { size } => [size; 3],
            Piece::Plant { radius } => [2.0 * radius, 0.4 + 2.2 * radius, 2.0 * radius],
            Piece::StandingLamp => [0.5, 1.6, 0.5],
            Piece::HangingLamp { drop } => [0.5, drop, 0.5],
        };
        0.5 * Vector3::from(size)
    }
}

/// A piece under construction: boxes are given in its own frame, heights upwards from the foot.
struct Builder<'a> {
    foot: &'a Placement,
    mesh: &'a mut Mesh,
    draw: &'a mut Draw,
}

impl Builder<'_> {
    fn shift(&mut self) -> Vector2<f64> {
        Vector2::new(self.draw.range(0.0, 50.0), self.draw.range(0.0, 50.0))
    }

    fn at(&self, x: f64, height: f64, z: f64) -> Placement {
        Placement { position: self.foot.position + self.foot.rotation * Vector3::new(x, -height, z), ..*self.foot }
    }

    /// A box between two heights, its centre at (x, z).
    fn block(&mut self, [x, z]: [f64; 2], [low, high]: [f64; 2], [width, depth]: [f64; 2], material: usize) {
        let (place, shift) = (self.at(x, 0.5 * (low + high), z), self.shift());
        let half = 0.5 * Vector3::new(width, high - low, depth);
        self.mesh.solid_box(&place, half, [material; 2], shift, true);
    }

    /// Four legs of square section under a rectangle.
    fn legs(&mut self, height: f64, [width, depth]: [f64; 2], thick: f64, material: usize) {
        for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            let centre = [0.5 * sx * (width - thick), 0.5 * sz * (depth - thick)];
            self.block(centre, [0.0, height], [thick, thick], material);
        }
    }
}

/// Adds a piece that stands at `foot`.
pub fn build(piece: Piece, foot: &Placement, stock: &Stock, draw: &mut Draw, mesh: &mut Mesh) {
    let (wood, fabric) = (stock.pick_wood(draw), stock.pick_fabric(draw));
    let (thing, leaf) = (stock.pick_thing(draw), stock.pick_leaf(draw));
    let mut b = Builder { foot, mesh, draw };
    let shift = b.shift();
    match piece {
        Piece::Cabinet { width, depth, height } => {
            let material = if b.draw.chance(0.7) { wood } else { thing };
            b.block([0.0, 0.0], [0.0, height], [width, depth], material);
        }
        Piece::Table { width, depth } => {
            b.block([0.0, 0.0], [0.7, 0.76], [width, depth], wood);
            b.legs(0.7, [width, depth], 0.08, wood);
            for _ in 0..b.draw.index(4) {
                let size = b.draw.range(0.1, 0.24);
                let centre = [0.5 * (width - size) * b.draw.range(-1.0, 1.0), 0.5 * (depth - size) * b.draw.range(-1.0, 1.0)];
                let skin = stock.pick_thing(b.draw);
                b.block(centre, [0.76, 0.76 + size], [size, size], skin);
            }
        }
        Piece::Chair => {
            b.block([0.0, 0.0], [0.42, 0.48], [0.46, 0.46], fabric);
            b.block([0.0, 0.2], [0.48, 0.95], [0.46, 0.06], wood);
            b.legs(0.42, [0.46, 0.46], 0.07, wood);
        }
        Piece::Sofa { width } => {
            b.block([0.0, -0.1], [0.0, 0.42], [width, 0.7], fabric);
            b.block([0.0, 0.35], [0.0, 0.85], [width, 0.2], fabric);
            for side in [-1.0, 1.0] {
                b.block([0.5 * side * (width - 0.2), -0.1], [0.42, 0.62], [0.2, 0.7], fabric);
            }
        }
        Piece::Thing { size } => {
            if b.draw.chance(0.75) {
                b.block([0.0, 0.0], [0.0, size], [size, size], thing);
            } else {
                b.mesh.ball(&b.at(0.0, 0.5 * size, 0.0), Vector3::repeat(0.5 * size), 1, thing, shift);
            }
        }
        Piece::Plant { radius } => {
            b.mesh.prism(&b.at(0.0, 0.0, 0.0), 0.6 * radius, 0.4, 9, thing, shift);
            let half = Vector3::new(radius, 1.1 * radius, radius);
            b.mesh.ball(&b.at(0.0, 0.4 + 1.1 * radius, 0.0), half, 1, leaf, shift);
        }
        Piece::StandingLamp => {
            b.mesh.prism(&b.at(0.0, 0.0, 0.0), 0.18, 0.05, 9, wood, shift);
            b.mesh.prism(&b.at(0.0, 0.05, 0.0), 0.04, 1.25, 6, wood, shift);
            b.mesh.cone(&b.at(0.0, 1.3, 0.0), 0.25, 0.3, 9, fabric, shift);
        }
        Piece::HangingLamp { drop } => {
            b.mesh.prism(&b.at(0.0, -drop + 0.2, 0.0), 0.03, drop - 0.2, 6, wood, shift);
            b.mesh.cone(&b.at(0.0, -drop, 0.0), 0.25, 0.3, 9, fabric, shift);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dimode_geometry::Se3;

    /// Clearance is checked with `half` before a piece is built.
    #[test]
    fn pieces_fill_the_size_they_name_and_no_more() {
        let mut draw = Draw::new(3, 0);
        let mut scene = Scene::new(vec![Se3::identity()]);
        let stock = Stock::new(&mut scene, &mut draw);
        let mut pieces: Vec<_> = (0..60).map(|i| Piece::at_wall(&mut draw, i % 2 == 0)).collect();
        pieces.extend((0..60).map(|i| Piece::anywhere(&mut draw, i % 2 == 0)));
        pieces.push(Piece::HangingLamp { drop: 0.7 });
        for piece in pieces {
            let mut mesh = Mesh::default();
            let foot = Placement::upright(Vector3::new(1.0, 2.0, 3.0), 0.4);
            build(piece, &foot, &stock, &mut draw, &mut mesh);
            let half = piece.half();
            let hangs = matches!(piece, Piece::HangingLamp { .. });
            let middle = foot.position + Vector3::new(0.0, if hangs { half.y } else { -half.y }, 0.0);
            let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
            for face in &mesh.faces {
                let corners = [Vector3::zeros(), face.edge_s, face.edge_t, (face.limit - 1.0) * (face.edge_s + face.edge_t)];
                for corner in corners {
                    let local = foot.rotation.transpose() * (face.origin + corner - middle);
                    (low, high) = (low.inf(&local), high.sup(&local));
                }
            }
            assert!((high - half).max() < 1e-9 && (low + half).min() > -1e-9, "{piece:?}: {low} to {high}");
            assert!(high.y - low.y > 1.4 * half.y, "{piece:?} is {} m high", high.y - low.y);
        }
    }
}
