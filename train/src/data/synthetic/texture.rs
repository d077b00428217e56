//! Textures in surface coordinates, band-limited analytically.
//!
//! A texture is a sum of noise octaves and of patterns with edges. The pixel footprint (how far one pixel step moves on the
//! surface) decides what can be seen: an octave fades out before its cells shrink to two pixels, and an edge is averaged over
//! about two pixels by an exact box filter. So a texture sampled once a pixel has no aliasing at any distance or angle.

use super::random::Draw;

/// Side of the noise lattice (a power of two).
const LATTICE: usize = 64;
/// Lattice cells a pixel at which an octave begins to fade.
const FADE_START: f32 = 0.14;
/// Lattice cells a pixel at which an octave is gone.
const FADE_END: f32 = 0.38;
/// Width in pixels of the filter of pattern edges.
const EDGE_PIXELS: f32 = 2.2;

/// A periodic lattice of random values in [-1, 1].
pub struct NoiseTable {
    values: Box<[f32; LATTICE * LATTICE]>,
}

/// The whole number below `x` and the rest in [0, 1]. At a whole `x` either neighbour with rest 0 or 1 may come out.
///
/// Adding 1.5 * 2^23 leaves the rounded number in the low bits: no branch and no call. Valid for |x| below 2^22.
#[inline(always)]
pub fn split(x: f32) -> (i32, f32) {
    const MAGIC: f32 = 12_582_912.0;
    let shifted = (x - 0.5) + MAGIC;
    let whole = shifted.to_bits().wrapping_sub(MAGIC.to_bits()) as i32;
    (whole, x - (shifted - MAGIC))
}

/// 0 below `lo`, 1 above `hi`, a cubic between.
#[inline(always)]
pub fn smoothstep(lo: f32, hi: f32, x: f32) -> f32 {
    let t = ((x - lo) / (hi - lo)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl NoiseTable {
    /// A table of well-separated values.
    pub fn new(draw: &mut Draw) -> Self {
        let mut values = Box::new([0.0; LATTICE * LATTICE]);
        for value in values.iter_mut() {
            *value = (draw.sign() * draw.range(0.45, 1.0)) as f32;
        }
        Self { values }
    }

    /// The lattice value of a cell.
    #[inline(always)]
    pub fn cell(&self, i: i32, j: i32) -> f32 {
        let mask = LATTICE as i32 - 1;
        self.values[((j & mask) as usize) * LATTICE + (i & mask) as usize]
    }

    /// Value noise: the lattice interpolated by a cubic, about 0.5 standard deviation.
    #[inline(always)]
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let ((i, fx), (j, fy)) = (split(x), split(y));
        let (wx, wy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
        let (a, b) = (self.cell(i, j), self.cell(i + 1, j));
        let (c, d) = (self.cell(i, j + 1), self.cell(i + 1, j + 1));
        let (top, bottom) = (a + wx * (b - a), c + wx * (d - c));
        top + wy * (bottom - top)
    }
}

/// How surface coordinates (metres) change by one pixel step to the right and one down.
#[derive(Clone, Copy, Debug)]
pub struct Footprint {
    /// Change of the first coordinate by a step right and by a step down.
    pub u: [f32; 2],
    /// Change of the second coordinate by a step right and by a step down.
    pub v: [f32; 2],
}

impl Footprint {
    /// Lattice cells a pixel for a lattice of `fu` x `fv` cells a metre, the larger of both pixel directions, squared.
    #[inline(always)]
    fn cells_squared(&self, fu: f32, fv: f32) -> f32 {
        let step = |k: usize| (fu * self.u[k]).powi(2) + (fv * self.v[k]).powi(2);
        step(0).max(step(1))
    }

    /// The contrast left of a lattice of `fu` x `fv` cells a metre, 0 to 1.
    #[inline(always)]
    pub fn contrast(&self, fu: f32, fv: f32) -> f32 {
        let squared = self.cells_squared(fu, fv);
        if squared >= FADE_END * FADE_END {
            0.0
        } else if squared <= FADE_START * FADE_START {
            1.0
        } else {
            1.0 - smoothstep(FADE_START, FADE_END, squared.sqrt())
        }
    }

    /// Width of the edge filter along the first coordinate, metres.
    #[inline(always)]
    pub fn width_u(&self) -> f32 {
        EDGE_PIXELS * (self.u[0] * self.u[0] + self.u[1] * self.u[1]).sqrt()
    }

    /// Width of the edge filter along the second coordinate, metres.
    #[inline(always)]
    pub fn width_v(&self) -> f32 {
        EDGE_PIXELS * (self.v[0] * self.v[0] + self.v[1] * self.v[1]).sqrt()
    }
}

/// Average over a window of `width` around `x` of the wave that is 1 in the first `duty` of each unit period, else 0.
#[inline(always)]
pub fn pulse(x: f32, duty: f32, width: f32) -> f32 {
    let width = width.max(1e-4);
    let integral = |x: f32| {
        let (whole, rest) = split(x);
        whole as f32 * duty + rest.min(duty)
    };
    (integral(x + 0.5 * width) - integral(x - 0.5 * width)) / width
}

/// The step from 0 to 1 at `edge`, averaged over a window of `width` around `x`.
#[inline(always)]
pub fn step(edge: f32, x: f32, width: f32) -> f32 {
    ((x - edge) / width.max(1e-4) + 0.5).clamp(0.0, 1.0)
}

/// One layer of noise.
#[derive(Clone, Copy, Debug)]
pub struct Octave {
    /// Cells a metre along both surface coordinates.
    pub frequency: [f32; 2],
    /// Offset in cells.
    pub offset: [f32; 2],
    /// What a noise value of 1 adds to red, green, blue.
    pub tint: [f32; 3],
}

/// A pattern with edges on top of the noise.
#[derive(Clone, Copy, Debug)]
pub enum Pattern {
    /// None.
    Plain,
    /// Bands along the first coordinate: period in metres, share of the band, colour, strength.
    Stripes(f32, f32, [f32; 3], f32),
    /// Bands across, along the second coordinate.
    Rows(f32, f32, [f32; 3], f32),
    /// Two-coloured squares of the given side in metres.
    Checker(f32, [f32; 3], f32),
    /// Bricks: length, height, mortar colour; every brick has its own brightness.
    Bricks(f32, f32, [f32; 3]),
    /// Windows: column and row distance in metres, shares of the pane, colour; every pane has its own brightness.
    Windows([f32; 2], [f32; 2], [f32; 3]),
}

/// The look of a surface.
#[derive(Clone, Debug)]
pub struct Material {
    /// Mean albedo.
    pub base: [f32; 3],
    /// Noise layers, coarse to fine.
    pub octaves: Vec<Octave>,
    /// The pattern.
    pub pattern: Pattern,
}

/// a + w (b - a) for colours.
#[inline(always)]
pub fn blend(a: [f32; 3], b: [f32; 3], w: f32) -> [f32; 3] {
    [a[0] + w * (b[0] - a[0]), a[1] + w * (b[1] - a[1]), a[2] + w * (b[2] - a[2])]
}

/// Adds the visible noise layers at (u, v) metres to a colour.
#[inline(always)]
pub fn add_octaves(
    mut colour: [f32; 3],
    octaves: &[Octave],
    table: &NoiseTable,
    [u, v]: [f32; 2],
    footprint: &Footprint,
) -> [f32; 3] {
    for octave in octaves {
        let [fu, fv] = octave.frequency;
        let contrast = footprint.contrast(fu, fv);
        if contrast > 0.0 {
            let n = contrast * table.at(u * fu + octave.offset[0], v * fv + octave.offset[1]);
            for (c, tint) in colour.iter_mut().zip(octave.tint) {
                *c += n * tint;
            }
        }
    }
    colour
}

impl Material {
    /// Albedo at surface coordinates (u, v) in metres, seen with the given footprint; may leave [0, 1] a little.
    pub fn albedo(&self, table: &NoiseTable, at: [f32; 2], footprint: &Footprint) -> [f32; 3] {
        let colour = add_octaves(self.base, &self.octaves, table, at, footprint);
        let noise = [0, 1, 2].map(|c| 0.6 * (colour[c] - self.base[c]));
        self.pattern.apply(colour, noise, table, at, footprint)
    }
}

impl Pattern {
    /// The colour with the pattern laid over it; the second colour of the pattern carries `noise` too.
    #[inline(always)]
    fn apply(&self, colour: [f32; 3], noise: [f32; 3], table: &NoiseTable, [u, v]: [f32; 2], footprint: &Footprint) -> [f32; 3] {
        let textured = |other: [f32; 3]| [0, 1, 2].map(|c| other[c] + noise[c]);
        match *self {
            Self::Plain => colour,
            Self::Stripes(period, duty, other, strength) => {
                let f = 1.0 / period;
                blend(colour, textured(other), strength * pulse(u * f, duty, footprint.width_u() * f))
            }
            Self::Rows(period, duty, other, strength) => {
                let f = 1.0 / period;
                blend(colour, textured(other), strength * pulse(v * f, duty, footprint.width_v() * f))
            }
            Self::Checker(side, other, strength) => {
                let f = 0.5 / side;
                let a = 2.0 * pulse(u * f, 0.5, footprint.width_u() * f) - 1.0;
                let b = 2.0 * pulse(v * f, 0.5, footprint.width_v() * f) - 1.0;
                blend(colour, textured(other), strength * (0.5 + 0.5 * a * b))
            }
            Self::Bricks(length, height, mortar) => bricks(colour, mortar, [length, height], table, [u, v], footprint),
            Self::Windows(pitch, share, pane) => {
                let [fu, fv] = [1.0 / pitch[0], 1.0 / pitch[1]];
                let (x, y) = (u * fu, v * fv);
                let inside = pulse(x, share[0], footprint.width_u() * fu) * pulse(y, share[1], footprint.width_v() * fv);
                let own = 0.28
                    * footprint.contrast(fu, fv)
                    * table.cell(split(x + 0.5 * (1.0 - share[0])).0 + 17, split(y + 0.5 * (1.0 - share[1])).0);
                blend(colour, textured(pane).map(|c| (c + own).max(0.02)), inside)
            }
        }
    }
}

/// Bricks in rows shifted by half a brick: mortar between them, and a brightness of its own for each.
#[inline(always)]
fn bricks(
    colour: [f32; 3],
    mortar: [f32; 3],
    [length, height]: [f32; 2],
    table: &NoiseTable,
    [u, v]: [f32; 2],
    footprint: &Footprint,
) -> [f32; 3] {
    let [fu, fv] = [1.0 / length, 1.0 / height];
    let y = v * fv;
    let row = split(y).0;
    let x = u * fu + 0.5 * (row & 1) as f32;
    let seam_v = pulse(y, 0.14, footprint.width_v() * fv);
    let seam_u = pulse(x, 0.14 * height / length, footprint.width_u() * fu);
    // The mean over both rows where rows can no longer be told apart.
    let seam_u = seam_u * footprint.contrast(0.0, 0.7 * fv);
    let own = 0.16 * footprint.contrast(fu, fv) * table.cell(split(x - 0.07).0, split(y - 0.07).0);
    let brick = colour.map(|c| c + own);
    blend(brick, mortar, 1.0 - (1.0 - seam_u) * (1.0 - seam_v))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulse_averages_to_its_duty_and_keeps_flat_parts() {
        assert!((pulse(0.2, 0.5, 0.01) - 1.0).abs() < 1e-3);
        assert!(pulse(0.7, 0.5, 0.01).abs() < 1e-3);
        assert!((pulse(0.5, 0.5, 0.1) - 0.5).abs() < 1e-5);
        assert!((pulse(-3.2, 0.3, 100.0) - 0.3).abs() < 0.01);
        assert!((pulse(-0.9, 0.3, 0.01) - 1.0).abs() < 1e-3, "negative coordinates wrap as positive ones");
    }

    #[test]
    fn octaves_fade_before_two_pixels_a_cell() {
        let footprint = |w: f32| Footprint { u: [w, 0.0], v: [0.0, 0.1 * w] };
        assert_eq!(footprint(0.1).contrast(1.0, 1.0), 1.0);
        assert_eq!(footprint(0.5).contrast(1.0, 1.0), 0.0);
        let half = footprint(0.28).contrast(1.0, 1.0);
        assert!(half > 0.2 && half < 0.8);
        assert_eq!(footprint(0.5).contrast(0.1, 1.0), 1.0, "each direction has its own limit");
    }

    #[test]
    fn noise_is_continuous_periodic_and_has_contrast() {
        let table = NoiseTable::new(&mut Draw::new(5, 0));
        let mut sum = [0.0f64; 2];
        for i in 0..10_000 {
            let (x, y) = (0.37 * i as f32 - 500.0, 0.11 * i as f32);
            let n = table.at(x, y);
            assert!((table.at(x + 1e-3, y) - n).abs() < 0.02);
            sum[0] += f64::from(n);
            sum[1] += f64::from(n * n);
        }
        let deviation = (sum[1] / 1e4 - (sum[0] / 1e4).powi(2)).sqrt();
        assert!((0.35..0.7).contains(&deviation), "{deviation}");
        assert!((table.at(1.25, 2.5) - table.at(65.25, -61.5)).abs() < 1e-4);
    }

    #[test]
    fn split_floors_negative_numbers() {
        assert_eq!(split(-1.25), (-2, 0.75));
        assert_eq!(split(2.5), (2, 0.5));
        let (whole, rest) = split(-3.0);
        assert_eq!(whole as f32 + rest, -3.0);
    }
}
