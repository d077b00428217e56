//! Buffers kept for the next step, so that a training step in steady state allocates next to nothing.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use crate::Scalar;

/// Buffers below this many elements are not worth keeping.
const SMALLEST_KEPT: usize = 256;

/// A store of buffers by length. Tensors of a [`Tape`](crate::Tape) return their buffer here when the last handle is gone.
#[derive(Debug, Default)]
pub struct Pool<T> {
    shelves: Mutex<BTreeMap<usize, Vec<Vec<T>>>>,
}

impl<T: Scalar> Pool<T> {
    /// An empty pool.
    pub fn new() -> Arc<Self> {
        Arc::new(Pool { shelves: Mutex::new(BTreeMap::new()) })
    }

    /// A buffer of `len` elements with arbitrary (initialised) contents.
    pub fn take(&self, len: usize) -> Vec<T> {
        if len >= SMALLEST_KEPT {
            let mut shelves = self.shelves.lock().expect("the pool's lock is never held across a panic");
            if let Some(buffer) = shelves.get_mut(&len).and_then(Vec::pop) {
                return buffer;
            }
        }
        vec![T::ZERO; len]
    }

    /// A buffer of `len` zeros.
    pub fn take_zeroed(&self, len: usize) -> Vec<T> {
        let mut buffer = self.take(len);
        buffer.fill(T::ZERO);
        buffer
    }

    /// Keeps a buffer for later.
    pub fn give(&self, buffer: Vec<T>) {
        if buffer.len() >= SMALLEST_KEPT {
            let mut shelves = self.shelves.lock().expect("the pool's lock is never held across a panic");
            shelves.entry(buffer.len()).or_default().push(buffer);
        }
    }

    /// Elements of all buffers at rest.
    pub fn elements(&self) -> usize {
        let shelves = self.shelves.lock().expect("the pool's lock is never held across a panic");
        shelves.iter().map(|(len, buffers)| len * buffers.len()).sum()
    }

    /// Returns every buffer at rest to the system.
    pub fn clear(&self) {
        self.shelves.lock().expect("the pool's lock is never held across a panic").clear();
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
}
