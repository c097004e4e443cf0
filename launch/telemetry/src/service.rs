//! Reports to systemd, if it has started this process as a service of `Type=notify`: ready, status, watchdog.

use std::collections::BTreeMap;
use std::io;
use std::time::{Duration, Instant};

use run::Run;
use rustix::process::{Resource, getrlimit};
use sd_notify::{NotifyState, notify, watchdog_enabled};
use wire::{Heartbeat, StageId};

use console::failure::Failure;
use supervisor::Outlet;

/// Most bytes of reports that wait for systemd.
const WAITING_MAX: usize = 4096;
/// Time for systemd to take the last report.
const END_LIMIT: Duration = Duration::from_millis(200);
/// Time until the next report for a service that waits. systemd then ends it.
const WAIT_LIMIT: Duration = Duration::from_secs(30);
/// Interval between reports of the status.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// The environment variable in which the unit repeats its limits, such as `LimitRTPRIO=50 LimitMEMLOCK=infinity`.
const LIMITS_VARIABLE: &str = "STGDAT_LIMITS";

/// The limits of the unit that systemd could not apply, which it does not report.
pub fn missed_limits() -> Vec<String> {
    let asked = std::env::var(LIMITS_VARIABLE).unwrap_or_default();
    asked
        .split_whitespace()
        .filter_map(|setting| missed(setting, |resource| getrlimit(resource).current))
        .collect()
}

/// A message about a limit, if it is less than the setting. `None` as a limit is infinity.
fn missed(setting: &str, limit: impl Fn(Resource) -> Option<u64>) -> Option<String> {
    let (name, asked) = setting.split_once('=')?;
    let found = limit(match name {
        "LimitRTPRIO" => Resource::Rtprio,
        "LimitMEMLOCK" => Resource::Memlock,
        "LimitNOFILE" => Resource::Nofile,
        _ => return None,
    })?;
    let is_met = asked.parse().is_ok_and(|asked: u64| found >= asked);
    (!is_met).then(|| format!("systemd could not apply {setting}: the limit is {found}"))
}

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Its stages start.
    Starting,
    /// Its stages wait for the detector.
    Waiting,
    /// The first tick has passed all stages.
    Ready,
}

/// The reports of a run to systemd.
#[derive(Debug)]
pub struct Service {
    /// When each built-in stage was last heard.
    heard: BTreeMap<StageId, Instant>,
    /// The service's `WatchdogSec`.
    watchdog: Option<Duration>,
    is_ready: bool,
    reported: Instant,
    reports: Outlet,
}

/// Sends each piece as one report. It waits while systemd does not read.
struct Systemd;

impl io::Write for Systemd {
    fn write(&mut self, report: &[u8]) -> io::Result<usize> {
        // systemd may be restarting; the next report follows.
        let _ = notify(&[NotifyState::Custom(&String::from_utf8_lossy(report))]);
        Ok(report.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Service {
    /// Creates the reports if systemd waits for them.
    ///
    /// # Errors
    /// [`Failure::Unavailable`] if their thread can't be started.
    pub fn of_environment(run: &Run, now: Instant) -> Result<Option<Self>, Failure> {
        if std::env::var_os("NOTIFY_SOCKET").is_none() {
            return Ok(None);
        }
        let reports = Outlet::open("systemd", WAITING_MAX, Systemd).map_err(Failure::unavailable)?;
        let built_in = run.stages.iter().filter(|stage| stage.built_in);
        let stages = built_in.filter_map(|stage| StageId::from_number(stage.stage));
        let heard = stages.map(|stage| (stage, now)).collect();
        Ok(Some(Self { heard, watchdog: watchdog_enabled(), is_ready: false, reported: now, reports }))
    }

    /// Reports that the run is ready once the first tick has passed all stages. Then reports its status each
    /// second, and feeds the watchdog while the heartbeats of all stages advance. While the run waits for the
    /// detector, the time limit of the start moves on.
    pub fn tend(
        &mut self,
        heartbeats: &[Heartbeat],
        phase: Phase,
        status: impl FnOnce() -> String,
        now: Instant,
    ) {
        for stage in heartbeats.iter().filter_map(|heartbeat| StageId::from_number(heartbeat.stage)) {
            self.heard.entry(stage).and_modify(|heard| *heard = now);
        }
        let interval = self.watchdog.map_or(STATUS_INTERVAL, |watchdog| STATUS_INTERVAL.min(watchdog / 4));
        let becomes_ready = phase == Phase::Ready && !self.is_ready;
        let is_due = becomes_ready || now.duration_since(self.reported) >= interval;
        if phase == Phase::Starting || !is_due {
            return;
        }
        self.is_ready |= becomes_ready;
        self.reported = now;
        let mut report = format!("STATUS={}", status());
        if !self.is_ready {
            report += &format!("\nEXTEND_TIMEOUT_USEC={}", WAIT_LIMIT.as_micros());
        }
        if becomes_ready {
            report += "\nREADY=1";
        }
        if self.is_alive(now) {
            report += "\nWATCHDOG=1";
        }
        self.reports.push(None, report.into());
    }

    /// Whether every stage was heard within half of the watchdog's time.
    fn is_alive(&self, now: Instant) -> bool {
        let Some(watchdog) = self.watchdog else { return false };
        self.heard.values().all(|&heard| now.duration_since(heard) < watchdog / 2)
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.reports.push(None, b"STOPPING=1".to_vec());
        self.reports.flush(END_LIMIT);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_watchdog_is_fed_while_every_stage_is_heard() {
        let begun = Instant::now();
        let at = |ms| begun + Duration::from_millis(ms);
        let heard = [StageId::Decoder, StageId::Sampler].map(|stage| (stage, begun)).into();
        let watchdog = Some(Duration::from_secs(2));
        let reports = Outlet::open("test", WAITING_MAX, io::sink()).unwrap();
        let mut service = Service { heard, watchdog, is_ready: true, reported: begun, reports };
        let beat = |stage: StageId| Heartbeat { stage: stage.number(), ..bytemuck::Zeroable::zeroed() };
        service.tend(&[beat(StageId::Decoder)], Phase::Ready, String::new, at(900));
        assert!(service.is_alive(at(999)) && !service.is_alive(at(1_000)), "the sampler is silent");
        service.tend(&[beat(StageId::Sampler), beat(StageId::Source)], Phase::Ready, String::new, at(1_500));
        assert!(service.is_alive(at(1_800)) && !service.is_alive(at(1_900)), "the decoder is silent");
        service.watchdog = None;
        assert!(!service.is_alive(at(1_500)), "nobody waits for it");
    }

    #[test]
    fn limits_that_are_lower_than_the_units_are_named() {
        let missed = |setting, limit| super::missed(setting, |_| limit);
        assert_eq!(
            missed("LimitMEMLOCK=infinity", Some(8_388_608)).as_deref(),
            Some("systemd could not apply LimitMEMLOCK=infinity: the limit is 8388608")
        );
        assert!(missed("LimitRTPRIO=50", Some(0)).is_some_and(|text| text.ends_with("the limit is 0")));
        for (setting, limit) in
            [("LimitRTPRIO=50", Some(50)), ("LimitRTPRIO=50", None), ("LimitMEMLOCK=infinity", None)]
        {
            assert_eq!(missed(setting, limit), None, "{setting} {limit:?}");
        }
    }
}
