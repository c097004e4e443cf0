//! Motion models: golden vectors and properties.

mod elementary;
mod golden;
mod properties;
