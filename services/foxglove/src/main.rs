//! `stgdat-foxglove` serves a running pipeline on Foxglove's websocket, with the subprotocol
//! `foxglove.sdk.v1`.
//!
//! `stgdat view --foxglove` finds the run and starts this program. The messages are those of a recording made
//! with `--for foxglove`: [`interop::views`] builds both. The program reads the run's tap only while a client
//! subscribes to a channel.
//!
//! A client that reads slowly delays nobody. The server keeps [`BACKLOG`] messages for each client and
//! discards the oldest. Frames that this program itself did not receive from the tap are counted and reported
//! to the clients.

mod arguments;
mod live;

use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser;
use ports::LogFormat;
use run::Exit;

use arguments::Arguments;

/// Events that are logged by default: also that a client is too slow.
const LOG: &str = "warn,foxglove::websocket::connected_client::send_lossy=info";

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    ports::begin_command_logging(LogFormat::of_environment(), LOG, std::io::stderr);
    match live::serve(&arguments) {
        Ok(()) => Exit::Done.into(),
        Err(error) => {
            // Standard error may have no reader.
            let _ = writeln!(std::io::stderr(), "error: {}", ports::escaped(&error.to_string(), false));
            Exit::Unavailable.into()
        }
    }
}
