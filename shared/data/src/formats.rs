//! The file formats. Each has one module, which defines the columns and units of a row and turns bytes into a
//! recording.

pub mod commonroad;
pub mod csv;
pub mod highd;
pub mod interaction;
pub mod kitti;
pub mod levelx;
pub mod obsmat;
pub mod positions;
pub mod rosbag;
pub mod sdd_raw;
pub mod vci_dut;
