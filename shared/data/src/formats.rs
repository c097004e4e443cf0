//! The formats: one module each, which says what a row means and turns bytes into a recording.

pub mod csv;
pub mod interaction;
pub mod kitti;
pub mod obsmat;
pub mod positions;
pub mod sdd_raw;
pub mod vci_dut;
