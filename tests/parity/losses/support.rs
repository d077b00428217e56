//! Opening of golden files, and what counts as close.

use dimode_geometry::Intrinsics;
use dimode_tests::Golden;

/// Opens `golden/losses/NAME.f64.safetensors`.
#[track_caller]
pub fn open(name: &str) -> Golden {
    Golden::open(&format!("losses/{name}.f64.safetensors"))
}

/// Cameras of `in.K` for 32x24 pixels.
pub fn cameras(golden: &Golden) -> Vec<Intrinsics> {
    golden.numbers("in.K").chunks_exact(9).map(|k| Intrinsics::new(k[0], k[4], k[2], k[5], 32, 24).unwrap()).collect()
}

/// Largest of `|a - b| / (atol + rtol |b|)`.
fn excess(a: &[f64], b: &[f64], atol: f64, rtol: f64) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| if a.is_finite() { (a - b).abs() / (atol + rtol * b.abs()) } else { f64::INFINITY })
        .fold(0.0, f64::max)
}

/// Asserts closeness of two lists.
#[track_caller]
pub fn close(what: &str, found: &[f64], expected: &[f64], atol: f64, rtol: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let worst = excess(found, expected, atol, rtol);
    assert!(worst <= 1.0, "{what}: {worst:.3e} times the tolerance");
}
