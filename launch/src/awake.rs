//! Processors that do not sleep between ticks.

use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;

/// The kernel's file for the maximum wake-up latency of a processor, in µs. The request holds while the file
/// is open.
pub const LATENCY: &str = "/dev/cpu_dma_latency";

/// Keeps all processors of the machine awake.
#[derive(Debug)]
pub struct Awake(#[expect(dead_code, reason = "it is held open")] File);

impl Awake {
    /// Keeps the processors out of idle states with a wake-up latency while the value lives. See the kernel's
    /// "PM Quality of Service".
    ///
    /// # Errors
    /// A message that names the missing permission and how to grant it.
    pub fn hold() -> Result<Self, String> {
        Self::hold_at(Path::new(LATENCY)).map_err(|error| {
            format!("processors may sleep between ticks, `awake` needs write access to {LATENCY}: {error}")
        })
    }

    fn hold_at(path: &Path) -> io::Result<Self> {
        let mut file = File::options().write(true).open(path)?;
        let longest_us = 0_i32;
        file.write_all(&longest_us.to_ne_bytes())?;
        Ok(Self(file))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_is_told_a_number_of_four_bytes_and_nothing_where_it_has_no_such_file() {
        let path = std::env::temp_dir().join(format!("stgdat-latency-{}", std::process::id()));
        let missing = Awake::hold_at(&path).unwrap_err();
        assert_eq!(missing.kind(), io::ErrorKind::NotFound);
        assert!(!path.exists(), "no file is made");
        std::fs::write(&path, "").unwrap();
        let held = Awake::hold_at(&path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), [0; 4]);
        drop(held);
        std::fs::remove_file(&path).unwrap();
    }
}
