//! Readers: recordings as published, windows, and files that must be refused.

mod bad_input;
mod converters;
mod dialects;
mod frame_rates;
mod inspection;
mod kitti_files;
mod origins;
mod predictions;
mod python_bags;
mod recordings;
mod rosbags;
mod strangers;
mod sweeps;
mod windows;
