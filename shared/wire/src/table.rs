//! The wire as data, which `stgdat wire` prints for programs in other languages. The macros of
//! [`crate::declare`] create its entries.

use bytemuck::Pod;

/// Everything that programs in other languages need to read and write frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Table {
    /// [`SCHEMA`](crate::SCHEMA).
    pub schema: u32,
    /// Limits and sizes.
    pub constants: &'static [Constant],
    /// Bits of the fields that hold flags.
    pub flags: &'static [Flags],
    /// Numbers with names.
    pub numbers: &'static [Numbers],
    /// Every record, after the records that it contains.
    pub records: &'static [Record],
    /// The topics, in the order in which a tick passes them.
    pub topics: &'static [TopicEntry],
}

/// A constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constant {
    /// Its name, in capitals.
    pub name: &'static str,
    /// Its meaning.
    pub doc: &'static str,
    /// Its value.
    pub value: Value,
}

/// The value of a constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// A whole number.
    Integer(u64),
    /// A single-precision number.
    Real(f32),
}

/// The bits of a field that holds flags.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flags {
    /// Their name.
    pub name: &'static str,
    /// Their meaning.
    pub doc: &'static str,
    /// Each bit as its value in the field.
    pub bits: &'static [Constant],
}

/// Named values of a `u32`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Numbers {
    /// Their name.
    pub name: &'static str,
    /// Their meaning.
    pub doc: &'static str,
    /// Each number, in ascending order.
    pub entries: &'static [Number],
}

/// A number with a name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    /// The name used in files and reports.
    pub name: &'static str,
    /// Its meaning.
    pub doc: &'static str,
    /// The number.
    pub number: u32,
}

/// A struct that crosses process borders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Its name.
    pub name: &'static str,
    /// Its meaning.
    pub doc: &'static str,
    /// Its size in bytes.
    pub size: usize,
    /// Its alignment in bytes.
    pub align: usize,
    /// Its fields, without a gap between them.
    pub fields: &'static [Field],
}

/// A field of a record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Its meaning.
    pub doc: &'static str,
    /// Offset in bytes from the record's start.
    pub offset: usize,
    /// Its type.
    pub r#type: Type,
}

/// The type of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Type {
    /// A number of the machine, little-endian.
    Primitive(Primitive),
    /// An array of this many elements of one type.
    Array(&'static Self, usize),
    /// A record.
    Record(&'static Record),
}

/// A number of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Primitive {
    U8,
    U16,
    U32,
    U64,
    I64,
    F32,
}

/// A topic: the stream `stgdat/NAME` in shared memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TopicEntry {
    /// Its name, as in pipeline.toml.
    pub name: &'static str,
    /// Sender, receivers and content.
    pub doc: &'static str,
    /// The type name of its elements.
    pub type_name: &'static str,
    /// An element of its payload slice.
    pub element: &'static Record,
    /// Maximum number of elements in a frame.
    pub elements_max: usize,
    /// Number of elements that a writer's first memory has room for.
    pub elements_start: usize,
    /// Maximum number of processes that publish at a time.
    pub publishers_max: usize,
    /// Maximum number of processes that subscribe at a time.
    pub subscribers_max: usize,
    /// Maximum depth of a subscriber's queue.
    pub depth_max: usize,
}

/// A type with a fixed layout: primitives, records, and arrays of these.
pub trait Layout: Pod {
    /// Its entry in the table.
    const TYPE: Type;
}

macro_rules! primitives {
    ($($type:ty => $primitive:ident),+) => {
        $(impl Layout for $type {
            const TYPE: Type = Type::Primitive(Primitive::$primitive);
        })+
    };
}

primitives!(u8 => U8, u16 => U16, u32 => U32, u64 => U64, i64 => I64, f32 => F32);

impl<T: Layout, const N: usize> Layout for [T; N] {
    const TYPE: Type = Type::Array(&T::TYPE, N);
}

impl Primitive {
    /// Its name in Rust.
    pub const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::U32 => "u32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
        }
    }

    /// Its size in bytes, which is also its alignment.
    pub const fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
            Self::U64 | Self::I64 => 8,
        }
    }
}

impl Type {
    /// Its size in bytes.
    pub const fn size(&self) -> usize {
        match self {
            Self::Primitive(primitive) => primitive.size(),
            Self::Array(of, len) => of.size() * *len,
            Self::Record(record) => record.size,
        }
    }

    /// Its alignment in bytes, as in C.
    pub const fn align(&self) -> usize {
        match self {
            Self::Primitive(primitive) => primitive.size(),
            Self::Array(of, _) => of.align(),
            Self::Record(record) => record.align,
        }
    }
}

/// A single number within a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Leaf {
    /// Its path, such as `hops[3].sent_ns`.
    pub path: String,
    /// Offset in bytes from the record's start.
    pub offset: usize,
    /// Its kind.
    pub primitive: Primitive,
}

impl Record {
    /// Every number of the record, in the order of their offsets.
    pub fn leaves(&self) -> Vec<Leaf> {
        let mut leaves = Vec::new();
        for field in self.fields {
            field.r#type.push_leaves(field.name, field.offset, &mut leaves);
        }
        leaves
    }
}

impl Type {
    fn push_leaves(&self, path: &str, offset: usize, leaves: &mut Vec<Leaf>) {
        match self {
            Self::Primitive(primitive) => {
                leaves.push(Leaf { path: path.to_owned(), offset, primitive: *primitive });
            }
            Self::Array(part, len) => {
                for place in 0..*len {
                    part.push_leaves(&format!("{path}[{place}]"), offset + place * part.size(), leaves);
                }
            }
            Self::Record(record) => {
                for field in record.fields {
                    let path = format!("{path}.{}", field.name);
                    field.r#type.push_leaves(&path, offset + field.offset, leaves);
                }
            }
        }
    }
}
