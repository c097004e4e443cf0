use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use config::Exit;
use signal_hook::consts::{SIGINT, SIGTERM};

/// Whether SIGTERM or SIGINT has asked the process to end.
///
/// The flag stays set: a signal that comes between two looks, or before another one, is not lost.
#[derive(Clone, Debug)]
pub struct Stop(Arc<AtomicUsize>);

impl Stop {
    /// Takes over SIGTERM and SIGINT, after handlers that are there already.
    ///
    /// # Errors
    /// Where the system refuses the handlers.
    pub fn on_signals() -> std::io::Result<Self> {
        let signal = Arc::new(AtomicUsize::new(0));
        for number in [SIGTERM, SIGINT] {
            signal_hook::flag::register_usize(number, signal.clone(), number as usize)?;
        }
        Ok(Self(signal))
    }

    /// Whether the process has been asked to end.
    #[must_use]
    pub fn requested(&self) -> bool {
        self.exit().is_some()
    }

    /// The exit code of a process that was asked to end.
    #[must_use]
    pub fn exit(&self) -> Option<Exit> {
        match self.0.load(Ordering::Relaxed) as i32 {
            SIGINT => Some(Exit::Interrupted),
            SIGTERM => Some(Exit::Terminated),
            _ => None,
        }
    }
}
