//! The colour wheel of published flow pictures, and its legend.
//!
//! 55 hues around the circle, unevenly spaced because the eye tells yellows and greens apart less well than reds and blues
//! (Baker et al., *A Database and Evaluation Methodology for Optical Flow*, 2007): red to yellow in 15 steps, to green in 6, to
//! cyan in 4, to blue in 11, to magenta in 13, back to red in 6. No motion is white, colours are full at the scale, and beyond
//! it they are darkened to three quarters. Motion to the right is red, downwards yellow, to the left light blue, upwards violet.

use super::colour::{Rgb, UNKNOWN};
use super::picture::Picture;
use super::pixel_text::{HEIGHT, draw, width_of};
use crate::data::FlowMap;

/// Steps from each of the six corners of the colour cube (red, yellow, green, cyan, blue, magenta) to the next one.
const STEPS: [usize; 6] = [15, 6, 4, 11, 13, 6];
/// Hues of the wheel.
const HUES: usize = 55;
/// Part of a colour that is left beyond the scale.
const BEYOND: f64 = 0.75;

/// The hue at a place on the wheel, 0 to [`HUES`]; parts of full brightness.
fn hue(place: usize) -> [f64; 3] {
    let (mut corner, mut step) = (0, place % HUES);
    while step >= STEPS[corner] {
        step -= STEPS[corner];
        corner += 1;
    }
    // Corners alternate: a colour comes in, then the one before goes out.
    let share = (255.0 * step as f64 / STEPS[corner] as f64).floor() / 255.0;
    let (full, changing, value) = match corner {
        0 => (0, 1, share),
        1 => (1, 0, 1.0 - share),
        2 => (1, 2, share),
        3 => (2, 1, 1.0 - share),
        4 => (2, 0, share),
        _ => (0, 2, 1.0 - share),
    };
    let mut colour = [0.0; 3];
    colour[full] = 1.0;
    colour[changing] = value;
    colour
}

/// Colour of a displacement (`u` right, `v` down) in units of the scale. Values that are not finite get [`UNKNOWN`].
pub fn wheel_colour(u: f64, v: f64) -> Rgb {
    let length = u.hypot(v);
    if !length.is_finite() {
        return UNKNOWN;
    }
    let turn = (-v).atan2(-u) / std::f64::consts::PI;
    let place = 0.5 * (turn + 1.0) * (HUES - 1) as f64;
    let low = (place as usize).min(HUES - 1);
    let share = place - low as f64;
    let (a, b) = (hue(low), hue(low + 1));
    std::array::from_fn(|i| {
        let colour = (1.0 - share) * a[i] + share * b[i];
        let colour = if length <= 1.0 { 1.0 - length * (1.0 - colour) } else { BEYOND * colour };
        (255.0 * colour).floor() as u8
    })
}

/// A round number of pixels at or above `length`: 1, 1.5, 2, 3, 4, 6 or 8 times a power of ten, at least 0.5.
pub fn round_scale(length: f64) -> f64 {
    let length = if length.is_finite() { length.min(1e9) } else { 0.0 };
    if length <= 0.5 {
        return 0.5;
    }
    let power = 10f64.powf(length.log10().floor());
    let rounds = [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0].map(|factor| factor * power);
    // Rounding of the logarithm must not push a round number to the next one.
    rounds.into_iter().find(|scale| *scale >= 0.999_999 * length).unwrap_or(10.0 * power)
}

impl Picture {
    /// Flow in pixels in the colours of [`wheel_colour`], full at `scale` pixels; unknown pixels are grey.
    ///
    /// **Panics** unless there is one flag per pixel.
    #[track_caller]
    pub fn from_flow_by_wheel(flow: &FlowMap, known: &[bool], scale: f64) -> Self {
        assert_eq!(known.len(), flow.u.len(), "Picture::from_flow_by_wheel: one flag per pixel");
        let colour = |((u, v), known): ((&f32, &f32), &bool)| {
            if *known { wheel_colour(f64::from(*u) / scale, f64::from(*v) / scale) } else { UNKNOWN }
        };
        let pixels = flow.u.iter().zip(&flow.v).zip(known).map(colour).map(|[r, g, b]| [r, g, b, 255]).collect();
        Self { width: flow.width, height: flow.height, pixels }
    }

    /// What explains pictures of [`Picture::from_flow_by_wheel`]: the wheel with rings at the half and the whole scale, the scale
    /// in pixels written beside them.
    pub fn flow_legend(scale: f64) -> Self {
        const MARGIN: usize = 12;
        const RADIUS: usize = 96;
        /// Letters are this many pixels a dot.
        const DOT: usize = 2;
        let labels = [format!("{} px", number(0.5 * scale)), format!("{} px", number(scale))];
        let side = 2 * (MARGIN + RADIUS);
        let width = side.max(2 * MARGIN + DOT * labels.iter().map(|label| width_of(label)).max().unwrap_or(0));
        let mut picture = Self { width, height: side + DOT * HEIGHT + MARGIN, pixels: Vec::new() };
        picture.pixels = vec![[255; 4]; picture.width * picture.height];
        let centre = [0.5 * width as f64, 0.5 * side as f64];
        for row in 0..side {
            for column in 0..width {
                let [u, v] = [column as f64 + 0.5 - centre[0], row as f64 + 0.5 - centre[1]].map(|x| x / RADIUS as f64);
                let length = u.hypot(v);
                let ring = [0.5, 1.0].iter().any(|ring| (length - ring).abs() < 0.5 / RADIUS as f64);
                if ring || length <= 1.0 {
                    let [r, g, b] = if ring { [60; 3] } else { wheel_colour(u, v) };
                    picture.pixels[row * width + column] = [r, g, b, 255];
                }
            }
        }
        // The half inside its ring at the bottom, the whole below the wheel.
        let [half, whole] = &labels;
        let put = |picture: &mut Self, text: &str, top: usize| {
            draw(picture, text, (width.saturating_sub(DOT * width_of(text)) / 2, top), DOT);
        };
        put(&mut picture, half, MARGIN + RADIUS + RADIUS / 2 - DOT * HEIGHT - 4);
        put(&mut picture, whole, side);
        picture
    }
}

/// A number without zeros that say nothing.
fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_have_the_published_colours() {
        assert_eq!(wheel_colour(0.0, 0.0), [255, 255, 255]);
        assert_eq!(hue(0), [1.0, 0.0, 0.0]);
        let [right, down, left, up] = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)].map(|(u, v)| wheel_colour(u, v));
        assert!(right[0] == 255 && right[1] < 20 && right[2] < 45, "red: {right:?}");
        assert!(down[0] > 220 && down[1] > 220 && down[2] < 20, "yellow: {down:?}");
        assert!(left[0] < 20 && left[1] > 200 && left[2] == 255, "cyan to blue: {left:?}");
        assert!(up[0] > 80 && up[1] < 20 && up[2] == 255, "violet: {up:?}");
    }

    #[test]
    fn lengths_beyond_the_scale_are_darker() {
        for (u, v) in [(1.0, 0.2), (-0.3, 0.9)] {
            let length = f64::hypot(u, v);
            let (full, beyond) = (wheel_colour(u / length, v / length), wheel_colour(1.1 * u / length, 1.1 * v / length));
            for (full, beyond) in full.into_iter().zip(beyond) {
                assert!((0.75 * f64::from(full) - f64::from(beyond)).abs() < 2.0, "{full} {beyond}");
            }
        }
        assert_eq!(wheel_colour(f64::NAN, 0.0), UNKNOWN);
    }

    #[test]
    fn the_wheel_has_55_hues_and_no_jump_but_the_published_one_from_last_to_first() {
        assert_eq!(STEPS.iter().sum::<usize>(), HUES);
        let colour = |i: usize| {
            let angle = i as f64 * std::f64::consts::TAU / 720.0;
            wheel_colour(angle.cos(), angle.sin())
        };
        for i in 0..720 {
            let (a, b) = (colour(i), colour(i + 1));
            assert!((0..3).all(|k| a[k].abs_diff(b[k]) < 12), "{i}: {a:?} {b:?}");
        }
    }

    #[test]
    fn scales_are_round_and_never_below_the_length() {
        let rounded = [0.0, 0.5, 0.7, 1.0, 1.3, 2.0, 2.1, 7.0, 10.0, 99.0, f64::NAN].map(round_scale);
        assert_eq!(rounded, [0.5, 0.5, 0.8, 1.0, 1.5, 2.0, 3.0, 8.0, 10.0, 100.0, 0.5]);
        assert_eq!([0.25, 5.0, 20.0].map(number), ["0.25", "5", "20"]);
    }

    #[test]
    fn the_legend_shows_wheel_and_scale() {
        let legend = Picture::flow_legend(20.0);
        let at = |u: usize, v: usize| legend.pixels[v * legend.width + u];
        assert_eq!(at(0, 0), [255; 4]);
        assert_eq!(at(108 + 80, 108), {
            let [r, g, b] = wheel_colour(80.5 / 96.0, 0.5 / 96.0);
            [r, g, b, 255]
        });
        let dark = |rows: std::ops::Range<usize>| {
            legend.pixels[rows.start * legend.width..rows.end * legend.width].iter().filter(|p| p[0] < 40 && p[1] < 40).count()
        };
        assert!(dark(216..legend.height) > 60, "the scale is written");
        assert_ne!(Picture::flow_legend(5.0), legend);
    }
}
