//! A run as the messages of other tools: Autoware's ROS 2 messages in CDR, and Foxglove's in protobuf.
//!
//! [`messages`] declares the ROS messages. A declaration gives the struct, its [`cdr`] writer and reader, and
//! its [`Definition`] with the schema text and the type hash. [`autoware`], [`markers`] and [`foxglove`] fill
//! messages from a [`wire::tick_view::TickView`]. [`Views`] adds them to a recording.
//!
//! Sources: `autoware_msgs` 1.12.0, `common_interfaces` of ROS 2, OMG's CDR (formal/2002-06-51, §15.3), REP-2016
//! for the type hash, and the messages of Foxglove's SDK 0.30.3.

pub mod autoware;
pub mod cdr;
mod definition;
pub mod foxglove;
pub mod markers;
pub mod messages;
#[cfg(test)]
mod tests;
mod views;

pub use definition::{Definition, Primitive, Type};
pub use views::{GRID_TOPIC, Target, ViewOptions, Views, views};
