//! A bounded cache that forgets what was used longest ago.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// At most `capacity` values by key. The lock is held for look-up and insertion only, never while a value is made.
pub struct Cache<K, V> {
    capacity: usize,
    state: Mutex<State<K, V>>,
}

struct State<K, V> {
    clock: u64,
    /// The value and when it was last used.
    values: BTreeMap<K, (u64, Arc<V>)>,
    /// The key by time of last use.
    order: BTreeMap<u64, K>,
}

impl<K: Ord + Copy, V> Cache<K, V> {
    /// An empty cache for at least one value.
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), state: Mutex::new(State { clock: 0, values: BTreeMap::new(), order: BTreeMap::new() }) }
    }

    /// The value of a key, made by `make` when it is not there. Two threads may make the same value at the same time; `make`
    /// must give equal values for equal keys.
    pub fn get_or_make(&self, key: K, make: impl FnOnce() -> V) -> Arc<V> {
        if let Some(found) = self.touch(key) {
            return found;
        }
        let value = Arc::new(make());
        self.insert(key, &value);
        value
    }

    /// How many values are held.
    #[cfg(test)]
    fn len(&self) -> usize {
        self.lock().values.len()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State<K, V>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn touch(&self, key: K) -> Option<Arc<V>> {
        let mut state = self.lock();
        let state = &mut *state;
        state.clock += 1;
        let (used, value) = state.values.get_mut(&key)?;
        state.order.remove(used);
        *used = state.clock;
        state.order.insert(state.clock, key);
        Some(Arc::clone(value))
    }

    fn insert(&self, key: K, value: &Arc<V>) {
        let mut state = self.lock();
        let state = &mut *state;
        state.clock += 1;
        if let Some((used, _)) = state.values.insert(key, (state.clock, Arc::clone(value))) {
            state.order.remove(&used);
        }
        state.order.insert(state.clock, key);
        if state.values.len() > self.capacity
            && let Some((_, oldest)) = state.order.pop_first()
        {
            state.values.remove(&oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forgets_the_value_used_longest_ago() {
        let cache = Cache::new(2);
        let get = |key: u32| *cache.get_or_make(key, || key * 10);
        assert_eq!((get(1), get(2), get(1), get(3)), (10, 20, 10, 30));
        assert_eq!(cache.len(), 2);
        assert_eq!(*cache.get_or_make(1, || 99), 10, "1 was used after 2 and is still there");
        assert_eq!(*cache.get_or_make(2, || 99), 99, "2 was forgotten");
        assert_eq!(cache.len(), 2);
    }
}
