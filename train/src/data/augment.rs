//! Random changes of a snippet: mirror image and colour jitter, one draw for all three frames.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use dimode_geometry::Se3;

use super::{Frame, Image, Snippet, View};

/// Grey value of a colour: weights of red, green, blue.
const GREY: [f32; 3] = [0.2989, 0.587, 0.114];

/// What happens to one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Augmentation {
    /// Whether all frames are mirrored.
    pub flip: bool,
    /// The colour change of all frames, if any.
    pub jitter: Option<Jitter>,
}

impl Augmentation {
    /// Mirror and jitter, each with probability 1/2. The same amount of random numbers is used whatever comes out, so
    /// that later draws do not depend on earlier outcomes.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let flip = rng.random::<f64>() < 0.5;
        let jittered = rng.random::<f64>() < 0.5;
        let jitter = Jitter::draw(rng);
        Self { flip, jitter: jittered.then_some(jitter) }
    }

    /// The snippet that the loss sees: mirrored or as it is, never jittered.
    pub fn geometry(&self, snippet: &Snippet) -> Snippet {
        if self.flip { flip_snippet(snippet) } else { snippet.clone() }
    }

    /// Writes the image of a frame as [`Augmentation::geometry`] has it.
    ///
    /// **Panics** when `out` does not have its size.
    #[track_caller]
    pub fn write_geometry(&self, image: &Image, out: &mut [f32]) {
        let (size, room) = (image.data.len(), out.len());
        assert_eq!(size, room, "Augmentation: values of a {}x{} image and room for them", image.height, image.width);
        out.copy_from_slice(&image.data);
        if self.flip {
            out.chunks_exact_mut(image.width).for_each(<[f32]>::reverse);
        }
    }

    /// Writes the image that the networks see, made from the three planes of what [`Augmentation::write_geometry`] wrote.
    ///
    /// **Panics** when the sizes differ.
    #[track_caller]
    pub fn write_colours(&self, image: &[f32], out: &mut [f32]) {
        out.copy_from_slice(image);
        if let Some(jitter) = self.jitter {
            jitter.change(out);
        }
    }
}

/// The mirror image of a snippet: pictures, principal points, depth and poses; previous stays previous, next stays next.
pub fn flip_snippet(snippet: &Snippet) -> Snippet {
    let [previous, next] = &snippet.sources;
    Snippet {
        name: snippet.name.clone(),
        target: Arc::new(flip_frame(&snippet.target)),
        sources: [Arc::new(flip_frame(previous)), Arc::new(flip_frame(next))],
    }
}

/// The mirror image of a frame. A pose becomes M T M with M = diag(-1, 1, 1): the world is mirrored with the camera, so
/// (tx, ty, tz) becomes (-tx, ty, tz) and the rotation vector (rx, ry, rz) becomes (rx, -ry, -rz).
pub fn flip_frame(frame: &Frame) -> Frame {
    let view = View::new(frame.image.clone(), frame.intrinsics, frame.depth.clone()).flip_horizontal();
    let mirror = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0));
    let world_from_camera = frame
        .world_from_camera
        .map(|pose| Se3 { rotation: mirror * pose.rotation * mirror, translation: mirror * pose.translation });
    let name = frame.name.clone();
    Frame { image: view.image, intrinsics: view.intrinsics, depth: view.depth, world_from_camera, name }
}

/// One of the four colour changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    Brightness,
    Contrast,
    Saturation,
    Hue,
}

/// A change of colours, drawn once and applied to every frame of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jitter {
    brightness: f32,
    contrast: f32,
    saturation: f32,
    hue: f32,
    order: [Change; 4],
}

impl Jitter {
    /// Brightness, contrast and saturation factors from U(0.8, 1.2), hue shift from U(-0.1, 0.1) turns, in random order.
    pub fn draw(rng: &mut ChaCha8Rng) -> Self {
        let mut uniform = |lo: f64, hi: f64| (lo + (hi - lo) * rng.random::<f64>()) as f32;
        let (brightness, contrast, saturation) = (uniform(0.8, 1.2), uniform(0.8, 1.2), uniform(0.8, 1.2));
        let hue = uniform(-0.1, 0.1);
        let mut order = [Change::Brightness, Change::Contrast, Change::Saturation, Change::Hue];
        for last in (1..order.len()).rev() {
            // From a fraction, so that every exchange uses one random number on any platform.
            order.swap(last, (rng.random::<f64>() * (last + 1) as f64) as usize);
        }
        Self { brightness, contrast, saturation, hue, order }
    }

    /// The image with changed colours, every value clamped to [0, 1] after each step. Brightness scales; contrast scales the
    /// difference to the mean grey value of this image; saturation the difference to the grey value of the pixel; hue turns
    /// the colour circle.
    ///
    /// **Panics** unless the image has three channels.
    #[track_caller]
    pub fn apply(&self, image: &Image) -> Image {
        assert_eq!(image.channels, 3, "Jitter::apply: channels of a {}x{} image", image.height, image.width);
        let mut out = image.clone();
        self.change(&mut out.data);
        out
    }

    /// The same in place, on three planes.
    fn change(&self, planes: &mut [f32]) {
        let plane = planes.len() / 3;
        let (red, rest) = planes.split_at_mut(plane);
        let (green, blue) = rest.split_at_mut(plane);
        for change in self.order {
            let planes = [&mut *red, &mut *green, &mut *blue];
            match change {
                Change::Brightness => scale(planes, self.brightness),
                Change::Contrast => contrast(planes, self.contrast),
                Change::Saturation => saturate(planes, self.saturation),
                Change::Hue => turn_hue(planes, self.hue),
            }
        }
    }
}

fn scale(planes: [&mut [f32]; 3], factor: f32) {
    for plane in planes {
        plane.iter_mut().for_each(|x| *x = (*x * factor).clamp(0.0, 1.0));
    }
}

fn contrast(planes: [&mut [f32]; 3], factor: f32) {
    let sums = [0, 1, 2].map(|c: usize| planes[c].iter().map(|&x| f64::from(x)).sum::<f64>() * f64::from(GREY[c]));
    let mean = (sums.iter().sum::<f64>() / planes[0].len() as f64) as f32;
    for plane in planes {
        plane.iter_mut().for_each(|x| *x = (mean + factor * (*x - mean)).clamp(0.0, 1.0));
    }
}

fn saturate(planes: [&mut [f32]; 3], factor: f32) {
    let [red, green, blue] = planes;
    for ((r, g), b) in red.iter_mut().zip(green).zip(blue) {
        let grey = GREY[0] * *r + GREY[1] * *g + GREY[2] * *b;
        for x in [r, g, b] {
            *x = (grey + factor * (*x - grey)).clamp(0.0, 1.0);
        }
    }
}

fn turn_hue(planes: [&mut [f32]; 3], turns: f32) {
    let [red, green, blue] = planes;
    for ((r, g), b) in red.iter_mut().zip(green).zip(blue) {
        [*r, *g, *b] = turn_colour([*r, *g, *b], turns);
    }
}

/// A colour with its hue turned; the largest and the smallest component stay.
fn turn_colour([r, g, b]: [f32; 3], turns: f32) -> [f32; 3] {
    let (high, low) = (r.max(g).max(b), r.min(g).min(b));
    let span = high - low;
    if span <= 0.0 {
        return [r, g, b];
    }
    // Sixths of the circle from red.
    let sector = if high == r {
        (g - b) / span
    } else if high == g {
        2.0 + (b - r) / span
    } else {
        4.0 + (r - g) / span
    };
    let turned = (sector + 6.0 * turns).rem_euclid(6.0);
    // A component is full within one sixth of its own place on the circle and gone from two sixths on.
    let component = |place: f32| {
        let away = (turned - place).abs();
        low + span * (2.0 - away.min(6.0 - away)).clamp(0.0, 1.0)
    };
    [component(0.0), component(2.0), component(4.0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Map;
    use dimode_geometry::Intrinsics;
    use proptest::prelude::*;
    use rand::SeedableRng;

    fn picture(shift: usize) -> Image {
        Image::from_fn(3, 6, 10, |c, v, u| ((c * 37 + v * 11 + u * 5 + shift) % 97) as f32 / 96.0)
    }

    fn frame(index: usize) -> Arc<Frame> {
        let omega = Vector3::new(0.1, 0.2 * index as f64, -0.3);
        Arc::new(Frame {
            image: picture(index),
            intrinsics: Intrinsics::new(8.0, 9.0, 3.7, 2.9, 10, 6).unwrap(),
            depth: Some(Map::from_vec(6, 10, (0..60).map(|i| 1.0 + i as f32).collect())),
            world_from_camera: Some(Se3::from_rotation_vector(&omega, Vector3::new(1.0, 2.0, index as f64))),
            name: index.to_string(),
        })
    }

    fn jitter(brightness: f32, contrast: f32, saturation: f32, hue: f32) -> Jitter {
        let order = [Change::Contrast, Change::Hue, Change::Brightness, Change::Saturation];
        Jitter { brightness, contrast, saturation, hue, order }
    }

    fn close(a: &[f32], b: &[f32]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-5)
    }

    #[test]
    fn neutral_jitter_changes_nothing() {
        assert!(close(&jitter(1.0, 1.0, 1.0, 0.0).apply(&picture(3)).data, &picture(3).data));
    }

    #[test]
    fn each_change_has_its_known_value() {
        let one = |r: f32, g: f32, b: f32| Image::from_vec(3, 1, 1, vec![r, g, b]);
        let bright = jitter(1.2, 1.0, 1.0, 0.0).apply(&one(0.5, 0.9, 0.0));
        assert!(close(&bright.data, &[0.6, 1.0, 0.0]), "{bright:?}");
        let grey = jitter(1.0, 1.0, 0.0, 0.0).apply(&one(1.0, 0.0, 0.5));
        assert!(close(&grey.data, &[0.3559; 3]), "{grey:?}");
        let two = Image::from_vec(3, 1, 2, vec![0.2, 0.6, 0.2, 0.6, 0.2, 0.6]);
        let flat = jitter(1.0, 0.5, 1.0, 0.0).apply(&two);
        let mean = 0.4 * 0.9999;
        assert!(close(&flat.data[..2], &[mean + 0.5 * (0.2 - mean), mean + 0.5 * (0.6 - mean)]), "{flat:?}");
    }

    #[test]
    fn hue_turns_through_the_primaries() {
        assert!(close(&turn_colour([1.0, 0.0, 0.0], 1.0 / 3.0), &[0.0, 1.0, 0.0]));
        assert!(close(&turn_colour([1.0, 0.0, 0.0], -1.0 / 3.0), &[0.0, 0.0, 1.0]));
        assert!(close(&turn_colour([1.0, 0.0, 0.0], 1.0 / 6.0), &[1.0, 1.0, 0.0]));
        assert!(close(&turn_colour([0.2, 0.8, 0.5], 0.5), &[0.8, 0.2, 0.5]));
    }

    #[test]
    fn draws_are_deterministic_in_range_and_shared() {
        let mut orders = [0; 4];
        let (mut a, mut b) = (ChaCha8Rng::seed_from_u64(7), ChaCha8Rng::seed_from_u64(7));
        for _ in 0..400 {
            let jitter = Jitter::draw(&mut a);
            assert_eq!(jitter, Jitter::draw(&mut b));
            for factor in [jitter.brightness, jitter.contrast, jitter.saturation] {
                assert!((0.8..=1.2).contains(&factor));
            }
            assert!((-0.1..=0.1).contains(&jitter.hue));
            orders[jitter.order[0] as usize] += 1;
        }
        assert!(orders.iter().all(|count| (60..140).contains(count)), "{orders:?}");
        assert_eq!(a.random::<u64>(), b.random::<u64>());
    }

    #[test]
    fn flips_and_jitters_happen_half_of_the_time() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let draws: Vec<Augmentation> = (0..400).map(|_| Augmentation::draw(&mut rng)).collect();
        let flips = draws.iter().filter(|d| d.flip).count();
        let jitters = draws.iter().filter(|d| d.jitter.is_some()).count();
        assert!((160..240).contains(&flips) && (160..240).contains(&jitters), "{flips} {jitters}");
    }

    #[test]
    fn a_flipped_snippet_keeps_its_order_and_its_geometry() {
        let old = Snippet { name: "s".into(), target: frame(1), sources: [frame(0), frame(2)] };
        let new = flip_snippet(&old);
        assert_eq!((new.sources[0].name.as_str(), new.sources[1].name.as_str()), ("0", "2"));
        assert_eq!(new.target.image.at(2, 3, 1), old.target.image.at(2, 3, 8));
        assert_eq!(new.target.intrinsics.u0, 9.0 - 3.7);
        // A point seen at (u, v) in the source of the old snippet is seen at (W - 1 - u, v) in the new one.
        let seen = |s: &Snippet, x: f64| {
            let to_world = s.target.world_from_camera.unwrap();
            let source = &s.sources[1];
            let point = source.world_from_camera.unwrap().inverse().compose(&to_world).transform(&Vector3::new(x, 0.4, 5.0));
            source.intrinsics.project(&point).unwrap()
        };
        let (a, b) = (seen(&old, 0.7), seen(&new, -0.7));
        assert!((b.x - (9.0 - a.x)).abs() < 1e-9 && (b.y - a.y).abs() < 1e-9, "{a} {b}");
        assert!(new.target.world_from_camera.unwrap().is_orthonormal(1e-12));
    }

    #[test]
    fn augmentation_separates_geometry_from_colours() {
        let snippet = Snippet { name: "s".into(), target: frame(1), sources: [frame(0), frame(2)] };
        let change = Augmentation { flip: false, jitter: Some(jitter(0.8, 1.0, 1.0, 0.05)) };
        let image = &snippet.target.image;
        let mut out = [image.data.clone(), image.data.clone()];
        for (flip, jitter) in [(false, None), (true, None), (false, change.jitter), (true, change.jitter)] {
            let change = Augmentation { flip, jitter };
            let [plain, seen] = &mut out;
            change.write_geometry(image, plain);
            change.write_colours(plain, seen);
            let mirrored = change.geometry(&snippet).target;
            assert_eq!(plain, &mirrored.image.data);
            assert_eq!(seen, &jitter.map_or(mirrored.image.clone(), |jitter| jitter.apply(&mirrored.image)).data);
            assert_eq!(seen == plain, jitter.is_none());
        }
    }

    proptest! {
        #[test]
        fn colours_stay_in_range_and_hue_keeps_the_extremes(r in 0f32..=1.0, g in 0f32..=1.0, b in 0f32..=1.0, seed in any::<u64>()) {
            let image = Image::from_vec(3, 1, 1, vec![r, g, b]);
            let out = Jitter::draw(&mut ChaCha8Rng::seed_from_u64(seed)).apply(&image);
            prop_assert!(out.data.iter().all(|x| (0.0..=1.0).contains(x)));
            let [x, y, z] = turn_colour([r, g, b], 0.07);
            prop_assert!((x.max(y).max(z) - r.max(g).max(b)).abs() < 1e-5);
            prop_assert!((x.min(y).min(z) - r.min(g).min(b)).abs() < 1e-5);
        }
    }
}
