//! Image files into rasters: 8-bit and 16-bit PNG, JPEG; never a half-decoded picture.

use std::fs::{self, File};
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use image::{DynamicImage, ImageFormat, ImageReader};

use super::{DataError, Image};

/// Largest accepted side of an image in pixels.
pub const MAX_SIDE: usize = 16_384;

const DAMAGED: &str = "the file is damaged or incomplete, copy or export it again";
const PNG_END: [u8; 12] = [0, 0, 0, 0, b'I', b'E', b'N', b'D', 0xAE, 0x42, 0x60, 0x82];
const JPEG_END: [u8; 2] = [0xFF, 0xD9];

/// Reads a PNG (8 or 16 bits a channel) or JPEG file as a colour image in [0, 1]; grey is repeated to three channels, alpha
/// is dropped.
///
/// **Errors** name the file: missing, unreadable, empty, truncated or damaged content, neither PNG nor JPEG, an extension
/// that contradicts the content, a side of 0 or above [`MAX_SIDE`].
pub fn read_image(path: &Path) -> Result<Image, DataError> {
    let (width, height, picture) = read_picture(path)?;
    Ok(match picture {
        DynamicImage::ImageLuma8(p) => planar(width, height, p.as_raw(), 1, 255.0),
        DynamicImage::ImageLumaA8(p) => planar(width, height, p.as_raw(), 2, 255.0),
        DynamicImage::ImageRgb8(p) => planar(width, height, p.as_raw(), 3, 255.0),
        DynamicImage::ImageRgba8(p) => planar(width, height, p.as_raw(), 4, 255.0),
        DynamicImage::ImageLuma16(p) => planar(width, height, p.as_raw(), 1, 65535.0),
        DynamicImage::ImageLumaA16(p) => planar(width, height, p.as_raw(), 2, 65535.0),
        DynamicImage::ImageRgb16(p) => planar(width, height, p.as_raw(), 3, 65535.0),
        DynamicImage::ImageRgba16(p) => planar(width, height, p.as_raw(), 4, 65535.0),
        other => {
            let reason = format!("pixels of kind {:?}, expected 8 or 16 bits a channel", other.color());
            return Err(DataError::malformed(path, reason, "export it as an 8-bit PNG or a JPEG"));
        }
    })
}

/// Interleaved samples of `stride` channels to three planes; one or two channels are grey (and alpha).
fn planar<S: Copy + Into<f32>>(width: usize, height: usize, samples: &[S], stride: usize, white: f32) -> Image {
    let mut data = Vec::with_capacity(3 * width * height);
    for channel in 0..3 {
        let offset = if stride < 3 { 0 } else { channel };
        data.extend(samples.iter().skip(offset).step_by(stride).map(|&s| s.into() / white));
    }
    Image::from_vec(3, height, width, data)
}

/// The decoded picture with its width and height, after every check of [`read_image`].
pub(crate) fn read_picture(path: &Path) -> Result<(usize, usize, DynamicImage), DataError> {
    let bytes = fs::read(path).map_err(|error| DataError::read(path, "image", error))?;
    let format = format_of(path, &bytes)?;
    let (width, height) = dimensions(path, Cursor::new(&bytes), format)?;
    if format == ImageFormat::Jpeg && !jpeg_has_end(&bytes) {
        return Err(DataError::malformed(path, "truncated image (no JPEG end marker)", DAMAGED));
    }
    let picture = ImageReader::with_format(Cursor::new(&bytes), format)
        .decode()
        .map_err(|error| DataError::malformed(path, format!("truncated or damaged image ({error})"), DAMAGED))?;
    Ok((width, height, picture))
}

/// The (width, height) in pixels of a PNG or JPEG file, from its header, and whether the file has its proper end.
///
/// A file without it is decoded as a whole, so a truncated file is found here and not in the middle of a training run.
///
/// **Errors** as [`read_image`].
pub fn image_size(path: &Path) -> Result<(usize, usize), DataError> {
    let unreadable = |error: io::Error| DataError::read(path, "image", error);
    let mut file = File::open(path).map_err(unreadable)?;
    let mut head = Vec::new();
    file.by_ref().take(16).read_to_end(&mut head).map_err(unreadable)?;
    let format = format_of(path, &head)?;
    if !has_end(&mut file, format).map_err(unreadable)? {
        return read_picture(path).map(|(width, height, _)| (width, height));
    }
    file.seek(SeekFrom::Start(0)).map_err(unreadable)?;
    dimensions(path, io::BufReader::new(file), format)
}

fn has_end(file: &mut File, format: ImageFormat) -> io::Result<bool> {
    let end: &[u8] = if format == ImageFormat::Png { &PNG_END } else { &JPEG_END };
    if file.seek(SeekFrom::End(0))? < end.len() as u64 {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-(end.len() as i64)))?;
    let mut tail = vec![0; end.len()];
    file.read_exact(&mut tail)?;
    Ok(tail == end)
}

/// PNG or JPEG by the first bytes, in agreement with the extension.
fn format_of(path: &Path, head: &[u8]) -> Result<ImageFormat, DataError> {
    if head.is_empty() {
        return Err(DataError::malformed(path, "truncated image (the file is empty)", DAMAGED));
    }
    let format = match image::guess_format(head) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
        _ => {
            return Err(DataError::malformed(path, "neither PNG nor JPEG content", "convert it to PNG or JPEG"));
        }
    };
    match ImageFormat::from_path(path) {
        Ok(extension) if extension != format => {
            let reason = format!("the extension says {extension:?} but the content is {format:?}");
            Err(DataError::malformed(path, reason, "rename or convert the file"))
        }
        _ => Ok(format),
    }
}

fn dimensions(path: &Path, reader: impl io::BufRead + Seek, format: ImageFormat) -> Result<(usize, usize), DataError> {
    let (width, height) = ImageReader::with_format(reader, format)
        .into_dimensions()
        .map_err(|error| DataError::malformed(path, format!("truncated or damaged image ({error})"), DAMAGED))?;
    let (width, height) = (width as usize, height as usize);
    if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
        let reason = format!("implausible size {width}x{height}");
        return Err(DataError::malformed(path, reason, format!("sides of 1 to {MAX_SIDE} pixels are accepted")));
    }
    Ok((width, height))
}

/// Whether an end marker follows the first scan; decoders may fill up a truncated scan with grey without a word.
/// Inside a scan a byte FF is always followed by 00 or a restart marker, so FF D9 there is the end.
fn jpeg_has_end(bytes: &[u8]) -> bool {
    let mut at = 2;
    while at + 4 <= bytes.len() && bytes[at] == 0xFF {
        let marker = bytes[at + 1];
        if marker == 0xFF {
            at += 1; // a fill byte
        } else if marker == 0xDA {
            return bytes[at..].windows(2).any(|pair| pair == JPEG_END);
        } else {
            at += 2 + usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::encode_rgb_png;
    use image::codecs::jpeg::JpegEncoder;
    use image::{ExtendedColorType, ImageEncoder};
    use std::path::PathBuf;

    fn picture() -> Image {
        Image::from_fn(3, 16, 24, |c, v, u| ((c * 40 + v * 9 + u * 5) % 256) as f32 / 255.0)
    }

    fn jpeg() -> Vec<u8> {
        let samples: Vec<u8> = (0..24 * 16 * 3).map(|i| (i * 7 % 251) as u8).collect();
        let mut bytes = Vec::new();
        JpegEncoder::new(&mut bytes).write_image(&samples, 24, 16, ExtendedColorType::Rgb8).unwrap();
        bytes
    }

    fn stored(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }

    #[test]
    fn grey_alpha_and_sixteen_bits_become_three_planes() {
        let folder = tempfile::tempdir().unwrap();
        let cases: [(&str, DynamicImage, [f32; 3]); 4] = [
            ("g8.png", image::GrayImage::from_pixel(3, 2, image::Luma([51])).into(), [0.2; 3]),
            ("rgba.png", image::RgbaImage::from_pixel(3, 2, image::Rgba([255, 51, 0, 9])).into(), [1.0, 0.2, 0.0]),
            ("g16.png", image::ImageBuffer::from_pixel(3, 2, image::Luma([13107u16])).into(), [0.2; 3]),
            ("rgb16.png", image::ImageBuffer::from_pixel(3, 2, image::Rgb([65535u16, 0, 13107])).into(), [1.0, 0.0, 0.2]),
        ];
        for (name, picture, expected) in cases {
            let path = folder.path().join(name);
            picture.save(&path).unwrap();
            let image = read_image(&path).unwrap();
            assert_eq!((image.channels, image.height, image.width), (3, 2, 3), "{name}");
            for (channel, value) in expected.iter().enumerate() {
                assert!((image.at(channel, 1, 2) - value).abs() < 1e-6, "{name} channel {channel}");
            }
            assert_eq!(image_size(&path).unwrap(), (3, 2), "{name}");
        }
    }

    #[test]
    fn every_truncation_is_an_error_or_the_whole_picture() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [("a.png", encode_rgb_png(&picture())), ("a.jpg", jpeg())] {
            let whole = read_image(&stored(&folder, name, &bytes)).unwrap();
            for len in 0..bytes.len() {
                let path = stored(&folder, name, &bytes[..len]);
                let both = [read_image(&path).err(), image_size(&path).err()];
                match &both {
                    [Some(error), Some(_)] => assert!(error.to_string().contains(name), "{error}"),
                    [None, None] => {
                        assert_eq!(read_image(&path).unwrap(), whole, "{name} cut at {len}")
                    }
                    _ => panic!("{name} cut at {len}: header and picture disagree: {both:?}"),
                }
                assert!(len > bytes.len() - 20 || both[0].is_some(), "{name} cut at {len} was read");
            }
        }
    }

    #[test]
    fn damaged_bytes_never_panic() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in [("a.png", encode_rgb_png(&picture())), ("a.jpg", jpeg())] {
            for at in (0..bytes.len()).step_by(3) {
                let mut damaged = bytes.clone();
                damaged[at] ^= 0x55;
                let path = stored(&folder, name, &damaged);
                let _ = (read_image(&path), image_size(&path));
            }
        }
    }

    #[test]
    fn a_flipped_bit_in_png_pixels_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let mut bytes = encode_rgb_png(&picture());
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        let message = read_image(&stored(&folder, "a.png", &bytes)).unwrap_err().to_string();
        assert!(message.contains("a.png: truncated or damaged image"), "{message}");
    }

    #[test]
    fn rejections_name_file_and_reason() {
        let folder = tempfile::tempdir().unwrap();
        let message = |name: &str, bytes: &[u8]| read_image(&stored(&folder, name, bytes)).unwrap_err().to_string();
        assert!(message("e.png", b"").contains("e.png: truncated image (the file is empty)"));
        assert!(message("t.png", b"plain text").contains("t.png: neither PNG nor JPEG content"));
        assert!(message("l.png", &jpeg()).contains("the extension says Png but the content is Jpeg"));
        let missing = read_image(&folder.path().join("no.png")).unwrap_err().to_string();
        assert!(missing.contains("no.png: image not found"), "{missing}");
    }

    #[test]
    fn an_implausible_size_is_refused_before_decoding() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wide.png");
        image::GrayImage::new(MAX_SIDE as u32 + 1, 1).save(&path).unwrap();
        let message = image_size(&path).unwrap_err().to_string();
        assert!(message.contains("implausible size 16385x1"), "{message}");
    }
}
