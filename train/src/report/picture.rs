//! Maps and flows as colour pictures, ready to be put into a page.

use std::io::Cursor;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::base64;
use super::colour::{Rgb, Scale, UNKNOWN, direction};
use crate::data::{FlowMap, Image, Map};

/// An 8-bit colour picture, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` colours, each with opacity.
    pub pixels: Vec<[u8; 4]>,
}

fn opaque([r, g, b]: Rgb) -> [u8; 4] {
    [r, g, b, 255]
}

impl Picture {
    /// A picture from one colour per pixel.
    fn of(height: usize, width: usize, colours: impl Iterator<Item = Rgb>) -> Self {
        Self { width, height, pixels: colours.map(opaque).collect() }
    }

    /// A camera image; one channel is shown grey, of three or more the first three are shown.
    pub fn from_image(image: &Image) -> Self {
        let plane = image.height * image.width;
        let byte = |i: usize| (image.data[i].clamp(0.0, 1.0) * 255.0).round() as u8;
        let channel = |c: usize| if image.channels >= 3 { c } else { 0 };
        let colour = |i: usize| std::array::from_fn(|c| byte(channel(c) * plane + i));
        Self::of(image.height, image.width, (0..plane).map(colour))
    }

    /// Depth in metres, logarithmic from `near` (bright) to `far` (dark); unknown depth is grey. `scale` is put on the
    /// depth first.
    pub fn from_depth(depth: &Map, scale: f64, near: f64, far: f64) -> Self {
        let colour = |d: &f32| depth_colour(f64::from(*d) * scale, near, far);
        Self::of(depth.height, depth.width, depth.data.iter().map(colour))
    }

    /// Depth in the colours of its inverse, from that of the farthest pixel to the 95 % point, as pictures of disparity are
    /// published: near is at the upper end of the scale. Unknown depth is grey.
    pub fn from_inverse_depth(depth: &Map, scale: Scale) -> Self {
        let mut known: Vec<f64> = depth.data.iter().map(|&z| 1.0 / f64::from(z)).filter(|d| d.is_finite() && *d > 0.0).collect();
        known.sort_unstable_by(f64::total_cmp);
        let (low, high) = match known.len().checked_sub(1) {
            Some(last) => (known[0], known[(0.95 * last as f64).round() as usize]),
            None => (0.0, 1.0),
        };
        let span = (high - low).max(1e-6 * high);
        let colour = |&z: &f32| {
            let disparity = 1.0 / f64::from(z);
            if disparity.is_finite() && disparity > 0.0 { scale.at((disparity - low) / span) } else { UNKNOWN }
        };
        Self::of(depth.height, depth.width, depth.data.iter().map(colour))
    }

    /// Relative depth error |scale p - g| / g, from 0 to `full`; pixels without truth are grey.
    ///
    /// **Panics** when the maps differ in size.
    #[track_caller]
    pub fn from_depth_error(prediction: &Map, truth: &Map, scale: f64, full: f64) -> Self {
        assert_eq!(
            (prediction.height, prediction.width),
            (truth.height, truth.width),
            "Picture::from_depth_error: predicted and true depth (height, width)"
        );
        let colour = |(p, g): (&f32, &f32)| {
            let (p, g) = (f64::from(*p) * scale, f64::from(*g));
            if g > 0.0 { Scale::Spectrum.at((p - g).abs() / g / full) } else { UNKNOWN }
        };
        let pairs = prediction.data.iter().zip(&truth.data);
        Self::of(truth.height, truth.width, pairs.map(colour))
    }

    /// Flow in pixels, full colour at `full` pixels.
    pub fn from_flow(flow: &FlowMap, full: f64) -> Self {
        let colour = |(u, v): (&f32, &f32)| direction(f64::from(*u) / full, f64::from(*v) / full);
        Self::of(flow.height, flow.width, flow.u.iter().zip(&flow.v).map(colour))
    }

    /// The wheel that explains flow colours: a disc of `size` pixels on nothing.
    pub fn flow_wheel(size: usize) -> Self {
        let radius = 0.5 * size as f64;
        let mut pixels = Vec::with_capacity(size * size);
        for row in 0..size {
            for column in 0..size {
                let u = (column as f64 + 0.5 - radius) / radius;
                let v = (row as f64 + 0.5 - radius) / radius;
                let [r, g, b] = direction(u, v);
                let edge = ((1.0 - u.hypot(v)) * radius).clamp(0.0, 1.0);
                pixels.push([r, g, b, (255.0 * edge) as u8]);
            }
        }
        Self { width: size, height: size, pixels }
    }

    /// PNG bytes.
    ///
    /// **Panics** for an empty picture.
    #[track_caller]
    pub fn to_png(&self) -> Vec<u8> {
        let (width, height) = (self.width, self.height);
        let mut bytes = Cursor::new(Vec::new());
        let seen = self.pixels.iter().any(|p| p[3] != 255);
        let result = if seen {
            let samples: Vec<u8> = self.pixels.iter().flatten().copied().collect();
            PngEncoder::new(&mut bytes).write_image(&samples, width as u32, height as u32, ExtendedColorType::Rgba8)
        } else {
            let samples: Vec<u8> = self.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
            PngEncoder::new(&mut bytes).write_image(&samples, width as u32, height as u32, ExtendedColorType::Rgb8)
        };
        result.unwrap_or_else(|error| panic!("Picture::to_png: {width}x{height}: {error}"));
        bytes.into_inner()
    }

    /// The picture as an address that a page can hold in itself.
    pub fn to_data_uri(&self) -> String {
        format!("data:image/png;base64,{}", base64::encode(&self.to_png()))
    }
}

/// Colour of a depth in metres on the logarithmic scale, near bright.
pub(crate) fn depth_colour(depth: f64, near: f64, far: f64) -> Rgb {
    if !(depth.is_finite() && depth > 0.0) {
        return UNKNOWN;
    }
    Scale::Ember.at((far / depth).ln() / (far / near).ln().max(1e-9))
}

/// Range for depth colours: the 2 % and 98 % points of the positive values, at least 5 % apart. `None` when there are none.
pub(crate) fn depth_range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let mut known: Vec<f64> = values.filter(|d| d.is_finite() && *d > 0.0).collect();
    known.sort_unstable_by(f64::total_cmp);
    let last = known.len().checked_sub(1)?;
    let at = |share: f64| known[(share * last as f64).round() as usize];
    Some((at(0.02), at(0.98).max(at(0.02) * 1.05)))
}

/// Length in pixels that gets full colour: the 95 % point over all flows, at least half a pixel.
pub(crate) fn flow_range(flows: &[&FlowMap]) -> f64 {
    let lengths = flows.iter().flat_map(|f| f.u.iter().zip(&f.v)).map(|(u, v)| f64::from(u.hypot(*v)));
    let mut lengths: Vec<f64> = lengths.filter(|x| x.is_finite()).collect();
    lengths.sort_unstable_by(f64::total_cmp);
    match lengths.len().checked_sub(1) {
        Some(last) => lengths[(0.95 * last as f64).round() as usize].max(0.5),
        None => 0.5,
    }
}

/// median(truth) / median(prediction) over pixels with truth; 1 when there are none.
pub(crate) fn median_ratio(prediction: &Map, truth: &Map) -> f64 {
    let pairs = prediction.data.iter().zip(&truth.data);
    let known = pairs.filter(|(p, g)| p.is_finite() && g.is_finite() && **p > 0.0 && **g > 0.0);
    let (mut p, mut g): (Vec<f64>, Vec<f64>) = known.map(|(p, g)| (f64::from(*p), f64::from(*g))).unzip();
    if p.is_empty() {
        return 1.0;
    }
    crate::eval::depth::median(&mut g, false) / crate::eval::depth::median(&mut p, false)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(data: &[f32]) -> Map {
        Map { height: 1, width: data.len(), data: data.to_vec() }
    }

    #[test]
    fn png_bytes_decode_to_the_same_colours() {
        let wheel = Picture::flow_wheel(17);
        let back = image::load_from_memory(&wheel.to_png()).unwrap().to_rgba8();
        assert_eq!((back.width(), back.height()), (17, 17));
        assert_eq!(back.get_pixel(8, 8).0, wheel.pixels[8 * 17 + 8]);
        assert_eq!(back.get_pixel(0, 0).0[3], 0);
        let depth = Picture::from_depth(&map(&[1.0, 10.0, 0.0]), 1.0, 1.0, 10.0);
        let back = image::load_from_memory(&depth.to_png()).unwrap().to_rgb8();
        assert_eq!(back.get_pixel(0, 0).0, Scale::Ember.at(1.0));
        assert_eq!(back.get_pixel(1, 0).0, Scale::Ember.at(0.0));
        assert_eq!(back.get_pixel(2, 0).0, UNKNOWN);
        assert!(depth.to_data_uri().starts_with("data:image/png;base64,iVBOR"));
    }

    #[test]
    fn grey_images_are_shown_grey() {
        let image = Image { channels: 1, height: 1, width: 2, data: vec![0.0, 0.5] };
        assert_eq!(Picture::from_image(&image).pixels, vec![[0, 0, 0, 255], [128, 128, 128, 255]]);
    }

    #[test]
    fn depth_error_uses_the_scale() {
        let picture = Picture::from_depth_error(&map(&[1.0, 1.0, 5.0]), &map(&[2.0, 4.0, 0.0]), 2.0, 0.5);
        let colours: Vec<Rgb> = picture.pixels.iter().map(|p| [p[0], p[1], p[2]]).collect();
        assert_eq!(colours, vec![Scale::Spectrum.at(0.0), Scale::Spectrum.at(1.0), UNKNOWN]);
    }

    #[test]
    fn inverse_depth_fills_the_scale_up_to_its_95_percent_point() {
        let mut depth: Vec<f32> = (0..99).map(|i| 100.0 / (100.0 + i as f32)).collect();
        depth.extend([1e-3, 0.0]);
        let picture = Picture::from_inverse_depth(&map(&depth), Scale::Turbo);
        let at = |i: usize| -> Rgb { std::array::from_fn(|k| picture.pixels[i][k]) };
        let ends = [Scale::Turbo.at(0.0), Scale::Turbo.at(1.0), Scale::Turbo.at(1.0), UNKNOWN];
        assert_eq!([at(0), at(94), at(99), at(100)], ends);
        let middle = Scale::Turbo.at(0.5);
        assert!((0..3).all(|k| at(47)[k].abs_diff(middle[k]) <= 1), "{:?} {middle:?}", at(47));
        let flat = Picture::from_inverse_depth(&map(&[2.0, 2.0, 0.0]), Scale::Magma);
        assert_eq!(flat.pixels.len(), 3, "equal depths have a colour, too");
    }

    #[test]
    fn ranges_ignore_outliers_and_unknown_values() {
        let values = (1..=1000).map(f64::from).chain([0.0, f64::NAN, 1e9]);
        let (near, far) = depth_range(values).unwrap();
        assert!((15.0..30.0).contains(&near) && (970.0..990.0).contains(&far));
        assert_eq!(depth_range([0.0].into_iter()), None);
        assert_eq!(flow_range(&[]), 0.5);
        assert_eq!(median_ratio(&map(&[1.0, 2.0, 3.0]), &map(&[2.0, 4.0, 0.0])), 2.0);
    }
}
