//! Motion models: golden vectors and properties.

mod golden;
mod properties;
