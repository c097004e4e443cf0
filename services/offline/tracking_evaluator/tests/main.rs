//! Trackers on made-up recordings with a known result.

mod kitti;
