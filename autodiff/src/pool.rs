//! Buffers kept for the next step, so that a training step in steady state allocates next to nothing.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};

use crate::Scalar;

/// Buffers below this many elements are not worth keeping.
const SMALLEST_KEPT: usize = 256;
/// A buffer serves requests down to one part in this many of its length. Fewer would strand memory in buffers of rare lengths, more
/// would spend long buffers on short requests.
const LONGEST: usize = 2;

/// A store of buffers. Tensors of a [`Tape`](crate::Tape) return their buffer here when the last handle is gone.
///
/// A request is served by the smallest buffer that is long enough and not more than twice as long; when there is none, a new one is
/// made. After few steps of one kind every request finds its buffer.
#[derive(Debug, Default)]
pub struct Pool<T> {
    store: Mutex<Store<T>>,
}

#[derive(Debug, Default)]
struct Store<T> {
    /// Buffers at rest by capacity; a shelf stays when it is empty.
    shelves: BTreeMap<usize, Vec<Vec<T>>>,
    /// Elements of the buffers at rest.
    resting: usize,
    /// Elements of the buffers that were taken and not given back.
    lent: usize,
    /// Largest sum of both so far.
    peak: usize,
}

impl<T> Store<T> {
    /// The smallest buffer at rest that fits.
    fn fitting(&mut self, len: usize) -> Option<Vec<T>> {
        let buffer = self.shelves.range_mut(len..=LONGEST * len).find_map(|(_, shelf)| shelf.pop())?;
        self.resting -= buffer.capacity();
        Some(buffer)
    }

    fn lend(&mut self, elements: usize) {
        self.lent += elements;
        self.peak = self.peak.max(self.resting + self.lent);
    }
}

impl<T: Scalar> Pool<T> {
    /// An empty pool.
    pub fn new() -> Arc<Self> {
        Arc::new(Pool::default())
    }

    fn store(&self) -> MutexGuard<'_, Store<T>> {
        self.store.lock().expect("the pool's lock is never held across a panic")
    }

    /// A buffer of `len` elements with arbitrary (initialised) contents.
    pub fn take(&self, len: usize) -> Vec<T> {
        if len < SMALLEST_KEPT {
            return vec![T::ZERO; len];
        }
        let mut store = self.store();
        let found = store.fitting(len);
        store.lend(found.as_ref().map_or(len, Vec::capacity));
        drop(store);
        match found {
            Some(mut buffer) => {
                buffer.resize(len, T::ZERO);
                buffer
            }
            None => vec![T::ZERO; len],
        }
    }

    /// A buffer of `len` zeros.
    pub fn take_zeroed(&self, len: usize) -> Vec<T> {
        let mut buffer = self.take(len);
        buffer.fill(T::ZERO);
        buffer
    }

    /// Keeps a buffer for later.
    pub fn give(&self, buffer: Vec<T>) {
        let elements = buffer.capacity();
        if elements < SMALLEST_KEPT {
            return;
        }
        let mut store = self.store();
        // A buffer from elsewhere was never lent.
        store.lent = store.lent.saturating_sub(elements);
        store.resting += elements;
        store.peak = store.peak.max(store.resting + store.lent);
        store.shelves.entry(elements).or_default().push(buffer);
    }

    /// Elements of all buffers at rest.
    pub fn elements(&self) -> usize {
        self.store().resting
    }

    /// Bytes of all buffers, at rest and taken, when they were most.
    pub fn peak_bytes(&self) -> usize {
        self.store().peak * size_of::<T>()
    }

    /// Returns every buffer at rest to the system.
    pub fn clear(&self) {
        let mut store = self.store();
        store.shelves.clear();
        store.resting = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_returned_buffer_is_used_again() {
        let pool = Pool::<f32>::new();
        let mut buffer = pool.take(1000);
        buffer[3] = 7.0;
        let address = buffer.as_ptr();
        pool.give(buffer);
        assert_eq!(pool.elements(), 1000);
        let again = pool.take_zeroed(1000);
        assert_eq!(again.as_ptr(), address);
        assert_eq!(again[3], 0.0);
        assert_eq!(pool.elements(), 0);
    }

    #[test]
    fn a_request_gets_the_smallest_buffer_that_fits() {
        let pool = Pool::<f32>::new();
        let given = [1000, 1100, 2200].map(|len| pool.take(len));
        let addresses = given.each_ref().map(|buffer| buffer.as_ptr());
        given.into_iter().for_each(|buffer| pool.give(buffer));
        let taken = [1050, 500, 1000].map(|len| pool.take(len));
        assert_eq!(taken.each_ref().map(Vec::len), [1050, 500, 1000]);
        assert_eq!([taken[0].as_ptr(), taken[1].as_ptr()], [addresses[1], addresses[0]]);
        assert!(!addresses.contains(&taken[2].as_ptr()), "2200 elements are too many for 1000");
        assert_eq!(pool.elements(), 2200);
        // Back on its shelf by what it can hold, and of any such length again.
        taken.into_iter().for_each(|buffer| pool.give(buffer));
        let longest = pool.take(1100);
        assert_eq!((longest.as_ptr(), longest.len()), (addresses[1], 1100));
    }

    #[test]
    fn requests_of_one_kind_find_their_buffers_after_the_first_round() {
        let pool = Pool::<f32>::new();
        let round = || {
            let before = pool.peak_bytes();
            let held: Vec<_> = (1..40).map(|k| pool.take(300 * (k * 17 % 40))).collect();
            held.into_iter().for_each(|buffer| pool.give(buffer));
            for k in 1..40 {
                let (a, b) = (pool.take(500 * (k * 7 % 40)), pool.take(700 * (k * 11 % 13)));
                pool.give(a);
                pool.give(b);
            }
            pool.peak_bytes() > before
        };
        assert!(round());
        round();
        assert!((0..5).all(|_| !round()), "the pool still grows");
    }

    #[test]
    fn the_peak_counts_what_is_taken_and_what_rests() {
        let pool = Pool::<f32>::new();
        let (a, b) = (pool.take(1000), pool.take(3000));
        assert_eq!(pool.peak_bytes(), 4 * 4000);
        pool.give(a);
        pool.give(b);
        let (a, b) = (pool.take(900), pool.take(2000));
        pool.give(a);
        pool.give(b);
        assert_eq!((pool.elements(), pool.peak_bytes()), (4000, 4 * 4000), "the same two buffers");
        pool.give(vec![0.0; 5000]);
        assert_eq!((pool.elements(), pool.peak_bytes()), (9000, 4 * 9000), "one from elsewhere");
        pool.clear();
        assert_eq!((pool.elements(), pool.peak_bytes()), (0, 4 * 9000));
    }
}
