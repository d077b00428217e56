//! Entries of a zip archive whose content is stored as it is, as `torch.save` writes them; also in the form for large files (zip64).
//!
//! The directory at the end is what counts. A local header is looked at only for the place of the content behind it, because its
//! lengths may be zero when the writer did not know them yet.

use std::collections::BTreeMap;

use super::bytes::Bytes;
use super::error::PthError;

const ENTRY: u32 = 0x0201_4b50;
const LOCAL: u32 = 0x0403_4b50;
const END: u32 = 0x0605_4b50;
const END_64: u32 = 0x0606_4b50;
const LOCATOR_64: u32 = 0x0706_4b50;
/// Bytes of the record at the end, without the comment.
const END_LENGTH: usize = 22;
/// Bytes of the record that tells where the end record of zip64 is.
const LOCATOR_LENGTH: usize = 20;
/// Kind of the extra field that holds lengths and places of zip64.
const EXTRA_64: u16 = 1;

/// The directory of an archive in memory.
pub(super) struct Archive<'a> {
    bytes: &'a [u8],
    entries: BTreeMap<&'a str, Entry>,
}

/// What the directory says about an entry.
struct Entry {
    /// Why it cannot be read; programs beside the weights may be compressed.
    fault: Option<&'static str>,
    checksum: u32,
    length: usize,
    header: usize,
}

impl<'a> Archive<'a> {
    /// Reads the directory.
    pub(super) fn open(bytes: &'a [u8]) -> Result<Self, PthError> {
        let (count, start) = end_record(bytes)?;
        let mut reader = Bytes::new(bytes, start);
        let mut entries = BTreeMap::new();
        let mut held = 0usize;
        for _ in 0..count {
            let (name, entry) = directory_entry(&mut reader)?;
            held = held.saturating_add(entry.length);
            if held > bytes.len() {
                return Err(PthError::Entry { entry: name.to_owned(), what: "is longer than the file" });
            }
            if entries.insert(name, entry).is_some() {
                return Err(PthError::Entry { entry: name.to_owned(), what: "comes twice" });
            }
        }
        Ok(Self { bytes, entries })
    }

    /// Number of bytes of the file.
    pub(super) fn length(&self) -> usize {
        self.bytes.len()
    }

    /// The folder that holds `data.pkl`.
    pub(super) fn root(&self) -> Result<String, PthError> {
        let mut roots = self.entries.keys().filter_map(|name| name.strip_suffix("/data.pkl")).filter(|root| !root.contains('/'));
        roots.next().map(str::to_owned).ok_or_else(|| PthError::NoEntry { entry: "*/data.pkl".to_owned() })
    }

    /// Whether there is an entry of this name.
    pub(super) fn has(&self, name: &str) -> bool {
        self.entries.contains_key(name)
    }

    /// Whether there is an entry whose name begins so.
    pub(super) fn has_under(&self, folder: &str) -> bool {
        self.entries.keys().any(|name| name.starts_with(folder))
    }

    /// The content of an entry, whose checksum is compared.
    pub(super) fn data(&self, name: &str) -> Result<&'a [u8], PthError> {
        let entry = self.entries.get(name).ok_or_else(|| PthError::NoEntry { entry: name.to_owned() })?;
        let refused = |what| PthError::Entry { entry: name.to_owned(), what };
        if let Some(fault) = entry.fault {
            return Err(refused(fault));
        }
        let data = content(self.bytes, entry).ok_or_else(|| refused("is not where the directory says"))?;
        if checksum(data) != entry.checksum {
            return Err(refused("has another checksum than its content"));
        }
        Ok(data)
    }
}

/// Number of entries, and where their list begins.
fn end_record(bytes: &[u8]) -> Result<(u64, usize), PthError> {
    let cut = || PthError::Cut { what: "the list of entries of the archive" };
    let last = bytes.len().checked_sub(END_LENGTH).ok_or_else(cut)?;
    let first = last.saturating_sub(usize::from(u16::MAX));
    let end = (first..=last).rev().find(|&at| is_end(bytes, at)).ok_or_else(cut)?;
    let mut reader = Bytes::new(bytes, end + 4);
    let [disk, list_disk, here, count] = [(); 4].map(|()| reader.u16().unwrap_or_default());
    let _length = reader.u32().ok_or_else(cut)?;
    let start = reader.u32().ok_or_else(cut)?;
    let large = count == u16::MAX || start == u32::MAX;
    if large && let Some(record) = end_record_64(bytes, end) {
        return record;
    }
    if (disk, list_disk) != (0, 0) || here != count {
        return Err(PthError::Damaged { what: "an archive in several parts", at: end });
    }
    Ok((u64::from(count), to_usize(u64::from(start), end)?))
}

fn is_end(bytes: &[u8], at: usize) -> bool {
    let mut reader = Bytes::new(bytes, at);
    let signed = reader.u32() == Some(END) && reader.take(END_LENGTH - 6).is_some();
    signed && reader.u16().is_some_and(|comment| reader.at() + usize::from(comment) == bytes.len())
}

/// The same of zip64; `None` when there is no such record before the end.
fn end_record_64(bytes: &[u8], end: usize) -> Option<Result<(u64, usize), PthError>> {
    let locator = end.checked_sub(LOCATOR_LENGTH)?;
    let mut reader = Bytes::new(bytes, locator);
    if reader.u32()? != LOCATOR_64 {
        return None;
    }
    let _disk = reader.u32()?;
    let record = reader.u64()?;
    Some(to_usize(record, locator).and_then(|at| {
        let damaged = PthError::Damaged { what: "no list of entries in the form for large files", at };
        read_end_64(&mut Bytes::new(bytes, at)).ok_or(damaged).and_then(|(count, start)| Ok((count, to_usize(start, at)?)))
    }))
}

fn read_end_64(reader: &mut Bytes) -> Option<(u64, u64)> {
    if reader.u32()? != END_64 {
        return None;
    }
    let (_length, _versions, disks, here, count, _bytes) =
        (reader.u64()?, reader.u32()?, reader.u64()?, reader.u64()?, reader.u64()?, reader.u64()?);
    (disks == 0 && here == count).then_some((count, reader.u64()?))
}

/// Name and content of the next entry of the directory.
fn directory_entry<'a>(reader: &mut Bytes<'a>) -> Result<(&'a str, Entry), PthError> {
    let at = reader.at();
    let damaged = |what| PthError::Damaged { what, at };
    let raw = read_entry(reader).ok_or_else(|| damaged("no entry of the directory"))?;
    let name = std::str::from_utf8(raw.name).map_err(|_| damaged("a name that is no text"))?;
    let no_length = || PthError::Entry { entry: name.to_owned(), what: "has no length" };
    let [length, packed, header] = raw.lengths().ok_or_else(no_length)?;
    let fault = match raw.method {
        _ if raw.flags & 1 != 0 => Some("is encrypted"),
        0 if length == packed => None,
        0 => Some("has two lengths"),
        _ => Some("is compressed, which torch.save does not do"),
    };
    Ok((name, Entry { fault, checksum: raw.checksum, length: to_usize(packed, at)?, header: to_usize(header, at)? }))
}

/// An entry of the directory as it stands there.
struct RawEntry<'a> {
    flags: u16,
    method: u16,
    checksum: u32,
    packed: u32,
    length: u32,
    header: u32,
    name: &'a [u8],
    extra: &'a [u8],
}

fn read_entry<'a>(reader: &mut Bytes<'a>) -> Option<RawEntry<'a>> {
    if reader.u32()? != ENTRY {
        return None;
    }
    let _versions = reader.u32()?;
    let (flags, method, _time) = (reader.u16()?, reader.u16()?, reader.u32()?);
    let (checksum, packed, length) = (reader.u32()?, reader.u32()?, reader.u32()?);
    let [name, extra, comment] = [reader.u16()?, reader.u16()?, reader.u16()?].map(usize::from);
    let (_disk, _attributes) = (reader.u16()?, reader.array::<6>()?);
    let header = reader.u32()?;
    let (name, extra, _comment) = (reader.take(name)?, reader.take(extra)?, reader.take(comment)?);
    Some(RawEntry { flags, method, checksum, packed, length, header, name, extra })
}

impl RawEntry<'_> {
    /// Length, packed length and place; those that do not fit into 32 bits stand in an extra field, in this order.
    fn lengths(&self) -> Option<[u64; 3]> {
        let mut large = self.extra_64();
        let mut whole = |small: u32| match small {
            u32::MAX => large.as_mut()?.u64(),
            _ => Some(u64::from(small)),
        };
        Some([whole(self.length)?, whole(self.packed)?, whole(self.header)?])
    }

    fn extra_64(&self) -> Option<Bytes<'_>> {
        let mut reader = Bytes::new(self.extra, 0);
        loop {
            let (kind, length) = (reader.u16()?, usize::from(reader.u16()?));
            let field = reader.take(length)?;
            if kind == EXTRA_64 {
                return Some(Bytes::new(field, 0));
            }
        }
    }
}

/// The content of an entry, behind its local header.
fn content<'a>(bytes: &'a [u8], entry: &Entry) -> Option<&'a [u8]> {
    let mut reader = Bytes::new(bytes, entry.header);
    if reader.u32()? != LOCAL {
        return None;
    }
    let _until_lengths = reader.take(22)?;
    let (name, extra) = (reader.u16()?, reader.u16()?);
    reader.take(usize::from(name) + usize::from(extra))?;
    reader.take(entry.length)
}

fn to_usize(value: u64, at: usize) -> Result<usize, PthError> {
    usize::try_from(value).map_err(|_| PthError::Damaged { what: "a number too large for this machine", at })
}

/// CRC-32 as zip has it: polynomial 0x04c11db7, bits reversed, begun and ended with all ones.
pub(super) fn checksum(bytes: &[u8]) -> u32 {
    let step = |crc: u32, &byte: &u8| TABLE[usize::from(crc.to_le_bytes()[0] ^ byte)] ^ (crc >> 8);
    !bytes.iter().fold(!0, step)
}

const TABLE: [u32; 256] = table();

const fn table() -> [u32; 256] {
    let mut table = [0; 256];
    let mut i = 0;
    while i < 256 {
        let (mut crc, mut bit) = (i as u32, 0);
        while bit < 8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 };
            bit += 1;
        }
        table[i] = crc;
        i += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_match_the_published_value() {
        assert_eq!((checksum(b"123456789"), checksum(b"")), (0xcbf4_3926, 0));
    }
}
