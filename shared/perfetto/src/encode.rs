//! The part of Protobuf that traces and scenes need: numbers, texts, bytes, doubles and nested messages.

/// Bytes of a nested message's length: seven bits each, padded so that the length can be filled in
/// afterwards.
const LENGTH_LEN: usize = 4;

/// A message that appends to a buffer.
#[derive(Debug)]
pub struct Message<'a> {
    bytes: &'a mut Vec<u8>,
}

/// The encoding of a field's value.
#[derive(Clone, Copy)]
enum Wire {
    Varint = 0,
    Fixed = 1,
    Length = 2,
    Fixed32 = 5,
}

impl<'a> Message<'a> {
    /// A message whose fields are appended to `bytes`.
    pub const fn new(bytes: &'a mut Vec<u8>) -> Self {
        Self { bytes }
    }

    fn key(&mut self, field: u32, wire: Wire) {
        self.varint(u64::from(field) << 3 | wire as u64);
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// Appends a field with an unsigned number.
    pub fn number(&mut self, field: u32, value: u64) {
        self.key(field, Wire::Varint);
        self.varint(value);
    }

    /// Appends a field of type fixed64.
    pub fn fixed(&mut self, field: u32, value: u64) {
        self.key(field, Wire::Fixed);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Appends a field of type fixed32.
    pub fn fixed32(&mut self, field: u32, value: u32) {
        self.key(field, Wire::Fixed32);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Appends a field of type double.
    pub fn double(&mut self, field: u32, value: f64) {
        self.fixed(field, value.to_bits());
    }

    /// Appends a field with a text.
    pub fn text(&mut self, field: u32, text: &str) {
        self.data(field, text.as_bytes());
    }

    /// Appends a field with bytes.
    pub fn data(&mut self, field: u32, data: &[u8]) {
        self.key(field, Wire::Length);
        self.varint(data.len() as u64);
        self.bytes.extend_from_slice(data);
    }

    /// Appends a field that is a message; `fill` appends the message's fields.
    ///
    /// # Panics
    /// If the message has 256 MiB or more.
    pub fn message(&mut self, field: u32, fill: impl FnOnce(&mut Message<'_>)) {
        self.key(field, Wire::Length);
        let place = self.bytes.len();
        self.bytes.extend_from_slice(&[0; LENGTH_LEN]);
        fill(&mut Message::new(self.bytes));
        let mut len = self.bytes.len() - place - LENGTH_LEN;
        assert!(len < 1 << (7 * LENGTH_LEN), "a message of {len} bytes");
        for (byte, nth) in self.bytes[place..].iter_mut().zip(1..=LENGTH_LEN) {
            let more = if nth < LENGTH_LEN { 0x80 } else { 0 };
            *byte = (len & 0x7f) as u8 | more;
            len >>= 7;
        }
    }
}
