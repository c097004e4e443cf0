//! The records of MCAP that a recording is made of: their numbers, and how their parts are written and read.

/// First and last bytes of a file.
pub const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Bytes of a record before its body: its number and its length.
pub const PREFIX: usize = 9;
/// Bytes of a footer with its prefix.
pub const FOOTER: usize = PREFIX + 8 + 8 + 4;
/// Name of the compression of chunks.
pub const LZ4: &str = "lz4";

/// Numbers of the records.
pub mod op {
    pub const HEADER: u8 = 0x01;
    pub const FOOTER: u8 = 0x02;
    pub const SCHEMA: u8 = 0x03;
    pub const CHANNEL: u8 = 0x04;
    pub const MESSAGE: u8 = 0x05;
    pub const CHUNK: u8 = 0x06;
    pub const MESSAGE_INDEX: u8 = 0x07;
    pub const CHUNK_INDEX: u8 = 0x08;
    pub const STATISTICS: u8 = 0x0B;
    pub const METADATA: u8 = 0x0C;
    pub const METADATA_INDEX: u8 = 0x0D;
    pub const SUMMARY_OFFSET: u8 = 0x0E;
    pub const DATA_END: u8 = 0x0F;
}

/// The body of a record that is written part by part.
#[derive(Default)]
pub struct Body(Vec<u8>);

impl Body {
    pub fn u16(mut self, value: u16) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    pub fn u32(mut self, value: u32) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    pub fn u64(mut self, value: u64) -> Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    /// Bytes without their length.
    pub fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    /// Bytes after their length.
    pub fn bytes(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).raw(bytes)
    }

    pub fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    /// A map of texts.
    pub fn texts(self, pairs: &[(&str, String)]) -> Self {
        let body = pairs.iter().fold(Self::default(), |body, (key, value)| body.text(key).text(value));
        self.bytes(&body.0)
    }

    /// A map of numbers.
    pub fn counts(self, pairs: impl Iterator<Item = (u16, u64)>) -> Self {
        let body = pairs.fold(Self::default(), |body, (key, value)| body.u16(key).u64(value));
        self.bytes(&body.0)
    }

    /// The record, appended to `out`.
    pub fn record(self, op: u8, out: &mut Vec<u8>) {
        out.push(op);
        out.extend((self.0.len() as u64).to_le_bytes());
        out.extend(self.0);
    }
}

/// The body of a record that is read part by part; each part is none where too few bytes are left.
pub struct Parts<'a>(pub &'a [u8]);

impl<'a> Parts<'a> {
    pub fn raw(&mut self, len: usize) -> Option<&'a [u8]> {
        let (part, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(part)
    }

    pub fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.raw(2)?.try_into().ok()?))
    }

    pub fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.raw(4)?.try_into().ok()?))
    }

    pub fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.raw(8)?.try_into().ok()?))
    }

    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let len = self.u32()?;
        self.raw(len as usize)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }

    /// All of a map of texts.
    pub fn texts(mut self) -> Option<Vec<(&'a str, &'a str)>> {
        let mut pairs = Vec::new();
        while !self.0.is_empty() {
            pairs.push((self.text()?, self.text()?));
        }
        Some(pairs)
    }

    /// The record at the front: its number and its body.
    pub fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let op = self.raw(1)?[0];
        let len = usize::try_from(self.u64()?).ok()?;
        Some((op, self.raw(len)?))
    }
}
