use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use iceoryx2::prelude::*;
use run::Exit;
use signal_hook::consts::{SIGINT, SIGTERM, SIGUSR1};

/// Whether SIGTERM or SIGINT has asked the process to end.
///
/// The flag stays set: a signal between two checks, or before another signal, is not lost.
#[derive(Clone, Debug)]
pub struct Stop(Arc<AtomicUsize>);

impl Stop {
    /// Takes over SIGTERM and SIGINT.
    ///
    /// # Errors
    /// Where the system refuses the handlers.
    pub fn on_signals() -> std::io::Result<Self> {
        take_transport_handlers();
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

/// Whether SIGUSR1 has asked for something.
#[derive(Clone, Debug)]
pub struct Asked(Arc<AtomicBool>);

impl Asked {
    /// Takes over SIGUSR1.
    ///
    /// # Errors
    /// Where the system refuses the handler.
    pub fn by_usr1() -> std::io::Result<Self> {
        take_transport_handlers();
        let asked = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(SIGUSR1, asked.clone())?;
        Ok(Self(asked))
    }

    /// Whether the signal has come since this was last asked.
    #[must_use]
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }
}

/// The transport replaces all handlers by its own when it first looks for a signal. This makes it do so
/// before ours are registered, which then call the transport's and stay.
fn take_transport_handlers() {
    set_log_level(LogLevel::Error);
    if let Ok(nothing_attached) = WaitSetBuilder::new().create::<ipc::Service>() {
        // Looks for a signal, then returns an error because nothing is attached.
        let _ = nothing_attached
            .wait_and_process_once_with_timeout(|_| CallbackProgression::Continue, Duration::ZERO);
    }
}
