//! Tests that concern several modules, and what the modules' own tests share.

mod agreement;
pub(crate) mod check;
pub(crate) mod golden;
pub(crate) mod recordings;
