//! Arrows for flow fields, and the keys that tell their lengths and directions.

use std::fmt::Write;

use nalgebra::Vector2;

use super::frame::Frame;
use super::sheet::{Anchor, Sheet, hex};
use crate::report::colour::{Rgb, direction};

/// Arrows shorter than this are dots, in units of the sheet.
const SHORTEST: f64 = 1.2;

/// A flow vector where it belongs, both in pixels of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrow {
    /// Pixel.
    pub at: Vector2<f64>,
    /// Flow.
    pub flow: Vector2<f64>,
}

/// How much longer than true flows are drawn so that nine of ten arrows are no longer than `length` pixels of the image. Rounded
/// to two digits, so that it can be written down.
pub fn magnification<'a>(arrows: impl Iterator<Item = &'a Arrow>, length: f64) -> f64 {
    let mut lengths: Vec<f64> = arrows.map(|a| a.flow.norm()).filter(|l| l.is_finite()).collect();
    lengths.sort_unstable_by(f64::total_cmp);
    let Some(last) = lengths.len().checked_sub(1) else { return 1.0 };
    let long = lengths[(0.9 * last as f64).round() as usize];
    if long <= 0.0 {
        return 1.0;
    }
    let exact = length / long;
    let step = 10f64.powf(exact.log10().floor() - 1.0);
    (exact / step).floor() * step
}

/// A positive number with two significant digits, without trailing noise.
fn two_digits(value: f64) -> String {
    let decimals = (1.0 - value.log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.decimals$}")
}

/// One arrow on the sheet; a dot where it is too short to see its direction.
pub fn draw_arrow(sheet: &mut Sheet, (x, y): (f64, f64), (u, v): (f64, f64), colour: Rgb) {
    let (length, colour) = (u.hypot(v), hex(colour));
    let mut markup = String::new();
    if length < SHORTEST || !length.is_finite() {
        let _ = write!(markup, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"0.9\" fill=\"{colour}\"/>");
        return sheet.raw(&markup);
    }
    let head = (0.42 * length).min(6.0);
    let (a, b) = (u / length, v / length);
    let neck = (x + u - a * head, y + v - b * head);
    let half = 0.42 * head;
    let _ = write!(
        markup,
        "<path d=\"M{x:.2} {y:.2}L{:.2} {:.2}\" stroke=\"{colour}\" stroke-width=\"1.3\"/><path d=\"M{:.2} {:.2}L{:.2} {:.2}L{:.2} {:.2}z\" fill=\"{colour}\"/>",
        neck.0,
        neck.1,
        x + u,
        y + v,
        neck.0 - b * half,
        neck.1 + a * half,
        neck.0 + b * half,
        neck.1 - a * half,
    );
    sheet.raw(&markup);
}

/// A field within a frame, flows `times` their length.
pub fn draw_field(sheet: &mut Sheet, frame: &Frame, arrows: &[Arrow], times: f64, colour: impl Fn(&Arrow) -> Rgb) {
    let scale = times * frame.unit();
    sheet.cut_to(frame.corner, frame.size, |sheet| {
        for arrow in arrows {
            draw_arrow(sheet, frame.at(arrow.at.x, arrow.at.y), (arrow.flow.x * scale, arrow.flow.y * scale), colour(arrow));
        }
    });
}

/// Full colour of a flow's direction.
pub fn colour_of_direction(arrow: &Arrow) -> Rgb {
    let length = arrow.flow.norm();
    if length > 0.0 { direction(arrow.flow.x / length, arrow.flow.y / length) } else { [90, 100, 115] }
}

/// An arrow of a round number of pixels with its name, ending at `right`, on the base line `y`.
pub fn draw_length_key(sheet: &mut Sheet, (right, y): (f64, f64), frame: &Frame, times: f64) {
    let scale = times * frame.unit();
    let wanted = 36.0 / scale;
    let power = 10f64.powf(wanted.log10().floor());
    let rounds = [5.0, 2.0, 1.0].into_iter().map(|r| r * power);
    let pixels = rounds.clone().find(|r| *r <= wanted).unwrap_or(power);
    let text = format!("= {pixels} px (drawn {} x)", two_digits(times));
    let width = 6.2 * text.len() as f64;
    draw_arrow(sheet, (right - width - 8.0 - pixels * scale, y - 4.0), (pixels * scale, 0.0), [51, 60, 74]);
    sheet.text((right, y), "small", Anchor::End, &text);
}

/// Twelve arrows around a centre in the colours of their directions.
pub fn draw_direction_key(sheet: &mut Sheet, (x, y): (f64, f64), radius: f64) {
    for k in 0..12 {
        let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 12.0).sin_cos();
        let inner = 0.3 * radius;
        draw_arrow(
            sheet,
            (x + inner * cos, y + inner * sin),
            ((radius - inner) * cos, (radius - inner) * sin),
            direction(cos, sin),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrow(u: f64, v: f64) -> Arrow {
        Arrow { at: Vector2::new(1.0, 2.0), flow: Vector2::new(u, v) }
    }

    #[test]
    fn nine_of_ten_arrows_fit() {
        let arrows: Vec<Arrow> = (1..=100).map(|i| arrow(0.0, f64::from(i))).collect();
        let times = magnification(arrows.iter(), 30.0);
        assert!((0.32..=0.34).contains(&times), "{times}");
        assert_eq!(magnification([arrow(0.0, 0.0)].iter(), 30.0), 1.0);
        assert_eq!(magnification([].iter(), 30.0), 1.0);
    }

    #[test]
    fn factors_are_written_with_two_digits() {
        assert_eq!([3.9000000000000004, 0.98, 12.0, 1.0].map(two_digits), ["3.9", "0.98", "12", "1.0"]);
    }

    #[test]
    fn an_arrow_ends_at_its_tip_and_a_short_one_is_a_dot() {
        let mut sheet = Sheet::new("x", 10.0, 10.0);
        draw_arrow(&mut sheet, (1.0, 2.0), (30.0, 40.0), [0, 0, 0]);
        assert!(sheet.to_svg().contains("M31.00 42.00L"), "{}", sheet.to_svg());
        draw_arrow(&mut sheet, (1.0, 2.0), (0.1, 0.0), [0, 0, 0]);
        assert!(sheet.to_svg().contains("<circle cx=\"1.0\""));
    }

    #[test]
    fn colour_tells_direction_only() {
        assert_eq!(colour_of_direction(&arrow(3.0, 0.0)), colour_of_direction(&arrow(0.1, 0.0)));
        assert_ne!(colour_of_direction(&arrow(3.0, 0.0)), colour_of_direction(&arrow(0.0, 3.0)));
    }
}
