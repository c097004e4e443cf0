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

use std::process::ExitCode;

use clap::Parser;
use run::Exit;

use arguments::Arguments;

/// Events that are logged by default: also that a client is too slow.
const LOG: &str = "warn,foxglove::websocket::connected_client::send_lossy=info";

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
