//! A bounded store of decoded frames.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::Frame;

type Key = (usize, usize);

/// Keeps the frames used last, up to a number of bytes; what it holds never changes a result, only the time.
pub(crate) struct FrameCache {
    budget: usize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    clock: u64,
    bytes: usize,
    frames: BTreeMap<Key, (u64, Arc<Frame>)>,
    by_age: BTreeMap<u64, Key>,
}

impl FrameCache {
    /// A cache that holds at most `budget` bytes of rasters.
    pub(crate) fn new(budget: usize) -> Self {
        Self { budget, state: Mutex::new(State::default()) }
    }

    /// The frame stored under (sequence, frame), now the youngest.
    pub(crate) fn get(&self, key: Key) -> Option<Arc<Frame>> {
        let mut guard = self.lock();
        let state = &mut *guard;
        state.clock += 1;
        let (age, frame) = state.frames.get_mut(&key)?;
        state.by_age.remove(age);
        *age = state.clock;
        state.by_age.insert(state.clock, key);
        Some(Arc::clone(frame))
    }

    /// Stores a frame and drops the oldest ones above the budget; a frame larger than the budget is not stored.
    pub(crate) fn insert(&self, key: Key, frame: &Arc<Frame>) {
        let bytes = frame_bytes(frame);
        let mut guard = self.lock();
        let state = &mut *guard;
        if bytes > self.budget || state.frames.contains_key(&key) {
            return;
        }
        state.clock += 1;
        state.bytes += bytes;
        state.frames.insert(key, (state.clock, Arc::clone(frame)));
        state.by_age.insert(state.clock, key);
        while state.bytes > self.budget {
            let Some((_, oldest)) = state.by_age.pop_first() else {
                break;
            };
            if let Some((_, dropped)) = state.frames.remove(&oldest) {
                state.bytes -= frame_bytes(&dropped);
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // The state is consistent between statements, so a panic elsewhere does not spoil it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn frame_bytes(frame: &Frame) -> usize {
    let floats = frame.image.data.len() + frame.depth.as_ref().map_or(0, |map| map.data.len());
    floats * size_of::<f32>() + size_of::<Frame>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Image;
    use dimode_geometry::Intrinsics;

    fn frame(name: &str) -> Arc<Frame> {
        let intrinsics = Intrinsics::new(10.0, 10.0, 5.0, 5.0, 10, 10).unwrap();
        let image = Image::zeros(3, 10, 10);
        Arc::new(Frame { image, intrinsics, depth: None, world_from_camera: None, name: name.to_owned() })
    }

    #[test]
    fn the_least_recently_used_frame_goes_first() {
        let one = frame_bytes(&frame("x"));
        let cache = FrameCache::new(2 * one + one / 2);
        cache.insert((0, 0), &frame("a"));
        cache.insert((0, 1), &frame("b"));
        assert_eq!(cache.get((0, 0)).unwrap().name, "a");
        cache.insert((0, 2), &frame("c"));
        assert!(cache.get((0, 1)).is_none());
        assert!(cache.get((0, 0)).is_some() && cache.get((0, 2)).is_some());
        assert_eq!(cache.lock().bytes, 2 * one);
    }

    #[test]
    fn nothing_is_kept_without_a_budget() {
        let cache = FrameCache::new(0);
        cache.insert((0, 0), &frame("a"));
        assert!(cache.get((0, 0)).is_none());
    }
}
