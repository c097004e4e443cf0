//! Starts of processes within a time limit.
//!
//! The kernel reads the program's file during the start. On a file system that does not answer, this takes any
//! time, and the process that starts the program waits. So another thread starts it.
//!
//! A process that dies with the launcher dies with the *thread* that has started it. So this thread lives as long
//! as the launcher, even after a start that took too long.

use std::io::{self, ErrorKind};
use std::process::{Child as Process, Command};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Time limit of a start. Most take a millisecond, on a loaded machine a hundred times as long.
pub const LIMIT: Duration = Duration::from_secs(1);
/// Most threads that may wait for a start.
const STUCK_MAX: usize = 8;

/// A command, and the recipient of its process.
type Order = (Command, SyncSender<io::Result<Process>>);

/// The thread that starts processes.
#[derive(Debug)]
struct Starter {
    orders: Option<SyncSender<Order>>,
    /// Number of threads that were given up on.
    stuck: usize,
}

static STARTER: Mutex<Starter> = Mutex::new(Starter { orders: None, stuck: 0 });

/// Starts a process.
///
/// # Errors
/// The system's error; [`ErrorKind::TimedOut`] if the start takes longer than 1 s. The process is then
/// killed as soon as it is there.
pub fn spawn(command: Command) -> io::Result<Process> {
    spawn_within(command, LIMIT)
}

fn spawn_within(command: Command, limit: Duration) -> io::Result<Process> {
    let mut starter = STARTER.lock().unwrap_or_else(PoisonError::into_inner);
    let timed_out = || {
        let text = format!("it could not be started within {} s", limit.as_secs_f64());
        io::Error::new(ErrorKind::TimedOut, text)
    };
    let orders = match &starter.orders {
        Some(orders) => orders.clone(),
        None if starter.stuck == STUCK_MAX => return Err(timed_out()),
        None => {
            let (sender, orders) = sync_channel::<Order>(1);
            std::thread::Builder::new().name("starter".to_owned()).spawn(move || {
                for (mut command, recipient) in orders {
                    if let Err(unwanted) = recipient.send(command.spawn())
                        && let Ok(mut process) = unwanted.0
                    {
                        let _ = process.kill();
                        let _ = process.wait();
                    }
                }
                // Its processes would die with it.
                loop {
                    std::thread::park();
                }
            })?;
            starter.orders.insert(sender).clone()
        }
    };
    let (recipient, started) = sync_channel(0);
    if orders.send((command, recipient)).is_err() {
        starter.orders = None;
        return Err(io::Error::other("the thread that starts processes has ended"));
    }
    match started.recv_timeout(limit) {
        Ok(process) => process,
        Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
            starter.orders = None;
            starter.stuck += 1;
            Err(timed_out())
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::CommandExt as _;
    use std::time::Instant;

    use super::*;

    #[test]
    fn a_start_that_hangs_has_a_limit_and_the_next_one_works() {
        let mut earlier = Command::new("sleep");
        earlier.arg("60");
        crate::child::die_with_this_process(&mut earlier);
        let mut earlier = spawn(earlier).unwrap();
        let mut hung = Command::new("true");
        // As a program on a file system that does not answer.
        #[expect(unsafe_code, reason = "the closure only sleeps")]
        // SAFETY: between fork and exec the closure touches no memory of this process.
        unsafe {
            hung.pre_exec(|| {
                std::thread::sleep(Duration::from_secs(2));
                Ok(())
            });
        }
        let begun = Instant::now();
        let error = spawn_within(hung, Duration::from_millis(100)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
        assert!(begun.elapsed() < Duration::from_secs(2));
        assert!(spawn(Command::new("true")).unwrap().wait().unwrap().success());
        // The thread of the hung start has come back, and has not ended.
        std::thread::sleep(Duration::from_millis(2_500).saturating_sub(begun.elapsed()));
        assert!(earlier.try_wait().unwrap().is_none(), "the earlier process lives");
        earlier.kill().unwrap();
        earlier.wait().unwrap();
        assert_eq!(spawn(Command::new("/no/such/program")).unwrap_err().kind(), ErrorKind::NotFound);
    }
}
