//! Writes MCAP records.

/// Names of the metadata at the start and at the end of the file.
pub const BEGIN: &str = "stgdat.run";
pub const END: &str = "stgdat.end";

/// Bytes of a record before its body: opcode and length.
pub const PREFIX: usize = 9;

/// The body of a record, written part by part.
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

    /// Appends bytes without their length.
    pub fn raw(mut self, bytes: &[u8]) -> Self {
        self.0.extend_from_slice(bytes);
        self
    }

    /// Appends bytes after their length.
    pub fn bytes(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).raw(bytes)
    }

    pub fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    /// Appends a map of texts.
    pub fn texts(self, pairs: &[(&str, String)]) -> Self {
        let body = pairs.iter().fold(Self::default(), |body, (key, value)| body.text(key).text(value));
        self.bytes(&body.0)
    }

    /// Appends a map of numbers.
    pub fn counts(self, pairs: impl Iterator<Item = (u16, u64)>) -> Self {
        let body = pairs.fold(Self::default(), |body, (key, value)| body.u16(key).u64(value));
        self.bytes(&body.0)
    }

    /// Appends the record to `out`.
    pub fn record(self, op: u8, out: &mut Vec<u8>) {
        out.push(op);
        out.extend((self.0.len() as u64).to_le_bytes());
        out.extend(self.0);
    }
}

/// Prefix of the topic names of these channels.
pub const BEFORE: &str = "before/";

/// Encoding of frames.
pub const WIRE: &str = "stgdat-wire";

/// Encoding of events and log lines.
pub const JSON: &str = "json";
