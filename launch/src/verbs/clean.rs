use clap::Args;
use run::Exit;

use console::failure::Failure;
use console::say;

/// Arguments of `stgdat clean`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Print the files, but do not remove them
    #[arg(long)]
    dry_run: bool,
}

/// Removes the files of runs whose launcher is gone. Living runs are not touched.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let leftovers = ports::leftovers().map_err(Failure::unavailable)?;
    let verb = if arguments.dry_run { "would remove" } else { "removed" };
    for leftover in leftovers {
        let run = leftover.name.clone();
        let (file_count, kib) = (leftover.file_count, leftover.bytes >> 10);
        if !arguments.dry_run {
            leftover.remove();
        }
        say!("{verb} {run}: {file_count} files in shared memory, {kib} KiB");
    }
    Ok(Exit::Done)
}
