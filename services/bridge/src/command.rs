//! The command line of `stgdat bridge`.

use std::path::PathBuf;

use clap::{Parser, Subcommand, ValueEnum};
use wire::{AGENTS_MAX, WorldOrigin};

use crate::frame::Kind;
use crate::options::{Ages, Protection, modes};
use crate::socket::Address;

/// Connect two boxes: send forecasts, receive forecasts or detections (stgdat-bridge).
///
/// In pipeline.toml the program is a stage instead: in place of the source it takes detections from another
/// box, and as an added stage it sends forecasts.
#[derive(Debug, Parser)]
#[command(name = "stgdat bridge")]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

/// The verbs of `stgdat bridge`.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Send the forecasts of a running pipeline to the boxes that connect
    Send {
        /// Where to listen: an address and a port, or the path of a Unix socket
        #[arg(value_name = "ADDRESS")]
        address: Address,
        /// Name or folder of the run; not needed if only one is running
        #[arg(long, value_name = "RUN")]
        run: Option<PathBuf>,
        /// Modes of each agent besides the single best path, from 3 to 5
        #[arg(long, value_name = "N", default_value_t = 3, value_parser = modes)]
        modes: usize,
        /// The key and the time limit.
        #[command(flatten)]
        protection: Protection,
    },
    /// Connect to another box, and print each frame as a line of JSON
    Receive {
        /// Where the other box listens: an address and a port, or the path of a Unix socket
        #[arg(value_name = "ADDRESS")]
        address: Address,
        /// What the other box sends
        #[arg(long, value_enum, value_name = "KIND", default_value_t = Content::Forecasts)]
        content: Content,
        /// End after this number of frames
        #[arg(long, value_name = "N")]
        frames: Option<u64>,
        /// The key and the time limit.
        #[command(flatten)]
        protection: Protection,
        /// Ages.
        #[command(flatten)]
        ages: Ages,
    },
    /// Send the detections of a recording or of a generated scene, as the detector of another box would
    Play {
        /// Where to listen: an address and a port, or the path of a Unix socket
        #[arg(value_name = "ADDRESS")]
        address: Address,
        /// The recording; without one an intersection is generated
        #[arg(value_name = "RECORDING")]
        recording: Option<PathBuf>,
        /// Agents of the generated intersection
        #[arg(long, value_name = "N", default_value_t = 32, value_parser = agents)]
        agents: usize,
        /// End after this number of ticks
        #[arg(long, value_name = "N")]
        ticks: Option<u64>,
        /// Origin of the world frame in the recording's own frame, m
        #[arg(long, value_name = "X,Y", default_value_t = WorldOrigin::default())]
        origin: WorldOrigin,
        /// The key and the time limit.
        #[command(flatten)]
        protection: Protection,
    },
}

/// Frames that can be received.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Content {
    /// Forecasts of a run
    Forecasts,
    /// Detections of a sensor
    Detections,
}

impl From<Content> for Kind {
    fn from(content: Content) -> Self {
        match content {
            Content::Forecasts => Self::Forecasts,
            Content::Detections => Self::Detections,
        }
    }
}

fn agents(text: &str) -> Result<usize, String> {
    let number = text.parse().ok().filter(|number| (1..=AGENTS_MAX).contains(number));
    number.ok_or_else(|| format!("expected 1 to {AGENTS_MAX}"))
}
