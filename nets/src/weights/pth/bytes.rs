//! A place in bytes that moves on with what is read.

/// Reads little-endian numbers; every method is `None` past the end, and moves only if not.
#[derive(Clone, Debug)]
pub(super) struct Bytes<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    /// At byte `at` of `all`.
    pub(super) fn new(all: &'a [u8], at: usize) -> Self {
        Self { all, at }
    }

    /// The place.
    pub(super) fn at(&self) -> usize {
        self.at
    }

    /// The next `count` bytes.
    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(count)?;
        let taken = self.all.get(self.at..end)?;
        self.at = end;
        Some(taken)
    }

    /// The bytes up to the next line feed, which is passed.
    pub(super) fn line(&mut self) -> Option<&'a [u8]> {
        let rest = self.all.get(self.at..)?;
        let length = rest.iter().position(|&b| b == b'\n')?;
        self.at += length + 1;
        Some(&rest[..length])
    }

    /// The next number of `N` bytes, as bytes.
    pub(super) fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    /// The next byte.
    pub(super) fn u8(&mut self) -> Option<u8> {
        self.array().map(|[byte]| byte)
    }

    /// The next number of two bytes.
    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    /// The next number of four bytes.
    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    /// The next number of eight bytes.
    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_moves_past_the_end() {
        let mut bytes = Bytes::new(b"\x01\x02\x03ab\nc", 0);
        assert_eq!((bytes.u16(), bytes.u64(), bytes.at()), (Some(0x0201), None, 2));
        assert_eq!((bytes.u8(), bytes.line(), bytes.line(), bytes.at()), (Some(3), Some(&b"ab"[..]), None, 6));
        assert_eq!((bytes.take(usize::MAX), bytes.take(1), bytes.take(1)), (None, Some(&b"c"[..]), None));
        assert_eq!(Bytes::new(b"abc", 9).line(), None);
    }
}
