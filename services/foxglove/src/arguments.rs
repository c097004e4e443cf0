use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Parser;

/// Serves a run on Foxglove's websocket until the run ends. `stgdat view --foxglove` starts this program.
#[derive(Debug, Parser)]
#[command(name = "stgdat-foxglove", version)]
pub struct Arguments {
    /// Folder of the run
    #[arg(long, value_name = "DIR")]
    pub run: PathBuf,
    /// Serve on this address; by default on port 8765 of the loopback interface, or on a free port
    #[arg(long, value_name = "ADDRESS")]
    pub address: Option<SocketAddr>,
    /// Paths of each agent, the most probable first
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub paths: u16,
    /// The fixed context map of the run
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
}
