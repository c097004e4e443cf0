//! The jitter of the pipeline beside a control process with the same wake-ups at the same moments.
//!
//! On a machine that others use, a time in milliseconds measures the others. This process therefore sleeps
//! until the same moments as the source of the run, in the normal class, and measures by how much it wakes up
//! late. The table has ratios to its times.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::Duration;

use configuration::pipeline_file::SHIPPED;
use console::failure::Failure;
use console::tables;
use ports::{Node, TemporaryFolder, monotonic_ns};
use recorder::Report;
use run::Run;
use wire::{ForecastsTopic, Header, StageId, Topic};

use super::percentile::percentile;
use super::{Arguments, pipeline_run};

/// Ticks in two seconds.
const RATE: u64 = 25;
/// Agents if none are given.
const AGENTS: u16 = 32;
/// Runs of each row. The rows alternate, because the load by others changes.
const ROUNDS: u64 = 3;
/// The first ticks, which fill caches, are not measured.
const WARM_UP: u64 = 25;
/// Programs for each processor that only use CPU time.
const HOGS: usize = 2;
/// Longest sleep of the follower.
const SLEEP: Duration = Duration::from_millis(20);
/// Pause before the run's files are looked for again.
const PAUSE: Duration = Duration::from_millis(5);

/// What is compared: the profile of `[realtime]`, and whether hogs run beside it.
const CELLS: [(bool, bool); 4] = [(false, false), (true, false), (false, true), (true, true)];

/// Times of one cell by tick, in ns: from the planned moment of a tick.
#[derive(Debug, Default)]
struct Times {
    /// To the release of the tick by the source.
    wake_ups: Vec<f64>,
    /// To the sending of its forecasts.
    end_to_ends: Vec<f64>,
    /// To the wake-up of the control process.
    controls: Vec<f64>,
}

impl Times {
    fn add(&mut self, Self { wake_ups, end_to_ends, controls }: Self) {
        self.wake_ups.extend(wake_ups);
        self.end_to_ends.extend(end_to_ends);
        self.controls.extend(controls);
    }
}

/// Measures all cells and returns the table.
pub(super) fn table(arguments: &Arguments) -> Result<String, Failure> {
    let mut text = tables::head(&[
        "agents:",
        "profile",
        "CPU hogs",
        "wake-up p50:",
        "p99:",
        "max:",
        "end to end p99 \u{2212} p50:",
        "max \u{2212} p50:",
    ]);
    let mut notes = Vec::new();
    let mut ticks = usize::MAX;
    for &agents in arguments.agents.as_deref().unwrap_or(&[AGENTS]) {
        let mut rows: [Times; CELLS.len()] = Default::default();
        for _ in 0..ROUNDS {
            for (times, (is_vehicle, has_hogs)) in rows.iter_mut().zip(CELLS) {
                let (measured, refused) = measure(arguments, agents, is_vehicle, has_hogs)?;
                times.add(measured);
                notes.extend(refused);
            }
        }
        for (times, (is_vehicle, has_hogs)) in rows.into_iter().zip(CELLS) {
            ticks = ticks.min(times.end_to_ends.len());
            let profile = if is_vehicle { "`vehicle`" } else { "" };
            let hogs = if has_hogs { "yes" } else { "" };
            let cells = [agents.to_string(), profile.to_owned(), hogs.to_owned()];
            text += &tables::row(cells.into_iter().chain(ratios(times)));
        }
    }
    notes.sort();
    notes.dedup();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    text += &format!(
        "\nTimes divided by the same times of the control process. At least {ticks} ticks in each row; hogs are {} \
         threads.\n",
        HOGS * cores
    );
    notes.iter().for_each(|note| text += &format!("\nNot allowed here: {note}.\n"));
    Ok(text)
}

/// Runs the pipeline once. Also returns the limits that the kernel refused.
fn measure(
    arguments: &Arguments,
    agents: u16,
    is_vehicle: bool,
    has_hogs: bool,
) -> Result<(Times, Vec<String>), Failure> {
    let unavailable = |error: std::io::Error| Failure::unavailable(error);
    let folder = TemporaryFolder::create("stgdat-bench-").map_err(unavailable)?;
    let path = |name: &str| folder.path().join(name);
    let profile = if is_vehicle { "[realtime]\nprofile = \"vehicle\"\n" } else { "" };
    std::fs::write(path("pipeline.toml"), format!("{profile}{SHIPPED}")).map_err(unavailable)?;
    let ticks = (arguments.seconds * RATE).div_ceil(2 * ROUNDS) + WARM_UP;
    let mut command = pipeline_run(arguments, agents, ticks, &path("report"));
    command.arg("--pipeline").arg(path("pipeline.toml")).arg("--announce").arg(path("run"));
    let hogs = has_hogs.then(Hogs::start);
    let mut launcher = command.spawn().map_err(unavailable)?;
    let times = loop {
        if let Ok(record) = std::fs::read_to_string(path("run")) {
            break follow(&Run::read(record.as_ref()).map_err(Failure::config)?, ticks);
        }
        if launcher.try_wait().map_err(unavailable)?.is_some() {
            break Ok(Times::default());
        }
        std::thread::sleep(PAUSE);
    };
    let status = launcher.wait().map_err(unavailable)?;
    drop(hogs);
    if !status.success() {
        return Err(Failure::Failed(format!("stgdat run: {status}")));
    }
    let report = Report::read(&path("report")).map_err(Failure::data)?;
    Ok((times?, report.supervision.notes))
}

/// Reads the forecasts of a run to its end, while another thread wakes up at the same moments.
fn follow(run: &Run, ticks: u64) -> Result<Times, Failure> {
    let control = {
        let run = run.clone();
        std::thread::spawn(move || control(&run, ticks))
    };
    let node = Node::open(run, "follower")?;
    let forecasts = node.subscriber::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX)?;
    let mut times = Times::default();
    while !node.stop().requested() && run.root.exists() {
        forecasts.sleep(SLEEP)?;
        while let Some(frame) = forecasts.receive()? {
            if let Some([wake_up, end_to_end]) = late_ns(frame.header(), run, source::start_ns(run)) {
                times.wake_ups.push(wake_up);
                times.end_to_ends.push(end_to_end);
            }
        }
    }
    // The launcher removes the run's files. Ports dropped after that would look for them.
    std::mem::forget((forecasts, node));
    times.controls =
        control.join().map_err(|_| Failure::Failed("the control process ended early".to_owned()))?;
    Ok(times)
}

/// Wake-up and end-to-end time of a tick since its planned moment; `None` for a tick that is not measured.
fn late_ns(header: &Header, run: &Run, start_ns: Option<u64>) -> Option<[f64; 2]> {
    let planned_ns = start_ns? + header.seq * run.interval_ns;
    let sent_ns = header.hop(StageId::Sampler)?.sent_ns;
    // A stall shifts the plan, so a tick before the shift has no known moment.
    let wake_up_ns = header.released_ns.checked_sub(planned_ns)?;
    let is_measured = header.is_tick() && header.seq >= WARM_UP && wake_up_ns <= run.interval_ns;
    is_measured.then(|| [wake_up_ns as f64, sent_ns.saturating_sub(planned_ns) as f64])
}

/// Sleeps until the planned moment of each tick, and returns by how much each wake-up was late, in ns.
fn control(run: &Run, ticks: u64) -> Vec<f64> {
    let mut late_ns = Vec::with_capacity(ticks as usize);
    let mut next = WARM_UP;
    while next < ticks && run.root.exists() {
        let Some(start_ns) = source::start_ns(run) else {
            std::thread::sleep(PAUSE);
            continue;
        };
        let planned_ns = start_ns + next * run.interval_ns;
        let left_ns = planned_ns.saturating_sub(monotonic_ns());
        if left_ns > run.interval_ns {
            // The plan may still shift.
            std::thread::sleep(Duration::from_nanos(left_ns - run.interval_ns / 2));
            continue;
        }
        next += 1;
        if left_ns > 0 {
            std::thread::sleep(Duration::from_nanos(left_ns));
            late_ns.push(monotonic_ns().saturating_sub(planned_ns) as f64);
        }
    }
    late_ns
}

/// The cells of a row: times of the chain divided by times of the control process.
fn ratios(Times { mut wake_ups, mut end_to_ends, mut controls }: Times) -> [String; 5] {
    let of = |values: &mut [f64]| [0.5, 0.99, 1.0].map(|share| percentile(values, share));
    let [wake_up, end_to_end, control] = [of(&mut wake_ups), of(&mut end_to_ends), of(&mut controls)];
    let spread = |of: [f64; 3], i: usize| of[i] - of[0];
    [
        wake_up[0] / control[0],
        wake_up[1] / control[1],
        wake_up[2] / control[2],
        spread(end_to_end, 1) / spread(control, 1),
        spread(end_to_end, 2) / spread(control, 2),
    ]
    .map(|ratio| if ratio.is_finite() { format!("{ratio:.3}") } else { "\u{2013}".to_owned() })
}

/// Threads that only use CPU time. They end when this is dropped.
struct Hogs(Arc<AtomicBool>, Vec<JoinHandle<()>>);

impl Hogs {
    fn start() -> Self {
        let has_ended = Arc::new(AtomicBool::new(false));
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let spin = |has_ended: Arc<AtomicBool>| {
            move || {
                while !has_ended.load(Relaxed) {
                    std::hint::spin_loop();
                }
            }
        };
        let threads = (0..HOGS * cores).map(|_| std::thread::spawn(spin(has_ended.clone()))).collect();
        Self(has_ended, threads)
    }
}

impl Drop for Hogs {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
        self.1.drain(..).for_each(|hog| {
            let _ = hog.join();
        });
    }
}

#[cfg(test)]
mod tests {
    use wire::Hop;

    use super::*;

    #[test]
    fn a_row_has_ratios_to_the_control_process() {
        let times = |scale: f64| (1..=100).map(|i| f64::from(i) * scale).collect::<Vec<_>>();
        let end_to_ends = times(3.0).into_iter().map(|ns| ns + 5e6).collect();
        let row = ratios(Times { wake_ups: times(0.5), end_to_ends, controls: times(1.0) });
        assert_eq!(
            row,
            ["0.500", "0.500", "0.500", "3.000", "3.000"],
            "the offset of the end to end is no jitter"
        );
        assert_eq!(ratios(Times::default())[0], "\u{2013}");
    }

    #[test]
    fn a_tick_is_measured_from_its_planned_moment() {
        let run = Run { interval_ns: 80, ..Run::default() };
        let mut header = Header { released_ns: 10_000 + 80 * WARM_UP + 7, ..Header::new(1, WARM_UP, 0) };
        header.push_hop(Hop {
            stage: StageId::Sampler.number(),
            sent_ns: header.released_ns + 20,
            ..Hop::default()
        });
        assert_eq!(late_ns(&header, &run, Some(10_000)), Some([7.0, 27.0]));
        assert_eq!(late_ns(&header, &run, None), None, "no tick was released yet");
        assert_eq!(late_ns(&header, &run, Some(10_008)), None, "the plan has shifted since");
        assert_eq!(late_ns(&header, &run, Some(9_000)), None, "more than an interval late");
        header.seq = WARM_UP - 1;
        assert_eq!(late_ns(&header, &run, Some(10_080)), None);
    }

    #[test]
    fn hogs_end_when_they_are_dropped() {
        let hogs = Hogs::start();
        let has_ended = hogs.0.clone();
        drop(hogs);
        assert!(has_ended.load(Relaxed) && Arc::strong_count(&has_ended) == 1);
    }
}
