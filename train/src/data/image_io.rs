//! Rasters into PNG files, and 16-bit depth back from them.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::PngEncoder;
use image::{DynamicImage, ExtendedColorType, ImageEncoder};

use super::atomic::write_atomic;
use super::decode::read_picture;
use super::{DataError, Image, Map};

/// Steps of a stored depth per metre in the KITTI form.
const DEPTH_STEPS: f32 = 256.0;

/// PNG bytes in memory from samples (16-bit samples in the byte order of the machine).
pub(crate) fn encode_png(samples: &[u8], width: usize, height: usize, kind: ExtendedColorType) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    PngEncoder::new(&mut bytes)
        .write_image(samples, width as u32, height as u32, kind)
        .unwrap_or_else(|error| panic!("encode_png: {width}x{height} {kind:?}: {error}"));
    bytes.into_inner()
}

/// An image as the bytes of an 8-bit colour PNG; values are clamped to [0, 1] and rounded, one channel is stored as grey.
///
/// **Panics** unless the image has one or three channels and at least one pixel.
#[track_caller]
pub fn encode_rgb_png(image: &Image) -> Vec<u8> {
    let (channels, plane) = (image.channels, image.plane_len());
    assert!(channels == 1 || channels == 3, "encode_rgb_png: {channels} channels, expected 1 or 3");
    let mut samples = vec![0; image.data.len()];
    for (channel, values) in image.data.chunks_exact(plane).enumerate() {
        for (pixel, &value) in values.iter().enumerate() {
            samples[pixel * channels + channel] = (value.clamp(0.0, 1.0) * 255.0).round() as u8;
        }
    }
    let kind = if channels == 3 { ExtendedColorType::Rgb8 } else { ExtendedColorType::L8 };
    encode_png(&samples, image.width, image.height, kind)
}

/// Writes an image as an 8-bit PNG, whole or not at all.
///
/// **Errors** [`DataError::Write`]. **Panics** as [`encode_rgb_png`].
pub fn write_rgb_png(path: &Path, image: &Image) -> Result<(), DataError> {
    write_atomic(path, &encode_rgb_png(image))
}

/// A depth map as the bytes of a 16-bit grey PNG in the KITTI form: round(metres * 256), 0 unknown.
///
/// What the form cannot hold is stored as unknown: not finite, not positive, above 65535 / 256 m. A smaller positive depth
/// than half a step is stored as one step.
pub fn encode_depth_png(depth: &Map) -> Vec<u8> {
    let samples: Vec<u8> = depth.data.iter().flat_map(|&metres| depth_code(metres).to_ne_bytes()).collect();
    encode_png(&samples, depth.width, depth.height, ExtendedColorType::L16)
}

fn depth_code(metres: f32) -> u16 {
    let steps = (metres * DEPTH_STEPS).round();
    if metres > 0.0 && steps <= f32::from(u16::MAX) { (steps as u16).max(1) } else { 0 }
}

/// Writes a depth map in the form of [`encode_depth_png`], whole or not at all.
///
/// **Errors** [`DataError::Write`].
pub fn write_depth_png(path: &Path, depth: &Map) -> Result<(), DataError> {
    write_atomic(path, &encode_depth_png(depth))
}

/// Reads a 16-bit depth PNG in the KITTI form: metres = value / 256, 0 unknown.
///
/// **Errors** as [`super::read_image`], and when the file is not a 16-bit grey PNG.
pub fn read_depth_png(path: &Path) -> Result<Map, DataError> {
    let (width, height, picture) = read_picture(path)?;
    let DynamicImage::ImageLuma16(samples) = picture else {
        let reason = format!("a depth map of kind {:?}, expected 16-bit grey", picture.color());
        return Err(DataError::malformed(path, reason, "store depth as 16-bit grey PNG, value = metres * 256"));
    };
    let data = samples.as_raw().iter().map(|&code| f32::from(code) / DEPTH_STEPS).collect();
    Ok(Map::from_vec(height, width, data))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::read_image;
    use proptest::prelude::*;

    #[test]
    fn eight_bit_images_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let image = Image::from_fn(3, 5, 7, |c, v, u| ((c * 91 + v * 17 + u * 31) % 256) as f32 / 255.0);
        write_rgb_png(&path, &image).unwrap();
        assert_eq!(read_image(&path).unwrap(), image);
    }

    #[test]
    fn values_outside_the_range_are_clamped_and_one_channel_is_grey() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        write_rgb_png(&path, &Image::from_vec(1, 1, 2, vec![-3.0, 7.0])).unwrap();
        assert_eq!(read_image(&path).unwrap().data, vec![0.0, 1.0, 0.0, 1.0, 0.0, 1.0]);
    }

    #[test]
    fn depth_has_steps_of_one_256th_metre() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.png");
        let values = vec![0.0, 1.0, 12.345, 0.001, 255.99, 256.0, f32::NAN, f32::INFINITY, -2.0];
        write_depth_png(&path, &Map::from_vec(3, 3, values)).unwrap();
        let back = read_depth_png(&path).unwrap().data;
        assert_eq!(back, vec![0.0, 1.0, 3160.0 / 256.0, 1.0 / 256.0, 65533.0 / 256.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn an_eight_bit_depth_map_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.png");
        write_rgb_png(&path, &Image::zeros(1, 2, 2)).unwrap();
        let message = read_depth_png(&path).unwrap_err().to_string();
        assert!(message.contains("d.png: a depth map of kind L8, expected 16-bit grey"), "{message}");
    }

    proptest! {
        #[test]
        fn depth_round_trip_is_within_half_a_step(metres in 0.002f32..255.9) {
            let back = f32::from(depth_code(metres)) / 256.0;
            prop_assert!((back - metres).abs() <= 0.5001 / 256.0);
        }
    }
}
