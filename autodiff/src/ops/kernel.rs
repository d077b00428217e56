//! Elementwise loops over slices, parallel in fixed chunks.

use crate::Scalar;
use crate::par;

#[track_caller]
fn assert_lengths(out: usize, others: &[usize]) {
    assert!(others.iter().all(|&len| len == out), "kernel: slices of {out} and {others:?} elements");
}

/// `out[i] = f(x[i])`.
///
/// # Panics
/// When the lengths differ (all functions of this module).
#[track_caller]
pub fn map<T: Scalar>(out: &mut [T], x: &[T], f: impl Fn(T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len()]);
    par::for_each_chunk(out, par::CHUNK, |i, out| {
        let x = &x[i * par::CHUNK..][..out.len()];
        for (o, &x) in out.iter_mut().zip(x) {
            *o = f(x);
        }
    });
}

/// `out[i] += f(x[i])`.
#[track_caller]
pub fn map_add<T: Scalar>(out: &mut [T], x: &[T], f: impl Fn(T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len()]);
    par::for_each_chunk(out, par::CHUNK, |i, out| {
        let x = &x[i * par::CHUNK..][..out.len()];
        for (o, &x) in out.iter_mut().zip(x) {
            *o += f(x);
        }
    });
}

/// `out[i] = f(x[i], y[i])`.
#[track_caller]
pub fn zip<T: Scalar>(out: &mut [T], x: &[T], y: &[T], f: impl Fn(T, T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len(), y.len()]);
    par::for_each_chunk(out, par::CHUNK, |i, out| {
        let at = i * par::CHUNK;
        let (x, y) = (&x[at..][..out.len()], &y[at..][..out.len()]);
        for ((o, &x), &y) in out.iter_mut().zip(x).zip(y) {
            *o = f(x, y);
        }
    });
}

/// `out[i] = f(x[i], y[i], z[i])`.
#[track_caller]
pub fn zip3<T: Scalar>(out: &mut [T], x: &[T], y: &[T], z: &[T], f: impl Fn(T, T, T) -> T + Sync + Send) {
    assert_lengths(out.len(), &[x.len(), y.len(), z.len()]);
    par::for_each_chunk(out, par::CHUNK, |i, out| {
        let at = i * par::CHUNK;
        let (x, y, z) = (&x[at..][..out.len()], &y[at..][..out.len()], &z[at..][..out.len()]);
        for (((o, &x), &y), &z) in out.iter_mut().zip(x).zip(y).zip(z) {
            *o = f(x, y, z);
        }
    });
}
