//! The compute stages in one process. They run the same [steps](ports::Step) with the same settings as in a
//! run of processes, so that forecasts are equal to the bit.
//!
//! The input consists of wire payloads (detections or tracks, tick by tick). The output consists of tracks,
//! controls and forecasts.
//!
//! * [`Graph`] joins stages by the topics of their declarations. A tick of it takes frames from input to output.
//! * [`Chain`] is the graph of all compute stages: `stgdat predict`, `track` and `bench` run it.
//! * [`Replay`] takes a recording through the same graph.
//!
//! Evaluations join some of the stages. Localiser and extractor depend on earlier ticks. Encoder and decoder
//! depend only on their tick, so evaluations spread ticks over threads.

mod chain;
mod error;
mod frame;
mod graph;
mod load;
mod replay;
mod stages;

pub use chain::{Chain, STAGES, open_all};
pub use error::ChainError;
pub use frame::OwnFrame;
pub use graph::{Graph, Node, node};
pub use load::Load;
pub use replay::{OwnTime, Replay, ReplayError, Replayed};
pub use stages::Stages;
