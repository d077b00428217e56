//! Colours: scales for numbers, a wheel for directions.
//!
//! The scales of the reports are straight lines in sRGB between a few hand-set colours: `ember` runs from black over violet and
//! red to a pale yellow with lightness rising all the way (depth), `spectrum` from dark blue over green to dark red (errors).
//! `magma` and `turbo` are the published tables of 256 colours (`assets/colours/`), for pictures that are compared with those of
//! others.

use std::sync::LazyLock;

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// Colour of pixels without a value.
pub const UNKNOWN: Rgb = [150, 150, 158];

/// A colour scale over [0, 1].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Dark to bright with steadily rising lightness.
    Ember,
    /// Blue, green, yellow, red; the ends are dark.
    Spectrum,
    /// The published scale: black, violet, orange, pale yellow, with steadily rising lightness.
    Magma,
    /// The published scale: a rainbow of even steps, dark at both ends.
    Turbo,
}

/// The published table of [`Scale::Magma`].
static MAGMA: LazyLock<Vec<Rgb>> = LazyLock::new(|| table(include_str!("../../assets/colours/magma.txt")));
/// The published table of [`Scale::Turbo`].
static TURBO: LazyLock<Vec<Rgb>> = LazyLock::new(|| table(include_str!("../../assets/colours/turbo.txt")));

/// One colour a line, `rrggbb`; lines that begin with `#` tell where they come from.
fn table(text: &str) -> Vec<Rgb> {
    let colour = |line: &str| {
        let [_, r, g, b] = u32::from_str_radix(line, 16).expect("a colour of the embedded table").to_be_bytes();
        [r, g, b]
    };
    text.lines().filter(|line| !line.starts_with('#')).map(colour).collect()
}

const EMBER: [Rgb; 9] = [
    [4, 3, 18],
    [34, 16, 76],
    [78, 18, 122],
    [124, 36, 130],
    [172, 50, 124],
    [218, 72, 104],
    [246, 120, 92],
    [253, 178, 122],
    [252, 246, 196],
];

const SPECTRUM: [Rgb; 9] = [
    [46, 24, 90],
    [64, 92, 214],
    [52, 156, 250],
    [28, 212, 196],
    [96, 246, 110],
    [186, 240, 56],
    [248, 190, 48],
    [236, 98, 22],
    [134, 12, 6],
];

impl Scale {
    /// The colour at `x`, which is clamped to [0, 1]; values that are not finite get [`UNKNOWN`].
    pub fn at(self, x: f64) -> Rgb {
        if !x.is_finite() {
            return UNKNOWN;
        }
        let stops: &[Rgb] = match self {
            Self::Ember => &EMBER,
            Self::Spectrum => &SPECTRUM,
            Self::Magma => &MAGMA,
            Self::Turbo => &TURBO,
        };
        let position = x.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
        let low = (position as usize).min(stops.len() - 2);
        mix(stops[low], stops[low + 1], position - low as f64)
    }
}

fn mix(a: Rgb, b: Rgb, share: f64) -> Rgb {
    std::array::from_fn(|i| {
        let (a, b) = (f64::from(a[i]), f64::from(b[i]));
        (a + (b - a) * share).round() as u8
    })
}

/// Six hues around the wheel, starting at motion to the right and turning towards motion down.
const WHEEL: [Rgb; 6] = [[230, 40, 50], [240, 190, 20], [70, 180, 40], [10, 170, 190], [50, 80, 220], [190, 40, 190]];

/// Colour of a displacement (`u` right, `v` down): hue from the direction, white for none, full colour at `length` 1 and
/// beyond. Values that are not finite get [`UNKNOWN`].
pub fn direction(u: f64, v: f64) -> Rgb {
    let length = u.hypot(v);
    if !length.is_finite() {
        return UNKNOWN;
    }
    let turn = v.atan2(u).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
    let position = turn * WHEEL.len() as f64;
    let low = (position as usize).min(WHEEL.len() - 1);
    let hue = mix(WHEEL[low], WHEEL[(low + 1) % WHEEL.len()], position - low as f64);
    mix([255, 255, 255], hue, length.min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lightness(c: Rgb) -> f64 {
        0.2126 * f64::from(c[0]) + 0.7152 * f64::from(c[1]) + 0.0722 * f64::from(c[2])
    }

    #[test]
    fn ember_gets_lighter_all_the_way() {
        let values: Vec<f64> = (0..=200).map(|i| lightness(Scale::Ember.at(f64::from(i) / 200.0))).collect();
        assert!(values.windows(2).all(|w| w[1] >= w[0] - 0.5), "{values:?}");
        assert!(values[0] < 10.0 && values[200] > 230.0);
    }

    #[test]
    fn scales_meet_their_ends_and_clamp() {
        assert_eq!(Scale::Ember.at(-3.0), EMBER[0]);
        assert_eq!(Scale::Spectrum.at(9.0), SPECTRUM[8]);
        assert_eq!(Scale::Spectrum.at(0.5), SPECTRUM[4]);
        assert_eq!(Scale::Ember.at(f64::NAN), UNKNOWN);
    }

    #[test]
    fn spectrum_is_dark_at_both_ends() {
        let light = |x: f64| lightness(Scale::Spectrum.at(x));
        assert!(light(0.0) < 60.0 && light(1.0) < 60.0 && light(0.5) > 180.0);
    }

    #[test]
    fn published_scales_have_their_known_colours() {
        let hex = |scale: Scale, i: u32| {
            let [r, g, b] = scale.at(f64::from(i) / 255.0);
            format!("{r:02x}{g:02x}{b:02x}")
        };
        assert_eq!([0, 128, 255].map(|i| hex(Scale::Magma, i)), ["000004", "b73779", "fcfdbf"]);
        assert_eq!([0, 128, 255].map(|i| hex(Scale::Turbo, i)), ["30123b", "a4fc3c", "7a0403"]);
        assert_eq!((MAGMA.len(), TURBO.len()), (256, 256));
        let values: Vec<f64> = (0..256).map(|i| lightness(Scale::Magma.at(f64::from(i) / 255.0))).collect();
        assert!(values.windows(2).all(|w| w[1] >= w[0] - 0.5));
        assert!((0..255).all(|i| {
            let (a, b) = (TURBO[i], TURBO[i + 1]);
            (0..3).all(|k| a[k].abs_diff(b[k]) < 9)
        }));
    }

    #[test]
    fn direction_is_white_at_rest_and_continuous_around_the_wheel() {
        assert_eq!(direction(0.0, 0.0), [255, 255, 255]);
        assert_eq!(direction(1.0, 0.0), WHEEL[0]);
        assert_eq!(direction(-5.0, 0.0), WHEEL[3]);
        let step = |i: u32| direction((f64::from(i) / 100.0).cos(), (f64::from(i) / 100.0).sin());
        for i in 0..640 {
            let (a, b) = (step(i), step(i + 1));
            assert!((0..3).all(|k| a[k].abs_diff(b[k]) < 12), "{i}: {a:?} {b:?}");
        }
    }
}
