//! The macros that declare the wire: each turns one readable declaration into Rust items and into an entry of
//! [`crate::TABLE`].
//!
//! [`record!`] declares a struct that crosses process borders. Every field is declared with its byte offset,
//! so that the source shows the layout and the compiler verifies it:
//!
//! ```text
//! record! {
//!     /// What the struct is.
//!     pub struct Name: 16 bytes {
//!         /// What the field is.
//!         0 => id: u64,
//!         /// What the field is.
//!         8 => position_m: [f32; 2],
//!     }
//! }
//! ```
//!
//! It becomes a `#[repr(C)]` struct of public fields that is `Pod`, with its `Default` (all zeros) and its
//! [`crate::Record`] in the table. Compile-time assertions check that each field is at its offset, that there
//! is no gap between fields or after the last, and that the size matches. A field's type is anything with a
//! [`crate::Layout`]: a primitive, a record, or an array of these.
//! `: 64 bytes, aligned 64` sets an alignment; `#[derive(…)]` under the doc comment adds derives.
//!
//! [`numbers!`] declares an enum whose variants are sent as `u32`. Each variant has its number and a name for
//! files and reports. [`constants!`] declares limits, sizes and bits of flags.

/// Declares a record; see the module.
macro_rules! record {
    (
        $(#[doc = $doc:literal])+
        $(#[derive($($derive:ident),+)])?
        pub struct $name:ident: $size:literal bytes $(, aligned $align:literal)? {
            $($(#[doc = $field_doc:literal])+ $offset:literal => $field:ident: $type:ty,)+
        }
    ) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable $($(, $derive)+)?)]
        #[repr(C $(, align($align))?)]
        pub struct $name {
            $($(#[doc = $field_doc])+ pub $field: $type,)+
        }

        const _: () = {
            let mut end = 0;
            $(
                assert!(
                    std::mem::offset_of!($name, $field) == $offset,
                    concat!(stringify!($name), ".", stringify!($field), " does not lie at ", $offset)
                );
                assert!(
                    end == $offset,
                    concat!("bytes without a name before ", stringify!($name), ".", stringify!($field))
                );
                end += size_of::<$type>();
            )+
            assert!(
                end == $size && size_of::<$name>() == $size,
                concat!(stringify!($name), " has not ", $size, " bytes")
            );
        };

        impl $crate::table::Layout for $name {
            const TYPE: $crate::table::Type = $crate::table::Type::Record(&Self::RECORD);
        }

        impl $name {
            /// The record's entry of the table.
            pub const RECORD: $crate::table::Record = $crate::table::Record {
                name: stringify!($name),
                doc: concat!($($doc, "\n"),+),
                size: $size,
                align: align_of::<Self>(),
                fields: &[$($crate::table::Field {
                    name: stringify!($field),
                    doc: concat!($($field_doc, "\n"),+),
                    offset: $offset,
                    r#type: <$type as $crate::table::Layout>::TYPE,
                }),+],
            };
        }

        /// All zeros: nothing is reported.
        impl Default for $name {
            fn default() -> Self {
                bytemuck::Zeroable::zeroed()
            }
        }

        #[cfg(test)]
        impl $crate::tests::distinct::Distinct for $name {
            fn number(&mut self, next: &mut u32) {
                $(self.$field.number(next);)+
            }
        }
    };
}

/// Declares an enum whose variants are sent as numbers; see the module.
macro_rules! numbers {
    (
        $(#[doc = $doc:literal])+
        $(#[derive($($derive:ident),+)])?
        pub enum $name:ident {
            $($(#[doc = $variant_doc:literal])+ $variant:ident = $number:literal => $text:literal,)+
        }
    ) => {
        $crate::named! {
            $(#[doc = $doc])+
            #[derive(Clone, Copy, Debug, PartialEq, Eq $($(, $derive)+)?)]
            #[repr(u32)]
            pub enum $name {
                $($(#[doc = $variant_doc])+ $variant = $number => $text,)+
            }
        }

        impl $name {
            /// Their entry in the table.
            pub const NUMBERS: $crate::table::Numbers = $crate::table::Numbers {
                name: stringify!($name),
                doc: concat!($($doc, "\n"),+),
                entries: &[$($crate::table::Number {
                    name: $text,
                    doc: concat!($($variant_doc, "\n"),+),
                    number: $number,
                }),+],
            };

            /// The variant with this number; `None` if this version has none.
            #[must_use]
            pub const fn from_number(number: u32) -> Option<Self> {
                match number {
                    $($number => Some(Self::$variant),)+
                    _ => None,
                }
            }
        }
    };
}

/// Declares constants and their list for the table; see the module.
macro_rules! constants {
    ($($(#[doc = $doc:literal])+ pub const $name:ident: $type:ident = $value:expr;)+) => {
        $($(#[doc = $doc])+ pub const $name: $type = $value;)+

        /// All of them, for the table.
        pub(crate) const CONSTANTS: &[$crate::table::Constant] = &[$($crate::table::Constant {
            name: stringify!($name),
            doc: concat!($($doc, "\n"),+),
            value: $crate::declare::value!($type, $name),
        }),+];
    };
}

/// A constant as a value of the table.
macro_rules! value {
    (f32, $name:ident) => {
        $crate::table::Value::Real($name)
    };
    ($integer:ident, $name:ident) => {
        $crate::table::Value::Integer($name as u64)
    };
}

pub(crate) use {constants, numbers, record, value};
