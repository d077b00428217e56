//! One window of a correlation plane: bilinear samples at integer steps around a centre, and their transpose.

use super::planes::add_row;
use crate::Scalar;

/// Position of a window: first cell, which may lie outside, and the fractional parts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corner<T> {
    x: isize,
    y: isize,
    part_x: T,
    part_y: T,
}

impl<T: Scalar> Corner<T> {
    pub(crate) fn new(cx: T, cy: T, level: usize, radius: usize) -> Self {
        let scale = 1.0 / (1_u64 << level) as f64;
        let axis = |c: T| {
            let at = c.to_f64() * scale;
            let low = at.floor();
            let part = if at.is_infinite() { 0.0 } else { at - low };
            // Far outside every plane is far enough: keeps the sums below from overflowing.
            (low.clamp(-1e9, 1e9) as isize - radius as isize, T::from_f64(part))
        };
        let ((x, part_x), (y, part_y)) = (axis(cx), axis(cy));
        Self { x, y, part_x, part_y }
    }

    pub(crate) fn is_nan(&self) -> bool {
        self.part_x.is_nan() || self.part_y.is_nan()
    }
}

/// The part of `start..start + span` inside `0..size`, counted from `start`.
#[inline(always)]
fn inside(start: isize, span: usize, size: usize) -> std::ops::Range<usize> {
    let low = (-start).clamp(0, span as isize) as usize;
    let high = (size as isize - start).clamp(low as isize, span as isize) as usize;
    low..high
}

/// One level: plane size, level number and window radius.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Level {
    pub(crate) height: usize,
    pub(crate) width: usize,
    pub(crate) level: usize,
    pub(crate) radius: usize,
}

impl Level {
    /// Window side D.
    pub(crate) fn side(&self) -> usize {
        2 * self.radius + 1
    }

    pub(crate) fn plane(&self) -> usize {
        self.height * self.width
    }

    /// Samples the window of one plane into `out`, D^2 values with x slow; `patch` and `blended` are scratch.
    pub(crate) fn sample<T: Scalar>(&self, plane: &[T], corner: Corner<T>, scratch: &mut Scratch<T>, out: &mut [T]) {
        let (d, span) = (self.side(), self.side() + 1);
        let Scratch { patch, blended } = scratch;
        let (rows, columns) = (inside(corner.y, span, self.height), inside(corner.x, span, self.width));
        if rows.is_empty() || columns.is_empty() {
            out.fill(T::ZERO);
            return;
        }
        patch.fill(T::ZERO);
        for row in rows {
            let start = (corner.y + row as isize) as usize * self.width;
            let from = (corner.x + columns.start as isize) as usize;
            let source = &plane[start + from..][..columns.len()];
            patch[row * span..][columns.clone()].copy_from_slice(source);
        }
        let (a, b) = (corner.part_x, corner.part_y);
        for (row, line) in patch.chunks_exact(span).zip(blended.chunks_exact_mut(d)) {
            for ((o, &left), &right) in line.iter_mut().zip(row).zip(&row[1..]) {
                *o = (T::ONE - a) * left + a * right;
            }
        }
        for (i, column) in out.chunks_exact_mut(d).enumerate() {
            for (j, o) in column.iter_mut().enumerate() {
                *o = (T::ONE - b) * blended[j * d + i] + b * blended[(j + 1) * d + i];
            }
        }
    }

    /// Transpose of [`Level::sample`]: adds the window of gradients `g` into the plane.
    pub(crate) fn scatter<T: Scalar>(&self, g: &[T], corner: Corner<T>, scratch: &mut Scratch<T>, plane: &mut [T]) {
        let (d, span) = (self.side(), self.side() + 1);
        let (rows, columns) = (inside(corner.y, span, self.height), inside(corner.x, span, self.width));
        if rows.is_empty() || columns.is_empty() {
            return;
        }
        let Scratch { patch, blended } = scratch;
        let (a, b) = (corner.part_x, corner.part_y);
        blended.fill(T::ZERO);
        for (i, column) in g.chunks_exact(d).enumerate() {
            for (j, &g) in column.iter().enumerate() {
                blended[j * d + i] += (T::ONE - b) * g;
                blended[(j + 1) * d + i] += b * g;
            }
        }
        for (row, line) in patch.chunks_exact_mut(span).zip(blended.chunks_exact(d)) {
            row.fill(T::ZERO);
            for (i, &v) in line.iter().enumerate() {
                row[i] += (T::ONE - a) * v;
                row[i + 1] += a * v;
            }
        }
        for row in rows {
            let start = ((corner.y + row as isize) as usize * self.width) as isize + corner.x;
            let target = (start + columns.start as isize) as usize;
            let values = &patch[row * span..][columns.clone()];
            add_row(&mut plane[target..target + values.len()], values);
        }
    }
}

/// Scratch of one task: the cells under a window and their blend along x.
pub(crate) struct Scratch<T> {
    patch: Vec<T>,
    blended: Vec<T>,
}

impl<T: Scalar> Scratch<T> {
    pub(crate) fn new(level: &Level) -> Self {
        let span = level.side() + 1;
        Self { patch: vec![T::ZERO; span * span], blended: vec![T::ZERO; span * level.side()] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_covered_part_of_a_window() {
        assert_eq!(inside(-2, 4, 5), 2..4);
        assert_eq!(inside(3, 4, 5), 0..2);
        assert_eq!(inside(-1, 4, 2), 1..3);
        assert!(inside(5, 4, 5).is_empty() && inside(-4, 4, 5).is_empty());
        assert!(inside(900_000_000, 4, 5).is_empty() && inside(-900_000_000, 4, 5).is_empty());
    }

    #[test]
    fn scatter_is_the_transpose_of_sample() {
        let level = Level { height: 4, width: 3, level: 1, radius: 1 };
        let mut scratch = Scratch::new(&level);
        let plane: Vec<f64> = (0..12).map(|i| f64::from(i * i % 7) - 2.0).collect();
        let g: Vec<f64> = (0..9).map(|i| f64::from(i * 5 % 9) - 4.0).collect();
        for (cx, cy) in [(2.5, 3.25), (-1.0, 7.5), (5.75, -0.5), (-90.0, 1.0)] {
            let corner = Corner::new(cx, cy, level.level, level.radius);
            let (mut window, mut gradient) = (vec![7.0; 9], vec![0.0; 12]);
            level.sample(&plane, corner, &mut scratch, &mut window);
            level.scatter(&g, corner, &mut scratch, &mut gradient);
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            assert!((dot(&window, &g) - dot(&plane, &gradient)).abs() < 1e-12, "at {cx}, {cy}");
        }
    }

    #[test]
    fn the_centre_is_scaled_to_the_level() {
        let level = Level { height: 3, width: 3, level: 2, radius: 0 };
        let plane: Vec<f64> = (0..9).map(f64::from).collect();
        let mut out = [0.0];
        level.sample(&plane, Corner::new(4.0, 6.0, 2, 0), &mut Scratch::new(&level), &mut out);
        // (4, 6) is (1, 1.5) on level 2: between 4 and 7.
        assert_eq!(out, [5.5]);
    }
}
