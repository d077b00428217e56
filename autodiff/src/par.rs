//! Parallel loops whose results do not depend on the number of threads.
//!
//! Work is cut into pieces of a size that the caller fixes; sums are taken piece by piece in `f64` and added in order.
//! This is the only place that names the thread library.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;

/// Elements of one piece of an elementwise loop or a sum.
pub const CHUNK: usize = 16_384;

/// Runs `f(index, chunk)` on consecutive chunks of `out`; the last one may be shorter.
pub fn for_each_chunk<T: Send>(out: &mut [T], chunk_len: usize, f: impl Fn(usize, &mut [T]) + Sync + Send) {
    chunks(out, chunk_len, &f);
}

/// As [`for_each_chunk`]. Knows the function by a pointer, as do the two below: the thread library is compiled once for a type, not
/// for each of some hundred loops, which took most of the compiler's time.
fn chunks<T: Send>(out: &mut [T], chunk_len: usize, f: &(dyn Fn(usize, &mut [T]) + Sync)) {
    if out.len() <= chunk_len {
        if !out.is_empty() {
            f(0, out);
        }
        return;
    }
    out.par_chunks_mut(chunk_len).enumerate().for_each(|(i, chunk)| f(i, chunk));
}

/// `[f(0), f(1), .., f(n - 1)]`, computed in parallel, returned in order.
pub fn map_indices<R: Send>(n: usize, f: impl Fn(usize) -> R + Sync + Send) -> Vec<R> {
    indices(n, &f)
}

fn indices<R: Send>(n: usize, f: &(dyn Fn(usize) -> R + Sync)) -> Vec<R> {
    if n <= 1 {
        return (0..n).map(f).collect();
    }
    (0..n).into_par_iter().map(f).collect()
}

/// Runs `f(i, item)` on every item in parallel.
pub fn for_each_item<T: Send>(items: Vec<T>, f: impl Fn(usize, T) + Sync + Send) {
    each_item(items, &f);
}

fn each_item<T: Send>(items: Vec<T>, f: &(dyn Fn(usize, T) + Sync)) {
    if items.len() <= 1 {
        items.into_iter().enumerate().for_each(|(i, item)| f(i, item));
        return;
    }
    items.into_par_iter().enumerate().for_each(|(i, item)| f(i, item));
}

/// Sum over `0..len` of pieces of [`CHUNK`] indices, added in order.
pub fn sum(len: usize, piece: impl Fn(Range<usize>) -> f64 + Sync + Send) -> f64 {
    let pieces = len.div_ceil(CHUNK);
    map_indices(pieces, |i| piece(i * CHUNK..((i + 1) * CHUNK).min(len))).into_iter().sum()
}

/// Runs `f` with a pool of exactly `threads` threads.
///
/// # Panics
/// When the threads cannot be started.
pub fn with_threads<R: Send>(threads: usize, f: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started").install(f)
}

/// Runs two computations, at the same time where a thread is free.
pub fn join<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    rayon::join(a, b)
}

/// Runs `f` on one of the pool's own threads, so that loops inside begin at once instead of waking a thread first.
///
/// Worth it around a long computation of many short loops, such as a training run.
pub fn inside<R: Send>(f: impl FnOnce() -> R + Send) -> R {
    rayon::scope(|_| f())
}

/// Runs `f` as [`inside`] does and keeps the pool's other threads looking for work until it returns, where they would fall asleep
/// between loops. Waking them takes as long as a small loop: a training step of short loops is a quarter faster on two threads.
///
/// Costs the time of all threads, as long as `f` runs, and begins when every thread has ended what it does. Within another call of
/// this function it only runs `f`: to let a long job run beside, call it around both.
pub fn awake<R: Send>(f: impl FnOnce() -> R + Send) -> R {
    inside(|| {
        let others = rayon::current_num_threads() - 1;
        if others == 0 || AWAKE.swap(true, Ordering::Acquire) {
            return f();
        }
        let leader = rayon::current_thread_index();
        let watch = Arc::new(Watch { started: AtomicUsize::new(0), done: AtomicBool::new(false) });
        let shared = watch.clone();
        rayon::spawn_broadcast(move |context| {
            if Some(context.index()) != leader {
                shared.started.fetch_add(1, Ordering::AcqRel);
                while !shared.done.load(Ordering::Acquire) {
                    if rayon::yield_now() != Some(rayon::Yield::Executed) {
                        // More threads than processors must not keep each other from work.
                        std::thread::yield_now();
                    }
                }
            }
        });
        // A thread that took part of `f` first and began to watch while it waits there would never come back to that part.
        while watch.started.load(Ordering::Acquire) < others {
            rayon::yield_now();
        }
        let _end = End(watch);
        f()
    })
}

/// Whether threads are kept awake at present.
static AWAKE: AtomicBool = AtomicBool::new(false);

/// What the leading thread of [`awake`] and the others tell each other.
struct Watch {
    started: AtomicUsize,
    done: AtomicBool,
}

/// Lets the other threads go, also where `f` panics.
struct End(Arc<Watch>);

impl Drop for End {
    fn drop(&mut self) {
        self.0.done.store(true, Ordering::Release);
        AWAKE.store(false, Ordering::Release);
    }
}

/// Lets all loops of this process use `threads` threads; to be called once, before the first loop.
///
/// # Errors
/// When the threads are already there, or cannot be started.
pub fn set_threads(threads: usize) -> Result<(), String> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().map_err(|error| error.to_string())
}

/// Threads that loops of this module use at present.
pub fn threads() -> usize {
    rayon::current_num_threads()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_has_the_same_bits_on_any_number_of_threads() {
        let piece = |r: Range<usize>| r.map(|i| 1.0 / (1.0 + i as f64)).sum::<f64>();
        let one = with_threads(1, || sum(100_001, piece));
        for threads in 2..5 {
            assert_eq!(with_threads(threads, || sum(100_001, piece)).to_bits(), one.to_bits());
        }
    }

    #[test]
    fn threads_stay_awake_once_and_are_let_go() {
        let loops = || (0..200).map(|k| map_indices(50, |i| i + k).into_iter().sum::<usize>()).sum::<usize>();
        let expected = with_threads(1, || awake(loops));
        for threads in [2, 3, 8] {
            assert_eq!(with_threads(threads, || awake(loops)), expected);
            assert_eq!(with_threads(threads, || join(|| awake(loops), || awake(|| awake(loops)))), (expected, expected));
        }
        let broken = std::panic::catch_unwind(|| with_threads(2, || awake(|| panic!("a loop fails"))));
        assert!(broken.is_err());
        assert_eq!(with_threads(2, || awake(loops)), expected);
    }

    #[test]
    fn chunks_cover_everything_once() {
        let mut out = vec![0; 100];
        for_each_chunk(&mut out, 7, |i, chunk| chunk.iter_mut().enumerate().for_each(|(j, x)| *x += 7 * i + j));
        assert_eq!(out, (0..100).collect::<Vec<_>>());
    }
}
