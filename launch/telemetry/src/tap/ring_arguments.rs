use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use clap::Args;
use recording::RingLimits;
use recording::flight::FlightLimits;

use console::failure::Failure;

/// Maximum duration of a ring. For longer durations, a recording is the right tool.
const SECONDS_MAX: f64 = 3_600.0;
/// Maximum memory of a ring, MiB.
const MEMORY_MAX: u64 = 65_536;
/// Maximum number of files of a flight recorder.
const FILES_MAX: u32 = 1_000;

/// How a flight recorder keeps and writes.
#[derive(Clone, Debug, Args)]
pub struct RingArguments {
    /// Flight recorder: keep the last TIME, such as 60s, in memory. Write it to FILE-1, FILE-2, … after an
    /// event: a degraded or late tick, a stage that dies or gets no CPU, `stgdat mark`, or SIGUSR1
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    last: Option<Duration>,
    /// Time to record after the event
    #[arg(long, value_name = "TIME", requires = "last", default_value = "5s", value_parser = seconds)]
    after: Duration,
    /// Maximum number of files
    #[arg(long, value_name = "N", requires = "last", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=i64::from(FILES_MAX)))]
    files: u32,
    /// Maximum memory for the last TIME, MiB
    #[arg(long, value_name = "MIB", requires = "last", default_value_t = 512, value_parser = clap::value_parser!(u64).range(1..=MEMORY_MAX))]
    ring_mib: u64,
    /// Maximum memory for earlier inputs of the stages, since the start of the run, MiB. With them, a replay
    /// of a file is equal from its first tick on; 0 keeps none
    #[arg(long, value_name = "MIB", requires = "last", default_value_t = 128, value_parser = clap::value_parser!(u64).range(0..=MEMORY_MAX))]
    before_mib: u64,
}

/// The limits of a flight recorder's memory and files.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// The ring.
    pub ring: RingLimits,
    /// Memory for messages before the event.
    pub before_bytes: usize,
    /// The files.
    pub flight: FlightLimits,
}

/// Parses a time: `60s` or `60`.
fn seconds(text: &str) -> Result<Duration, String> {
    let number: Option<f64> = text.strip_suffix('s').unwrap_or(text).trim().parse().ok();
    match number.filter(|seconds| (0.1..=SECONDS_MAX).contains(seconds)) {
        Some(seconds) => Ok(Duration::from_secs_f64(seconds)),
        None => Err(format!("expected seconds from 0.1 to {SECONDS_MAX}, as 60s")),
    }
}

impl RingArguments {
    /// Returns the limits; `None` if everything is written.
    pub fn limits(&self) -> Option<Limits> {
        let ring = RingLimits { span_ns: nanoseconds(self.last?), bytes: bytes(self.ring_mib) };
        let flight = FlightLimits { after_ns: nanoseconds(self.after), files: self.files };
        Some(Limits { ring, before_bytes: bytes(self.before_mib), flight })
    }

    /// Passes the same arguments to a recording in its own process.
    pub fn pass_on(&self, command: &mut Command) {
        let Some(last) = self.last else { return };
        command.arg("--last").arg(last.as_secs_f64().to_string());
        command.arg("--after").arg(self.after.as_secs_f64().to_string());
        command.arg("--files").arg(self.files.to_string()).arg("--ring-mib").arg(self.ring_mib.to_string());
        command.arg("--before-mib").arg(self.before_mib.to_string());
    }

    /// Checks that the file names are free.
    pub fn check(&self, path: &Path) -> Result<(), Failure> {
        let names = (1..=self.files).map(|number| numbered(path, number));
        match names.into_iter().find(|path| path.exists()) {
            Some(taken) => Err(Failure::data_about(
                taken.display(),
                "there is a file of that name, which is not replaced",
            )),
            None => Ok(()),
        }
    }

    /// Describes in one sentence the recorded data and its file.
    pub fn description(&self, path: &Path) -> String {
        let seconds = self.last.unwrap_or_default().as_secs_f64();
        let [first, last] = [1, self.files].map(|number| numbered(path, number).display().to_string());
        format!(
            "keeping the last {seconds} s in memory, at most {} MiB, and {} MiB of what was before; written when something happens to {first} … {last}; \
             kill -USR1 {} or stgdat mark asks for it",
            self.ring_mib,
            self.before_mib,
            std::process::id()
        )
    }
}

fn bytes(mebibytes: u64) -> usize {
    usize::try_from(mebibytes << 20).unwrap_or(usize::MAX)
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Returns the name of a file by its number: `drive.mcap` becomes `drive-1.mcap`.
pub fn numbered(path: &Path, number: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().unwrap_or("mcap".as_ref()).to_string_lossy();
    path.with_file_name(format!("{stem}-{number}.{extension}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_seconds_with_or_without_their_letter() {
        assert_eq!(seconds("60s"), Ok(Duration::from_mins(1)));
        assert_eq!(seconds("2.5"), Ok(Duration::from_millis(2_500)));
        for wrong in ["0", "-1s", "1m", "nan", "1e9", ""] {
            assert!(seconds(wrong).is_err(), "{wrong}");
        }
    }
}
