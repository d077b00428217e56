//! Bringing a predicted map to the size of the ground truth.

use super::EvalError;
use crate::data::Map;

/// Bilinear resize with half-pixel centres and clamped borders (PyTorch's `align_corners=False`, no antialiasing),
/// in double precision.
///
/// **Panics** for a size of zero.
#[track_caller]
pub fn resize_bilinear(map: &Map, height: usize, width: usize) -> Map {
    assert!(
        map.height > 0 && map.width > 0 && height > 0 && width > 0,
        "resize_bilinear: {}x{} to {height}x{width} has an empty side",
        map.height,
        map.width
    );
    let (rows, columns) = (taps(map.height, height), taps(map.width, width));
    let mut data = Vec::with_capacity(height * width);
    for &(top, bottom, fy) in &rows {
        for &(left, right, fx) in &columns {
            let line = |row: usize| {
                let a = f64::from(map.at(row, left));
                let b = f64::from(map.at(row, right));
                a * (1.0 - fx) + b * fx
            };
            data.push((line(top) * (1.0 - fy) + line(bottom) * fy) as f32);
        }
    }
    Map { height, width, data }
}

/// For each output index: the two source indices and the weight of the second.
fn taps(source: usize, target: usize) -> Vec<(usize, usize, f64)> {
    let last = source - 1;
    (0..target)
        .map(|i| {
            let x = (i as f64 + 0.5) * source as f64 / target as f64 - 0.5;
            let x = x.clamp(0.0, last as f64);
            let low = (x as usize).min(last);
            (low, (low + 1).min(last), x - low as f64)
        })
        .collect()
}

/// Depth of a given size from a predicted depth of another size: the disparity 1 / depth is resized, then inverted.
/// Unchanged when the size fits already.
///
/// **Errors** when a depth is not finite or not positive.
pub fn resize_depth(depth: &Map, height: usize, width: usize) -> Result<Map, EvalError> {
    if (depth.height, depth.width) == (height, width) {
        return Ok(depth.clone());
    }
    if let Some(i) = depth.data.iter().position(|d| !(d.is_finite() && *d > 0.0)) {
        return Err(EvalError::BadPixel {
            what: "predicted depth",
            row: i / depth.width,
            column: i % depth.width,
            value: depth.data[i],
            requirement: "must be finite and positive",
        });
    }
    Ok(invert(&resize_bilinear(&invert(depth), height, width)))
}

/// 1 / x for every pixel.
pub(crate) fn invert(map: &Map) -> Map {
    Map { height: map.height, width: map.width, data: map.data.iter().map(|x| 1.0 / x).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_size_is_the_identity_and_constants_stay() {
        let map = Map { height: 2, width: 3, data: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0] };
        assert_eq!(resize_bilinear(&map, 2, 3), map);
        let flat = Map { height: 2, width: 2, data: vec![7.0; 4] };
        assert!(resize_bilinear(&flat, 5, 9).data.iter().all(|x| *x == 7.0));
    }

    #[test]
    fn doubling_two_pixels_gives_quarter_steps() {
        let map = Map { height: 1, width: 2, data: vec![0.0, 4.0] };
        assert_eq!(resize_bilinear(&map, 1, 4).data, vec![0.0, 1.0, 3.0, 4.0]);
    }

    #[test]
    fn depth_is_resized_as_disparity() {
        let map = Map { height: 1, width: 2, data: vec![1.0, 0.5] };
        let got = resize_depth(&map, 1, 4).unwrap();
        assert_eq!(got.data, vec![1.0, 1.0 / 1.25, 1.0 / 1.75, 0.5]);
    }

    #[test]
    fn zero_depth_is_named() {
        let map = Map { height: 1, width: 2, data: vec![1.0, 0.0] };
        let message = resize_depth(&map, 2, 4).unwrap_err().to_string();
        assert!(message.contains("row 0, column 1 is 0"), "{message}");
    }
}
