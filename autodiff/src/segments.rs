//! A list that grows without moving what it holds.

use std::ops::{Index, IndexMut};

/// Items of a segment: few enough that no segment of the tape is a large allocation.
const SEGMENT: usize = 256;

/// A list in segments of equal size. A graph of many nodes needs no large allocation then, and none is copied while it grows.
pub(crate) struct Segments<T> {
    segments: Vec<Vec<T>>,
}

impl<T> Segments<T> {
    /// An empty list.
    pub(crate) fn new() -> Self {
        Segments { segments: Vec::new() }
    }

    /// Number of items.
    pub(crate) fn len(&self) -> usize {
        match self.segments.as_slice() {
            [] => 0,
            [whole @ .., last] => whole.len() * SEGMENT + last.len(),
        }
    }

    /// Adds an item at the end.
    pub(crate) fn push(&mut self, item: T) {
        match self.segments.last_mut() {
            Some(last) if last.len() < SEGMENT => last.push(item),
            _ => {
                let mut segment = Vec::with_capacity(SEGMENT);
                segment.push(item);
                self.segments.push(segment);
            }
        }
    }

    /// The items in order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &T> {
        self.segments.iter().flatten()
    }

    /// The item at a place, if there is one.
    pub(crate) fn get(&self, i: usize) -> Option<&T> {
        self.segments.get(i / SEGMENT)?.get(i % SEGMENT)
    }

    /// The item at a place, to be changed, if there is one.
    pub(crate) fn get_mut(&mut self, i: usize) -> Option<&mut T> {
        self.segments.get_mut(i / SEGMENT)?.get_mut(i % SEGMENT)
    }
}

impl<T> FromIterator<T> for Segments<T> {
    fn from_iter<I: IntoIterator<Item = T>>(items: I) -> Self {
        let mut all = Self::new();
        items.into_iter().for_each(|item| all.push(item));
        all
    }
}

impl<T> Index<usize> for Segments<T> {
    type Output = T;
    #[track_caller]
    fn index(&self, i: usize) -> &T {
        &self.segments[i / SEGMENT][i % SEGMENT]
    }
}

impl<T> IndexMut<usize> for Segments<T> {
    #[track_caller]
    fn index_mut(&mut self, i: usize) -> &mut T {
        &mut self.segments[i / SEGMENT][i % SEGMENT]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_stand_in_order() {
        for len in [0, 1, SEGMENT - 1, SEGMENT, SEGMENT + 1, 3 * SEGMENT, 3 * SEGMENT + 7] {
            let mut list: Segments<usize> = (0..len).collect();
            assert_eq!(list.len(), len);
            assert!(list.iter().copied().eq(0..len));
            assert!((0..len).all(|i| list[i] == i && list.get(i) == Some(&i)));
            assert!(list.get(len).is_none() && list.get_mut(len + SEGMENT).is_none());
            if len > 0 {
                list[len - 1] = 7;
                assert_eq!(list.get_mut(len - 1), Some(&mut 7));
            }
        }
    }

    #[test]
    fn growing_moves_nothing() {
        let mut list = Segments::new();
        list.push(0);
        let first: *const i32 = &list[0];
        (1..5000).for_each(|i| list.push(i));
        assert!(std::ptr::eq(first, &list[0]));
    }
}
