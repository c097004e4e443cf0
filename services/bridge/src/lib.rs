//! The bridge between two boxes: detections from another box in, forecasts to another box out, over TCP or a
//! Unix socket.
//!
//! A *link* is one connection. Its *sender* listens, and its *receiver* connects. The sender sends frames
//! ([`frame`]), and the receiver confirms each of them. At most a few frames are on their way. When there is
//! room for another one, the sender sends the newest, and skips all others. So a link that was slow or cut
//! never delivers a backlog.
//!
//! A pre-shared key authenticates both ends and every frame ([`auth`]).

pub mod auth;
pub mod command;
pub mod counts;
pub mod frame;
mod greeting;
pub mod lines;
pub mod options;
pub mod play;
pub mod publish;
pub mod receiver;
mod report;
pub mod sender;
pub mod socket;
pub mod source;
