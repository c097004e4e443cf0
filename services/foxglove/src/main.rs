//! `stgdat-foxglove` serves a running pipeline on Foxglove's websocket, with the subprotocol `foxglove.sdk.v1`.
//!
//! `stgdat view --foxglove` finds the run and starts this program. The messages are those of a recording made
//! with `--for foxglove`: [`interop::views`] builds both. The program reads the run's tap only while a client
//! subscribes to a channel.
//!
//! A client that reads slowly delays nobody. The server keeps [`BACKLOG`] messages for each client and discards
//! the oldest. Frames that this program itself did not receive from the tap are counted and reported to the
//! clients.

mod live;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use run::Exit;

/// Events that are logged by default: also that a client is too slow.
const LOG: &str = "warn,foxglove::websocket::connected_client::send_lossy=info";

/// Serves a run on Foxglove's websocket until the run ends. `stgdat view --foxglove` starts this program.
#[derive(Debug, Parser)]
#[command(name = "stgdat-foxglove", version)]
struct Arguments {
    /// Folder of the run
    #[arg(long, value_name = "DIR")]
    run: PathBuf,
    /// Serve on this address; by default on port 8765 of the loopback interface, or on a free port
    #[arg(long, value_name = "ADDRESS")]
    address: Option<SocketAddr>,
    /// Paths of each agent, the most probable first
    #[arg(long, value_name = "N", default_value_t = 3)]
    paths: u16,
    /// The fixed context map of the run
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = tracing_subscriber::EnvFilter::try_from_default_env();
    let filter = filter.unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(LOG));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    match live::serve(&arguments) {
        Ok(()) => Exit::Done.into(),
        Err(error) => {
            let _ = std::io::Write::write_fmt(&mut std::io::stderr(), format_args!("error: {error}\n"));
            Exit::Unavailable.into()
        }
    }
}
