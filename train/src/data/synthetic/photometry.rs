//! What a camera does to the light: exposure and noise, the same for the same world and frame.

use super::random::{Draw, Smooth};
use crate::data::Image;

/// Multiplies by a gain and applies an exponent, both random for each frame and smooth over frames; values stay in [0, 1].
///
/// `strength` is the standard deviation of the logarithm of the gain; that of the exponent is half of it.
pub fn expose(image: &mut Image, seed: u64, frame: usize, strength: f64) {
    if strength <= 0.0 {
        return;
    }
    let mut draw = Draw::new(seed, 95);
    let slow = Smooth::new(&mut draw, 4, 5.0, 30.0);
    let bend = Smooth::new(&mut draw, 4, 5.0, 30.0);
    let gain = (strength * slow.at(frame as f64)).exp() as f32;
    let exponent = (0.5 * strength * bend.at(frame as f64)).exp() as f32;
    for value in &mut image.data {
        *value = (gain * *value).clamp(0.0, 1.0).powf(exponent);
    }
}

/// Adds independent Gaussian noise of standard deviation `sigma` to every value and clamps to [0, 1].
pub fn add_noise(image: &mut Image, seed: u64, frame: usize, sigma: f64) {
    if sigma <= 0.0 {
        return;
    }
    let mut draw = Draw::new(seed, 1000 + frame as u64);
    for pair in image.data.chunks_mut(2) {
        let (a, b) = draw.normal_pair();
        for (value, n) in pair.iter_mut().zip([a, b]) {
            *value = (*value + (sigma * n) as f32).clamp(0.0, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey() -> Image {
        Image::from_fn(3, 20, 30, |_, _, _| 0.5)
    }

    #[test]
    fn noise_has_the_given_deviation_and_repeats() {
        let (mut a, mut b, mut c) = (grey(), grey(), grey());
        add_noise(&mut a, 7, 3, 0.05);
        add_noise(&mut b, 7, 3, 0.05);
        add_noise(&mut c, 7, 4, 0.05);
        assert_eq!(a, b);
        assert_ne!(a, c);
        let n = a.data.len() as f32;
        let deviation = (a.data.iter().map(|x| (x - 0.5).powi(2)).sum::<f32>() / n).sqrt();
        assert!((deviation - 0.05).abs() < 0.005, "{deviation}");
    }

    #[test]
    fn exposure_changes_with_the_frame_and_zero_does_nothing() {
        let (mut a, mut b, mut c) = (grey(), grey(), grey());
        expose(&mut a, 7, 3, 0.2);
        expose(&mut b, 7, 9, 0.2);
        assert_ne!(a, b);
        expose(&mut c, 7, 3, 0.0);
        assert_eq!(c, grey());
    }
}
