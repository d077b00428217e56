//! Archives and pickles made by hand, for files that PyTorch would not write.

/// A zip archive of stored entries.
#[derive(Clone)]
pub struct Archive {
    pub entries: Vec<Entry>,
    /// Whether lengths and places stand in the fields for large files.
    pub large: bool,
}

#[derive(Clone)]
pub struct Entry {
    pub name: String,
    pub data: Vec<u8>,
    /// How it says that it is packed; 0 is not at all.
    pub method: u16,
    pub flags: u16,
}

impl Archive {
    /// What `torch.save` would write for a pickle and storages of four-byte numbers.
    pub fn of(pickle: &[u8], storages: &[&[f32]]) -> Self {
        let mut archive = Self { entries: Vec::new(), large: false }.with("x/data.pkl", pickle).with("x/byteorder", b"little");
        for (key, values) in storages.iter().enumerate() {
            let data: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            archive = archive.with(&format!("x/data/{key}"), &data);
        }
        archive
    }

    pub fn with(mut self, name: &str, data: &[u8]) -> Self {
        self.entries.push(Entry { name: name.to_owned(), data: data.to_vec(), method: 0, flags: 0 });
        self
    }

    pub fn bytes(&self) -> Vec<u8> {
        let (mut out, mut list) = (Vec::new(), Vec::new());
        for entry in &self.entries {
            let header = out.len();
            let common = self.common(entry);
            out.extend(b"PK\x03\x04");
            out.extend(&common);
            // Local headers may have fields of their own.
            out.extend([&2u16.to_le_bytes()[..], entry.name.as_bytes(), b"FB"].concat());
            out.extend(&entry.data);
            list.extend(self.listed(entry, &common, header));
        }
        let start = out.len();
        out.extend(&list);
        if self.large {
            self.end_of_large(&mut out, start, list.len());
        }
        let count = if self.large { u16::MAX } else { self.entries.len() as u16 };
        let start = if self.large { u32::MAX } else { start as u32 };
        out.extend(b"PK\x05\x06\0\0\0\0");
        out.extend([count.to_le_bytes(), count.to_le_bytes()].concat());
        out.extend([(list.len() as u32).to_le_bytes(), start.to_le_bytes()].concat());
        out.extend([0, 0]);
        out
    }

    /// Version to length of the name, the same in both headers.
    fn common(&self, entry: &Entry) -> Vec<u8> {
        let length = if self.large { u32::MAX } else { entry.data.len() as u32 };
        let mut common = vec![20, 0];
        common.extend([entry.flags.to_le_bytes(), entry.method.to_le_bytes()].concat());
        common.extend([0; 4]);
        common.extend([checksum(&entry.data), length, length].map(u32::to_le_bytes).concat());
        common.extend((entry.name.len() as u16).to_le_bytes());
        common
    }

    fn listed(&self, entry: &Entry, common: &[u8], header: usize) -> Vec<u8> {
        let length = entry.data.len() as u64;
        let field: Vec<u8> = [length, length, header as u64].map(u64::to_le_bytes).concat();
        let extra = if self.large { [&[9, 9, 1, 0, 7, 1, 0, 24, 0][..], &field].concat() } else { Vec::new() };
        let place = if self.large { u32::MAX } else { header as u32 };
        let tail = [&(extra.len() as u16).to_le_bytes()[..], &[0; 10], &place.to_le_bytes()].concat();
        [b"PK\x01\x02", &[20, 0][..], common, &tail, entry.name.as_bytes(), &extra].concat()
    }

    fn end_of_large(&self, out: &mut Vec<u8>, start: usize, length: usize) {
        let record = out.len() as u64;
        let count = self.entries.len() as u64;
        out.extend(b"PK\x06\x06");
        out.extend([&44u64.to_le_bytes()[..], &[45, 0, 45, 0], &[0; 8]].concat());
        out.extend([count, count, length as u64, start as u64].map(u64::to_le_bytes).concat());
        out.extend([&b"PK\x06\x07\0\0\0\0"[..], &record.to_le_bytes(), &[1, 0, 0, 0]].concat());
    }
}

/// CRC-32, bit by bit.
fn checksum(data: &[u8]) -> u32 {
    let bit = |crc: u32, _| if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 };
    !data.iter().fold(!0, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), bit))
}

/// A pickle, written down instruction by instruction.
#[derive(Clone)]
pub struct Pickle(pub Vec<u8>);

impl Pickle {
    /// Protocol 2, an empty dictionary, a mark.
    pub fn dictionary() -> Self {
        Self(b"\x80\x02}(".to_vec())
    }

    pub fn raw(mut self, code: &[u8]) -> Self {
        self.0.extend(code);
        self
    }

    pub fn text(self, text: &str) -> Self {
        self.raw(b"X").raw(&(text.len() as u32).to_le_bytes()).raw(text.as_bytes())
    }

    /// A number of eight bytes.
    pub fn number(self, value: i64) -> Self {
        self.raw(b"\x8a\x08").raw(&value.to_le_bytes())
    }

    fn tuple(self, values: &[i64]) -> Self {
        values.iter().fold(self.raw(b"("), |pickle, &value| pickle.number(value)).raw(b"t")
    }

    /// Storage `key` of `count` numbers.
    fn storage(self, key: &str, count: i64) -> Self {
        self.raw(b"(").text("storage").raw(b"ctorch\nFloatStorage\n").text(key).text("cpu").number(count).raw(b"tQ")
    }

    /// A name and its tensor: storage, number of values in it, offset, dimensions, strides.
    pub fn tensor(self, name: &str, (key, count): (&str, i64), offset: i64, dims: &[i64], strides: &[i64]) -> Self {
        let begun = self.text(name).raw(b"ctorch._utils\n_rebuild_tensor_v2\n(").storage(key, count);
        begun.number(offset).tuple(dims).tuple(strides).raw(b"\x89ccollections\nOrderedDict\n)RtR")
    }

    /// The items go into the dictionary.
    pub fn end(self) -> Vec<u8> {
        self.raw(b"u.").0
    }
}
