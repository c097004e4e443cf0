//! Features, graphs and maps: golden vectors and properties.

mod golden;
mod properties;
