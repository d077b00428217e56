//! Optical-flow files: `.flo` (32-bit floats) and the 16-bit colour PNG of KITTI.

use std::fs;
use std::path::Path;

use image::{DynamicImage, ExtendedColorType};

use super::atomic::write_atomic;
use super::decode::{MAX_SIDE, read_picture};
use super::image_io::encode_png;
use super::{DataError, FlowMap};

const FLO_MAGIC: [u8; 4] = *b"PIEH";
const FLO_HEADER: usize = 12;
/// Components above this mean "unknown" in a `.flo` file; this much is written for them.
const FLO_UNKNOWN: f32 = 1e9;
const FLO_UNKNOWN_WRITTEN: f32 = 1e10;

/// A flow and, for each pixel, whether it is known (row by row).
#[derive(Clone, Debug, PartialEq)]
pub struct KnownFlow {
    /// Displacements in pixels, 0 where unknown.
    pub flow: FlowMap,
    /// One flag per pixel.
    pub known: Vec<bool>,
}

/// Reads a `.flo` file.
///
/// **Errors** as [`parse_flo`], and when the file cannot be read.
pub fn read_flo(path: &Path) -> Result<KnownFlow, DataError> {
    parse_flo(path, &fs::read(path).map_err(|error| DataError::read(path, "flow file", error))?)
}

/// A flow from the bytes of a `.flo` file: `PIEH`, width and height as 32-bit integers, then (u, v) pairs of 32-bit floats,
/// rows from the top, all little-endian. Components that are not finite or above 1e9 mean unknown.
///
/// **Errors** wrong first bytes, a side outside 1 to [`MAX_SIDE`], a length other than 12 + 8 * width * height; sizes are
/// checked before anything is allocated.
pub fn parse_flo(path: &Path, bytes: &[u8]) -> Result<KnownFlow, DataError> {
    let advice = "check that the file is complete and of the .flo form";
    if bytes.len() < FLO_HEADER || bytes[..4] != FLO_MAGIC {
        let head = &bytes[..bytes.len().min(4)];
        return Err(DataError::malformed(path, format!("not a .flo file (first bytes {head:02x?})"), advice));
    }
    let side = |at: usize| i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let (width, height) = (side(4), side(8));
    let sides = 1..=MAX_SIDE as i32;
    if !sides.contains(&width) || !sides.contains(&height) {
        return Err(DataError::malformed(path, format!("implausible size {width}x{height}"), advice));
    }
    let (width, height) = (width as usize, height as usize);
    let expected = FLO_HEADER + 8 * width * height;
    if bytes.len() != expected {
        let reason = format!("{} bytes, expected {expected} for {width}x{height}", bytes.len());
        return Err(DataError::malformed(path, reason, advice));
    }
    let mut flow = FlowMap { height, width, u: Vec::new(), v: Vec::new() };
    let mut known = Vec::with_capacity(width * height);
    for pair in bytes[FLO_HEADER..].chunks_exact(8) {
        let u = f32::from_le_bytes([pair[0], pair[1], pair[2], pair[3]]);
        let v = f32::from_le_bytes([pair[4], pair[5], pair[6], pair[7]]);
        let is_known = u.abs() <= FLO_UNKNOWN && v.abs() <= FLO_UNKNOWN;
        flow.u.push(if is_known { u } else { 0.0 });
        flow.v.push(if is_known { v } else { 0.0 });
        known.push(is_known);
    }
    Ok(KnownFlow { flow, known })
}

/// A flow as the bytes of a `.flo` file; see [`parse_flo`].
///
/// **Panics** unless there is one flag per pixel and the sides lie in 1 to [`MAX_SIDE`].
#[track_caller]
pub fn encode_flo(flow: &FlowMap, known: &[bool]) -> Vec<u8> {
    check_shapes("encode_flo", flow, known);
    let mut bytes = Vec::with_capacity(FLO_HEADER + 8 * flow.len());
    bytes.extend(FLO_MAGIC);
    bytes.extend((flow.width as i32).to_le_bytes());
    bytes.extend((flow.height as i32).to_le_bytes());
    for ((&u, &v), &is_known) in flow.u.iter().zip(&flow.v).zip(known) {
        let pair = if is_known { [u, v] } else { [FLO_UNKNOWN_WRITTEN; 2] };
        bytes.extend(pair.iter().flat_map(|value| value.to_le_bytes()));
    }
    bytes
}

/// Writes a `.flo` file, whole or not at all.
///
/// **Errors** [`DataError::Write`]. **Panics** as [`encode_flo`].
pub fn write_flo(path: &Path, flow: &FlowMap, known: &[bool]) -> Result<(), DataError> {
    write_atomic(path, &encode_flo(flow, known))
}

/// A flow as the bytes of a KITTI flow PNG: 16-bit colour, red = round(64 u) + 32768, green the same for v, blue 1 where
/// known; steps of 1/64 pixel from -512 to 512. Displacements outside that range are stored as unknown.
///
/// **Panics** as [`encode_flo`].
#[track_caller]
pub fn encode_flow_png(flow: &FlowMap, known: &[bool]) -> Vec<u8> {
    check_shapes("encode_flow_png", flow, known);
    let mut samples = Vec::with_capacity(6 * flow.len());
    for ((&u, &v), &is_known) in flow.u.iter().zip(&flow.v).zip(known) {
        let codes = match (is_known, flow_code(u), flow_code(v)) {
            (true, Some(u), Some(v)) => [u, v, 1],
            _ => [0; 3],
        };
        samples.extend(codes.iter().flat_map(|code: &u16| code.to_ne_bytes()));
    }
    encode_png(&samples, flow.width, flow.height, ExtendedColorType::Rgb16)
}

fn flow_code(pixels: f32) -> Option<u16> {
    let code = (pixels * 64.0).round() + 32768.0;
    (0.0..=65535.0).contains(&code).then_some(code as u16)
}

/// Writes a KITTI flow PNG, whole or not at all; see [`encode_flow_png`].
///
/// **Errors** [`DataError::Write`]. **Panics** as [`encode_flo`].
pub fn write_flow_png(path: &Path, flow: &FlowMap, known: &[bool]) -> Result<(), DataError> {
    write_atomic(path, &encode_flow_png(flow, known))
}

/// Reads a KITTI flow PNG; see [`encode_flow_png`].
///
/// **Errors** as [`super::read_image`], and when the file is not a 16-bit colour PNG.
pub fn read_flow_png(path: &Path) -> Result<KnownFlow, DataError> {
    let (width, height, picture) = read_picture(path)?;
    let DynamicImage::ImageRgb16(samples) = picture else {
        let reason = format!("a flow of kind {:?}, expected 16-bit colour", picture.color());
        return Err(DataError::malformed(path, reason, "store flow as 16-bit colour PNG: 64 u + 32768, 64 v + 32768, 1"));
    };
    let mut flow = FlowMap::zeros(height, width);
    let mut known = vec![false; width * height];
    for (i, codes) in samples.as_raw().chunks_exact(3).enumerate() {
        if codes[2] > 0 {
            flow.u[i] = (f32::from(codes[0]) - 32768.0) / 64.0;
            flow.v[i] = (f32::from(codes[1]) - 32768.0) / 64.0;
            known[i] = true;
        }
    }
    Ok(KnownFlow { flow, known })
}

#[track_caller]
fn check_shapes(what: &str, flow: &FlowMap, known: &[bool]) {
    let (width, height) = (flow.width, flow.height);
    let sizes = [flow.u.len(), flow.v.len(), known.len()];
    assert!(sizes.iter().all(|&len| len == width * height), "{what}: {width}x{height} with u, v, known of {sizes:?}");
    assert!((1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height), "{what}: {width}x{height}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sample() -> KnownFlow {
        let flow = FlowMap {
            height: 2,
            width: 3,
            u: vec![0.0, 1.5, -2.25, 511.0, 0.0, -512.0],
            v: vec![0.25, -8.0, 3.0, 1.0, 0.0, 7.5],
        };
        KnownFlow { flow, known: vec![true, true, true, true, false, true] }
    }

    #[test]
    fn flo_bytes_are_as_published() {
        let flow = FlowMap { height: 1, width: 1, u: vec![1.0], v: vec![-2.0] };
        let bytes = encode_flo(&flow, &[true]);
        assert_eq!(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]), 202021.25);
        assert_eq!(bytes[4..], [1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0x80, 0x3F, 0, 0, 0, 0xC0]);
    }

    #[test]
    fn both_forms_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let sample = sample();
        let path = folder.path().join("a.flo");
        write_flo(&path, &sample.flow, &sample.known).unwrap();
        assert_eq!(read_flo(&path).unwrap(), sample);
        let path = folder.path().join("a.png");
        write_flow_png(&path, &sample.flow, &sample.known).unwrap();
        assert_eq!(read_flow_png(&path).unwrap(), sample);
    }

    #[test]
    fn what_the_png_cannot_hold_is_unknown_and_the_rest_is_rounded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let flow = FlowMap { height: 1, width: 4, u: vec![512.0, -513.0, f32::NAN, 0.01], v: vec![0.0, 0.0, 0.0, -0.01] };
        write_flow_png(&path, &flow, &[true; 4]).unwrap();
        let back = read_flow_png(&path).unwrap();
        assert_eq!(back.known, [false, false, false, true]);
        assert_eq!((back.flow.u[3], back.flow.v[3]), (1.0 / 64.0, -1.0 / 64.0));
    }

    #[test]
    fn faults_of_flo_files_are_named() {
        let message = |bytes: &[u8]| parse_flo(Path::new("a.flo"), bytes).unwrap_err().to_string();
        assert!(message(b"").starts_with("a.flo: not a .flo file"));
        assert!(message(&[0; 40]).starts_with("a.flo: not a .flo file (first bytes [00, 00, 00, 00])"));
        let good = encode_flo(&sample().flow, &sample().known);
        assert!(message(&good[..59]).starts_with("a.flo: 59 bytes, expected 60 for 3x2"));
        let mut huge = good.clone();
        huge[4..12].copy_from_slice(&[0xFF, 0xFF, 0xFF, 0x7F, 0xFF, 0xFF, 0xFF, 0x7F]);
        assert!(message(&huge).contains("implausible size 2147483647x2147483647"));
    }

    #[test]
    fn an_eight_bit_flow_png_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f.png");
        crate::data::write_rgb_png(&path, &crate::data::Image::zeros(3, 2, 2)).unwrap();
        let message = read_flow_png(&path).unwrap_err().to_string();
        assert!(message.contains("f.png: a flow of kind Rgb8, expected 16-bit colour"), "{message}");
    }

    proptest! {
        #[test]
        fn any_bytes_are_an_error_or_a_flow(
            head in prop::sample::select(vec![b"PIEH".to_vec(), vec![]]),
            width in 0i32..5, height in -1i32..5,
            rest in prop::collection::vec(any::<u8>(), 0..200),
        ) {
            let mut bytes = head;
            bytes.extend(width.to_le_bytes());
            bytes.extend(height.to_le_bytes());
            bytes.extend(&rest);
            if let Ok(parsed) = parse_flo(Path::new("x.flo"), &bytes) {
                prop_assert_eq!(parsed.known.len(), parsed.flow.len());
                prop_assert!(parsed.flow.u.iter().chain(&parsed.flow.v).all(|x| x.is_finite()));
            }
            let _ = parse_flo(Path::new("x.flo"), &rest);
        }
    }
}
