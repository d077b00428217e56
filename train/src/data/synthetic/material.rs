//! A random stock of materials: walls, objects, ground.

use super::random::Draw;
use super::texture::{Material, Octave, Pattern};

/// A random albedo: lightness in [lo, hi], with the given saturation.
pub fn colour(draw: &mut Draw, lo: f64, hi: f64, saturation: f64) -> [f32; 3] {
    let light = draw.range(lo, hi);
    let hue = draw.range(0.0, std::f64::consts::TAU);
    let amount = saturation * draw.range(0.3, 1.0);
    [0.0, 2.1, 4.2].map(|phase| (light * (1.0 + amount * (hue + phase).cos())).clamp(0.04, 0.96) as f32)
}

/// An albedo of building stone, plaster or paving: grey to warm, now and then cool.
pub fn stone(draw: &mut Draw, lo: f64, hi: f64) -> [f32; 3] {
    let light = draw.range(lo, hi);
    let warm = draw.range(-0.06, 0.22);
    let red = if warm > 0.0 { warm * draw.range(0.0, 0.6) } else { 0.0 };
    [light * (1.0 + 0.5 * warm + red), light, light * (1.0 - warm - 0.5 * red)].map(|c| c.clamp(0.04, 0.96) as f32)
}

/// The range of cell sizes of a noise stack, metres, and how much the cells are stretched along both coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Grain {
    /// Largest cell.
    pub coarse: f64,
    /// Smallest cell.
    pub fine: f64,
    /// Cell length along (u, v) as a multiple of the cell size.
    pub stretch: [f64; 2],
    /// Amplitude of each layer.
    pub amplitude: f64,
}

impl Grain {
    /// Round grains.
    pub fn new(coarse: f64, fine: f64, amplitude: f64) -> Self {
        Self { coarse, fine, stretch: [1.0, 1.0], amplitude }
    }

    /// The same grains stretched along both coordinates.
    pub fn stretched(self, along_u: f64, along_v: f64) -> Self {
        Self { stretch: [along_u, along_v], ..self }
    }

    /// Noise layers, each half the cell size of the one before, tinted mostly by lightness.
    pub fn octaves(&self, draw: &mut Draw) -> Vec<Octave> {
        let mut octaves = Vec::new();
        let mut cell = self.coarse * draw.range(0.8, 1.2);
        while cell >= self.fine {
            let hue = draw.range(0.0, std::f64::consts::TAU);
            let tint = [0.0, 2.1, 4.2].map(|phase| (self.amplitude * (1.0 + 0.3 * (hue + phase).cos())) as f32);
            octaves.push(Octave {
                frequency: self.stretch.map(|s| (1.0 / (cell * s)) as f32),
                offset: [draw.range(0.0, 64.0) as f32, draw.range(0.0, 64.0) as f32],
                tint,
            });
            cell *= 0.5;
        }
        octaves
    }
}

/// A wall of a building: windows, bricks or plaster.
pub fn facade(draw: &mut Draw) -> Material {
    let base = stone(draw, 0.32, 0.75);
    let mut octaves = Grain::new(3.0, 0.1, 0.13).octaves(draw);
    octaves.extend(Grain::new(0.8, 0.15, 0.10).stretched(6.0, 1.0).octaves(draw));
    let pane = colour(draw, 0.08, 0.35, 0.15);
    let pattern = match draw.index(6) {
        0 => Pattern::Bricks(draw.range(0.5, 1.2) as f32, draw.range(0.25, 0.5) as f32, stone(draw, 0.5, 0.8)),
        1 => Pattern::Rows(draw.range(0.5, 1.5) as f32, 0.4, pane, 0.6),
        _ => Pattern::Windows(
            [draw.range(1.2, 3.0) as f32, draw.range(1.4, 3.2) as f32],
            [draw.range(0.4, 0.65) as f32, draw.range(0.4, 0.65) as f32],
            pane,
        ),
    };
    Material { base, octaves, pattern }
}

/// The skin of an object of about `size` metres.
pub fn object(draw: &mut Draw, size: f64) -> Material {
    let base = colour(draw, 0.2, 0.78, 0.6);
    let mut octaves = Grain::new(0.8 * size, 0.02 * size.max(1.0), 0.15).octaves(draw);
    if draw.chance(0.3) {
        octaves.extend(Grain::new(0.3 * size, 0.05 * size, 0.12).stretched(1.0, 5.0).octaves(draw));
    }
    let other = colour(draw, 0.1, 0.9, 0.6);
    let period = (size * draw.range(0.25, 0.7)) as f32;
    let pattern = match draw.index(7) {
        0 => Pattern::Stripes(period, 0.5, other, 0.7),
        1 => Pattern::Rows(period, 0.45, other, 0.7),
        2 => Pattern::Checker(0.5 * period, other, 0.6),
        3 => Pattern::Bricks(period, 0.5 * period, other),
        _ => Pattern::Plain,
    };
    Material { base, octaves, pattern }
}

/// Wood: browns, grained along its length.
pub fn wood(draw: &mut Draw) -> Material {
    let light = draw.range(0.22, 0.6);
    let base = [light * draw.range(1.1, 1.35), light, light * draw.range(0.55, 0.8)].map(|c| c as f32);
    let mut octaves = Grain::new(0.3, 0.03, 0.10).stretched(5.0, 1.0).octaves(draw);
    octaves.extend(Grain::new(0.6, 0.05, 0.08).octaves(draw));
    Material { base, octaves, pattern: Pattern::Plain }
}

/// Cloth of chairs and carpets: strong colours, fine grain.
pub fn fabric(draw: &mut Draw) -> Material {
    let base = colour(draw, 0.2, 0.65, 0.45);
    let octaves = Grain::new(0.5, 0.02, 0.13).octaves(draw);
    let other = colour(draw, 0.15, 0.8, 0.45);
    let pattern = match draw.index(4) {
        0 => Pattern::Stripes(draw.range(0.12, 0.2) as f32, 0.5, other, 0.6),
        1 => Pattern::Checker(draw.range(0.1, 0.16) as f32, other, 0.5),
        _ => Pattern::Plain,
    };
    Material { base, octaves, pattern }
}

/// The floor of a room: boards, tiles or carpet, darker than the walls.
pub fn floor(draw: &mut Draw) -> Material {
    match draw.index(3) {
        0 => {
            let dark = colour(draw, 0.1, 0.2, 0.3);
            Material { pattern: Pattern::Bricks(1.4, 0.18, dark), ..wood(draw) }
        }
        1 => {
            let base = stone(draw, 0.35, 0.6);
            let octaves = Grain::new(1.2, 0.04, 0.11).octaves(draw);
            Material { base, octaves, pattern: Pattern::Bricks(0.4, 0.4, stone(draw, 0.2, 0.7)) }
        }
        _ => Material {
            base: colour(draw, 0.2, 0.5, 0.4),
            octaves: Grain::new(1.2, 0.03, 0.14).octaves(draw),
            pattern: Pattern::Plain,
        },
    }
}

/// The wall of a room: pale paint with stains, wallpaper or brick.
pub fn paint(draw: &mut Draw) -> Material {
    let base = colour(draw, 0.5, 0.75, 0.2);
    let octaves = Grain::new(1.6, 0.03, 0.10).octaves(draw);
    let other = colour(draw, 0.4, 0.85, 0.25);
    let pattern = match draw.index(5) {
        0 => Pattern::Bricks(0.3, 0.12, other),
        1 => Pattern::Stripes(draw.range(0.25, 0.35) as f32, 0.5, other, 0.5),
        _ => Pattern::Plain,
    };
    Material { base, octaves, pattern }
}

/// The ceiling of a room, white woodwork: bright, in panels or plain.
pub fn ceiling(draw: &mut Draw) -> Material {
    let base = stone(draw, 0.72, 0.86);
    let octaves = Grain::new(1.2, 0.04, 0.07).octaves(draw);
    let pattern = if draw.chance(0.5) { Pattern::Bricks(0.6, 0.6, stone(draw, 0.5, 0.65)) } else { Pattern::Plain };
    Material { base, octaves, pattern }
}

/// A window: dark or bright glass between bars.
pub fn pane(draw: &mut Draw) -> Material {
    let frame = stone(draw, 0.6, 0.85);
    let glass = if draw.chance(0.5) { colour(draw, 0.1, 0.3, 0.2) } else { colour(draw, 0.8, 0.95, 0.05) };
    Material {
        base: frame,
        octaves: Grain::new(0.5, 0.05, 0.06).octaves(draw),
        pattern: Pattern::Windows([0.5, 0.6], [0.8, 0.8], glass),
    }
}

/// Leaves: strong irregular contrast in greens and browns.
pub fn foliage(draw: &mut Draw) -> Material {
    let light = draw.range(0.25, 0.5);
    let base = [0.75 * light * draw.range(0.7, 1.5), light, 0.55 * light].map(|c| c as f32);
    Material { base, octaves: Grain::new(1.5, 0.06, 0.16).octaves(draw), pattern: Pattern::Plain }
}

/// Paving: plain, or in slabs.
pub fn paving(draw: &mut Draw) -> Material {
    let base = stone(draw, 0.4, 0.66);
    let mut octaves = Grain::new(2.4, 0.1, 0.12).octaves(draw);
    octaves.extend(Grain::new(0.8, 0.15, 0.11).stretched(1.0, 6.0).octaves(draw));
    let pattern = match draw.index(3) {
        0 => Pattern::Plain,
        _ => Pattern::Bricks(draw.range(0.4, 1.0) as f32, draw.range(0.3, 0.7) as f32, stone(draw, 0.3, 0.7)),
    };
    Material { base, octaves, pattern }
}

/// Open ground: grass, gravel or paving, with grains stretched along neither axis.
pub fn open_ground(draw: &mut Draw) -> Material {
    let base = if draw.chance(0.5) {
        let light = draw.range(0.3, 0.5);
        [light * draw.range(0.7, 1.05), light, light * 0.6].map(|c| c as f32)
    } else {
        stone(draw, 0.32, 0.58)
    };
    Material { base, octaves: Grain::new(12.0, 0.05, 0.14).octaves(draw), pattern: Pattern::Plain }
}
