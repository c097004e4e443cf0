//! Diagnoses a stage that sends no heartbeats: hung, stopped or starved.

use std::time::Duration;

use rustix::process::Pid;

/// Age of the last heartbeat after which a stage is checked: one and a half heartbeat intervals. A stopped
/// process is thus found within two ticks.
pub const SILENT: Duration = Duration::from_millis(120);

/// A process as the kernel reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// The process state: R, S, D, T, t, Z, …
    pub state: u8,
    /// CPU time used by all threads.
    pub cpu: Duration,
}

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finding {
    /// Nothing is wrong, or not for long enough.
    Well,
    /// A signal has stopped it.
    Stopped,
    /// It uses the CPU or sleeps, but sends no heartbeat.
    Hung,
    /// It gets no CPU time.
    Starved,
}

/// The observations of a process since its last sign of life.
#[derive(Clone, Copy, Debug)]
pub struct Health {
    /// Time of the last sign of life.
    sign: Duration,
    /// Whether this process has sent a heartbeat.
    beats: bool,
    /// The first check since the sign of life.
    first: Option<Look>,
    /// Time since which all checks found the process asleep without CPU use.
    asleep: Option<Duration>,
    starved: bool,
}

impl Health {
    /// Creates the state of a process that was just started.
    pub const fn new(now: Duration) -> Self {
        Self { sign: now, beats: false, first: None, asleep: None, starved: false }
    }

    /// Records a heartbeat.
    pub const fn beat(&mut self, now: Duration) {
        *self = Self { beats: true, ..Self::new(now) };
    }

    /// Resets the observations after the launcher itself was stopped, because it saw nothing in that time.
    pub const fn forgive(&mut self, now: Duration) {
        *self = Self { beats: self.beats, ..Self::new(now) };
    }

    /// Whether the process must be checked.
    pub fn is_silent(&self, now: Duration) -> bool {
        now.saturating_sub(self.sign) > SILENT
    }

    /// Judges a check of a silent process. Starvation is reported once per silence.
    pub fn judge(&mut self, look: Look, hang_after: Duration, now: Duration) -> Finding {
        if look.state == b'T' {
            return Finding::Stopped;
        }
        // Before its first heartbeat a stage loads its data, and the start limit applies. A debugger may stop
        // a process for any time.
        if !self.beats || look.state == b't' {
            return Finding::Well;
        }
        let first = *self.first.get_or_insert(look);
        let used = look.cpu.saturating_sub(first.cpu);
        self.asleep = match look.state {
            b'S' if used.is_zero() => self.asleep.or(Some(now)),
            _ => None,
        };
        let slept = self.asleep.map_or(Duration::ZERO, |since| now.saturating_sub(since));
        if used >= hang_after || slept >= hang_after {
            Finding::Hung
        } else if now.saturating_sub(self.sign) > SILENT + hang_after
            && !self.starved
            && self.asleep.is_none()
        {
            self.starved = true;
            Finding::Starved
        } else {
            Finding::Well
        }
    }
}

/// Checks a process; `None` if it is gone.
pub fn look(pid: Pid) -> Option<Look> {
    let stat = std::fs::read(format!("/proc/{}/stat", pid.as_raw_nonzero())).ok()?;
    parse(std::str::from_utf8(&stat).ok()?, rustix::param::clock_ticks_per_second())
}

/// Parses /proc/PID/stat. The state is the field after the name, which ends with the last ")". User and
/// system time are fields 14 and 15.
fn parse(stat: &str, ticks_per_second: u64) -> Option<Look> {
    let (_, rest) = stat.rsplit_once(") ")?;
    let fields: Vec<&str> = rest.split(' ').take(13).collect();
    let ticks: u64 = fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?;
    let cpu = Duration::from_millis(ticks * 1_000 / ticks_per_second.max(1));
    Some(Look { state: *fields.first()?.as_bytes().first()?, cpu })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HANG_AFTER: Duration = Duration::from_secs(1);

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn running(cpu_ms: u64) -> Look {
        Look { state: b'R', cpu: ms(cpu_ms) }
    }

    fn beating() -> Health {
        let mut health = Health::new(ms(0));
        health.beat(ms(0));
        health
    }

    #[test]
    fn a_stopped_process_is_found_at_the_first_look() {
        let mut health = beating();
        assert!(!health.is_silent(ms(100)) && health.is_silent(ms(130)));
        assert_eq!(health.judge(Look { state: b'T', cpu: ms(5) }, HANG_AFTER, ms(130)), Finding::Stopped);
        assert_eq!(
            Health::new(ms(0)).judge(Look { state: b'T', cpu: ms(5) }, HANG_AFTER, ms(130)),
            Finding::Stopped
        );
        assert_eq!(beating().judge(Look { state: b't', cpu: ms(5) }, HANG_AFTER, ms(9_000)), Finding::Well);
    }

    #[test]
    fn only_used_cpu_or_sleep_makes_a_process_hung() {
        let mut busy = beating();
        assert_eq!(busy.judge(running(100), HANG_AFTER, ms(130)), Finding::Well);
        assert_eq!(busy.judge(running(1_050), HANG_AFTER, ms(1_080)), Finding::Well);
        assert_eq!(busy.judge(running(1_100), HANG_AFTER, ms(1_130)), Finding::Hung);
        let mut asleep = beating();
        let sleeping = Look { state: b'S', cpu: ms(100) };
        assert_eq!(asleep.judge(sleeping, HANG_AFTER, ms(130)), Finding::Well);
        assert_eq!(asleep.judge(sleeping, HANG_AFTER, ms(1_130)), Finding::Hung);
    }

    #[test]
    fn without_cpu_it_is_starved_and_said_so_once() {
        let mut health = beating();
        let mut findings = Vec::new();
        for at in (130..20_000).step_by(50) {
            findings.push(health.judge(running(100 + at / 100), HANG_AFTER, ms(at)));
        }
        assert_eq!(findings.iter().filter(|&&finding| finding == Finding::Starved).count(), 1);
        assert!(!findings.contains(&Finding::Hung));
        health.beat(ms(20_000));
        assert!(!health.is_silent(ms(20_050)));
    }

    #[test]
    fn a_launcher_that_was_stopped_begins_anew() {
        let mut health = beating();
        assert_eq!(health.judge(running(0), HANG_AFTER, ms(130)), Finding::Well);
        health.forgive(ms(9_000));
        assert_eq!(health.judge(running(5_000), HANG_AFTER, ms(9_130)), Finding::Well);
    }

    #[test]
    fn a_stat_line_is_read_whatever_the_name() {
        let line = "12 (a ) R b) S 1 12 12 0 -1 4194560 100 0 0 0 250 50 0 0 20 0 3 0 100 1 1";
        assert_eq!(parse(line, 100), Some(Look { state: b'S', cpu: ms(3_000) }));
        assert_eq!(parse("", 100), None);
    }
}
