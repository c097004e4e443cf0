//! The payload types of `wire` as iceoryx2 types: `wire` itself does not depend on the transport.
#![expect(unsafe_code, reason = "iceoryx2's marker trait for types that may cross process borders is unsafe")]

use std::fmt;

use iceoryx2::prelude::ZeroCopySend;
use wire::{Header, Topic};

/// The type of the elements of a topic's payload, for the transport's details of the type.
#[repr(transparent)]
pub(crate) struct Element<T: Topic>(T::Element);

// SAFETY: `Pod` elements have no pointers, references or padding, are `repr(C)`, and any bit pattern is a
// value.
unsafe impl<T: Topic> ZeroCopySend for Element<T> {
    // SAFETY: the name carries the layout's version; a change of layout changes the name.
    unsafe fn type_name() -> &'static str {
        T::TYPE_NAME
    }
}

impl<T: Topic> fmt::Debug for Element<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// The header of a frame as iceoryx2's user header.
#[derive(Clone, Copy, Debug)]
#[repr(transparent)]
pub(crate) struct Head(pub Header);

// SAFETY: `Header` is `Pod` and `repr(C)`: no pointers, references or padding.
unsafe impl ZeroCopySend for Head {
    // SAFETY: the name carries the layout's version; a change of layout changes the name.
    unsafe fn type_name() -> &'static str {
        Header::TYPE_NAME
    }
}

impl Default for Head {
    fn default() -> Self {
        Self(bytemuck::Zeroable::zeroed())
    }
}
