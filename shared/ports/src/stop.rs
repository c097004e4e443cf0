#![expect(unsafe_code, reason = "the mask of signals, which neither rustix nor signal-hook knows; a handler")]

use std::mem::MaybeUninit;
use std::sync::atomic::{AtomicBool, AtomicI32, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use iceoryx2::prelude::*;
use run::Exit;
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGUSR1};

/// Signals that ask a process to end even if it was started with them ignored.
const ALWAYS: [i32; 2] = [SIGTERM, SIGINT];
/// Signals that ask a process to end, unless it was started with them ignored, as by `nohup`.
const UNLESS_IGNORED: [i32; 2] = [SIGHUP, SIGQUIT];

/// Whether SIGTERM, SIGINT, SIGHUP or SIGQUIT has asked the process to end.
///
/// The flag stays set: a signal between two checks, or before another signal, is not lost. Signals from
/// before [`Stop::on_signals`] do not count.
#[derive(Clone, Debug)]
pub struct Stop {
    /// [`SIGNALS`] when this value was made.
    before: usize,
}

/// Number of signals so far that ask the process to end.
static SIGNALS: AtomicUsize = AtomicUsize::new(0);
/// The newest of these signals.
static NEWEST: AtomicI32 = AtomicI32::new(0);

impl Stop {
    /// Installs the signal handlers. The first call in a process does; later calls use them too.
    ///
    /// # Errors
    /// If the system refuses the handlers.
    pub fn on_signals() -> std::io::Result<Self> {
        static IS_INSTALLED: Mutex<bool> = Mutex::new(false);
        let mut is_installed = IS_INSTALLED.lock().unwrap_or_else(PoisonError::into_inner);
        if !*is_installed {
            install()?;
            *is_installed = true;
        }
        Ok(Self { before: SIGNALS.load(Ordering::Acquire) })
    }

    /// Whether the process has been asked to end.
    #[must_use]
    pub fn requested(&self) -> bool {
        self.exit().is_some()
    }

    /// The exit code of a process that was asked to end.
    #[must_use]
    pub fn exit(&self) -> Option<Exit> {
        if SIGNALS.load(Ordering::Acquire) == self.before {
            return None;
        }
        match NEWEST.load(Ordering::Relaxed) {
            SIGHUP => Some(Exit::HungUp),
            SIGINT => Some(Exit::Interrupted),
            SIGQUIT => Some(Exit::Quit),
            SIGTERM => Some(Exit::Terminated),
            _ => None,
        }
    }
}

/// Installs the handlers of the signals that ask the process to end.
fn install() -> std::io::Result<()> {
    static IGNORED: OnceLock<Vec<i32>> = OnceLock::new();
    let _held_back = HeldBack::begin();
    // Read before the transport sets its own handlers.
    let ignored =
        IGNORED.get_or_init(|| UNLESS_IGNORED.into_iter().filter(|number| is_ignored(*number)).collect());
    take_transport_handlers();
    for number in ALWAYS.into_iter().chain(UNLESS_IGNORED) {
        if ignored.contains(&number) {
            ignore(number);
            continue;
        }
        let arrived = move || {
            NEWEST.store(number, Ordering::Relaxed);
            SIGNALS.fetch_add(1, Ordering::Release);
        };
        // SAFETY: the handler only accesses atomics, which a signal handler may do.
        unsafe { signal_hook::low_level::register(number, arrived)? };
    }
    Ok(())
}

/// Whether SIGUSR1 has arrived.
#[derive(Clone, Debug)]
pub struct Asked(Arc<AtomicBool>);

impl Asked {
    /// Installs the handler of SIGUSR1.
    ///
    /// # Errors
    /// If the system refuses the handler.
    pub fn by_usr1() -> std::io::Result<Self> {
        let _held_back = HeldBack::begin();
        take_transport_handlers();
        let asked = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(SIGUSR1, asked.clone())?;
        Ok(Self(asked))
    }

    /// Whether the signal has arrived since the last call.
    #[must_use]
    pub fn take(&self) -> bool {
        self.0.swap(false, Ordering::Relaxed)
    }
}

/// Blocks signals while it lives: a signal that arrives while the handlers are exchanged would be lost.
struct HeldBack {
    /// The previous signal mask of this thread.
    before: libc::sigset_t,
}

impl HeldBack {
    fn begin() -> Self {
        let (mut held, mut before) = (MaybeUninit::uninit(), MaybeUninit::zeroed());
        // SAFETY: the first call initialises the set, and the others read and write only these two sets. They
        // fail only for an invalid number of a signal or an operation; these numbers are valid.
        unsafe {
            libc::sigemptyset(held.as_mut_ptr());
            for number in ALWAYS.into_iter().chain(UNLESS_IGNORED).chain([SIGUSR1]) {
                libc::sigaddset(held.as_mut_ptr(), number);
            }
            libc::pthread_sigmask(libc::SIG_BLOCK, held.as_ptr(), before.as_mut_ptr());
            Self { before: before.assume_init() }
        }
    }
}

impl Drop for HeldBack {
    fn drop(&mut self) {
        // SAFETY: the call only reads the set, and accepts a null pointer for the old one.
        unsafe { libc::pthread_sigmask(libc::SIG_SETMASK, &raw const self.before, std::ptr::null_mut()) };
    }
}

/// Whether the process ignores a signal.
fn is_ignored(number: i32) -> bool {
    let mut action = MaybeUninit::<libc::sigaction>::zeroed();
    // SAFETY: the call reads no new action and writes the current one; zeros are a valid action.
    let action = unsafe {
        libc::sigaction(number, std::ptr::null(), action.as_mut_ptr());
        action.assume_init()
    };
    action.sa_sigaction == libc::SIG_IGN
}

/// Ignores a signal.
fn ignore(number: i32) {
    // SAFETY: no handler is installed; the number is that of a signal which can be ignored.
    unsafe { libc::signal(number, libc::SIG_IGN) };
}

/// The transport replaces all handlers by its own when it first checks for a signal. This function makes it
/// do so before our handlers are registered. Ours then call the transport's handlers and stay.
fn take_transport_handlers() {
    set_log_level(LogLevel::Error);
    if let Ok(nothing_attached) = WaitSetBuilder::new().create::<ipc::Service>() {
        // Checks for a signal, then returns an error because nothing is attached.
        let _ = nothing_attached
            .wait_and_process_once_with_timeout(|_| CallbackProgression::Continue, Duration::ZERO);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_that_was_ignored_stays_ignored() {
        ignore(SIGHUP);
        assert!(is_ignored(SIGHUP));
        let stop = Stop::on_signals().unwrap();
        signal_hook::low_level::raise(SIGHUP).unwrap();
        assert!(!stop.requested() && is_ignored(SIGHUP));
        signal_hook::low_level::raise(SIGQUIT).unwrap();
        assert_eq!(stop.exit(), Some(Exit::Quit));
        assert!(!Stop::on_signals().unwrap().requested(), "a later one begins without it");
        assert_eq!(stop.clone().exit(), Some(Exit::Quit));
    }

    #[test]
    fn the_handlers_are_registered_once() {
        // The identifiers of actions count all registrations of the process.
        let registrations = || {
            let added = signal_hook::flag::register(SIGUSR1, Arc::new(AtomicBool::new(false))).unwrap();
            let text = format!("{added:?}");
            let digits = |text: &str| text.trim_end_matches(|c: char| !c.is_ascii_digit()).to_owned();
            let text = digits(&text);
            text.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap().parse::<u64>().unwrap()
        };
        let before = registrations();
        for _ in 0..100 {
            Stop::on_signals().unwrap();
        }
        let after = registrations();
        assert!(after - before < 50, "{before} to {after}");
    }

    #[test]
    fn a_signal_that_is_held_back_comes_afterwards() {
        let asked = Asked::by_usr1().unwrap();
        let held_back = HeldBack::begin();
        signal_hook::low_level::raise(SIGUSR1).unwrap();
        assert!(!asked.take());
        drop(held_back);
        assert!(asked.take());
    }
}
