//! Tests of trackers on synthetic recordings with a known result.

mod kitti;
