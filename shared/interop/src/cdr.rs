//! Plain CDR version 1, little-endian: the encoding of ROS 2 messages on DDS and in bags.
//!
//! Numbers are aligned to their size, relative to the first byte behind the encapsulation header. Texts and
//! sequences begin with their length; the length of a text includes its final zero.

use thiserror::Error;

use crate::definition::{Primitive, Type};

/// Encapsulation header: plain CDR, little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Why bytes are not a message.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum CdrError {
    /// Another encoding.
    #[error("encapsulation {0:02x?}: expected plain CDR, little-endian ([00, 01])")]
    Encapsulation([u8; 2]),
    /// The bytes end inside of a value.
    #[error("{len} bytes: a value at byte {at} is cut short")]
    Short {
        /// Number of bytes.
        len: usize,
        /// Place of the value.
        at: usize,
    },
    /// A text without its final zero, or not in UTF-8.
    #[error("the text at byte {0} is not UTF-8 with a final zero")]
    Text(usize),
}

/// A value that CDR can represent.
pub trait Cdr: Sized {
    /// The type in ROS.
    const TYPE: Type;

    /// Appends the value.
    fn write(&self, output: &mut Output);

    /// Reads a value.
    ///
    /// # Errors
    /// [`CdrError`] if the bytes are not such a value.
    fn read(input: &mut Input<'_>) -> Result<Self, CdrError>;
}

/// A message with its encapsulation header.
#[must_use]
pub fn to_bytes<M: Cdr>(message: &M) -> Vec<u8> {
    let mut output = Output(ENCAPSULATION.to_vec());
    message.write(&mut output);
    output.0
}

/// Reads a message with its encapsulation header.
///
/// # Errors
/// [`CdrError`] if the bytes are not such a message. Bytes behind the message are ignored.
pub fn from_bytes<M: Cdr>(bytes: &[u8]) -> Result<M, CdrError> {
    let Some((header, _)) = bytes.split_first_chunk::<4>() else {
        return Err(CdrError::Short { len: bytes.len(), at: 0 });
    };
    if header[..2] != ENCAPSULATION[..2] {
        return Err(CdrError::Encapsulation([header[0], header[1]]));
    }
    M::read(&mut Input { bytes, at: ENCAPSULATION.len() })
}

/// The bytes of a message that is written.
#[derive(Debug)]
pub struct Output(Vec<u8>);

impl Output {
    fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        let len = ENCAPSULATION.len() + (self.0.len() - ENCAPSULATION.len()).next_multiple_of(N);
        self.0.resize(len, 0);
        self.0.extend_from_slice(&bytes);
    }

    fn len(&mut self, len: usize) {
        self.number((len as u32).to_le_bytes());
    }
}

/// The bytes of a message that is read.
#[derive(Debug)]
pub struct Input<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Input<'a> {
    fn take(&mut self, len: usize) -> Result<&'a [u8], CdrError> {
        let taken = self.bytes.get(self.at..).and_then(|rest| rest.get(..len));
        let taken = taken.ok_or(CdrError::Short { len: self.bytes.len(), at: self.at })?;
        self.at += len;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.at = ENCAPSULATION.len() + (self.at - ENCAPSULATION.len()).next_multiple_of(N);
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        Ok(bytes)
    }

    fn len(&mut self) -> Result<usize, CdrError> {
        Ok(u32::from_le_bytes(self.number()?) as usize)
    }
}

macro_rules! numbers {
    ($($type:ty => $name:literal $id:literal,)+) => {
        $(impl Cdr for $type {
            const TYPE: Type = Type::Primitive(Primitive { name: $name, id: $id });

            fn write(&self, output: &mut Output) {
                output.number(self.to_le_bytes());
            }

            fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
                Ok(Self::from_le_bytes(input.number()?))
            }
        })+
    };
}

numbers! {
    u8 => "uint8" 3,
    i32 => "int32" 6,
    u32 => "uint32" 7,
    f32 => "float32" 10,
    f64 => "float64" 11,
}

impl Cdr for bool {
    const TYPE: Type = Type::Primitive(Primitive { name: "bool", id: 15 });

    fn write(&self, output: &mut Output) {
        u8::from(*self).write(output);
    }

    fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
        Ok(u8::read(input)? != 0)
    }
}

/// ROS's type `byte`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Byte(pub u8);

impl Cdr for Byte {
    const TYPE: Type = Type::Primitive(Primitive { name: "byte", id: 16 });

    fn write(&self, output: &mut Output) {
        self.0.write(output);
    }

    fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
        Ok(Self(u8::read(input)?))
    }
}

impl Cdr for String {
    const TYPE: Type = Type::Primitive(Primitive { name: "string", id: 17 });

    fn write(&self, output: &mut Output) {
        output.len(self.len() + 1);
        output.0.extend_from_slice(self.as_bytes());
        output.0.push(0);
    }

    fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
        let len = input.len()?;
        let at = input.at;
        let (zero, text) = input.take(len)?.split_last().ok_or(CdrError::Text(at))?;
        let text = std::str::from_utf8(text).ok().filter(|_| *zero == 0);
        text.map(str::to_owned).ok_or(CdrError::Text(at))
    }
}

impl<T: Cdr, const N: usize> Cdr for [T; N] {
    const TYPE: Type = Type::Array(&T::TYPE, N);

    fn write(&self, output: &mut Output) {
        self.iter().for_each(|element| element.write(output));
    }

    fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
        let elements: Result<Vec<T>, _> = (0..N).map(|_| T::read(input)).collect();
        let short = CdrError::Short { len: input.bytes.len(), at: input.at };
        elements?.try_into().map_err(|_| short)
    }
}

impl<T: Cdr> Cdr for Vec<T> {
    const TYPE: Type = Type::Sequence(&T::TYPE);

    fn write(&self, output: &mut Output) {
        output.len(self.len());
        self.iter().for_each(|element| element.write(output));
    }

    fn read(input: &mut Input<'_>) -> Result<Self, CdrError> {
        // No memory is reserved: a damaged length ends at the last byte.
        (0..input.len()?).map(|_| T::read(input)).collect()
    }
}
