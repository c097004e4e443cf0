use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use console::failure::Failure;
use console::say;
use recorder::status::RunStatus;
use run::Exit;
use telemetry::top::Client;

use crate::runs;

/// Pause between two questions.
const PAUSE: Duration = Duration::from_millis(100);

/// Arguments of `stgdat health`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Name or folder of the run; not needed if only one is running
    #[arg(long, value_name = "RUN")]
    run: Option<PathBuf>,
    /// Longest wait for the next forecasts, and the time within which no stage may have been restarted, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 2)]
    within: u8,
    /// Least share of learned forecasts in the last ten seconds, such as 50%. Agents that are too young, and agents
    /// for which another expert is better, do not count
    #[arg(long, value_name = "SHARE", value_parser = share)]
    learned: Option<f64>,
}

/// Parses a share: `50%` or `0.5`.
fn share(text: &str) -> Result<f64, String> {
    let parsed = match text.strip_suffix('%') {
        Some(percent) => percent.trim_end().parse().map(|percent: f64| percent / 1e2),
        None => text.parse(),
    };
    parsed
        .ok()
        .filter(|share| (0.0..=1.0).contains(share))
        .ok_or_else(|| "expected a share, such as 50%".to_owned())
}

/// Checks that input and forecasts arrive and that every stage is alive. The exit code is for health checks of
/// containers and supervisors.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = runs::find(arguments.run.as_deref())?;
    let client = Client::new(&run.root);
    let first = client.ask()?;
    let begun = Instant::now();
    let within = Duration::from_secs(arguments.within.into());
    let mut status = first.clone();
    let fault = |status: &RunStatus| {
        fault(&first, status)
            .or_else(|| restarted(&first, status, within))
            .or_else(|| not_learned(status, arguments.learned?))
    };
    while fault(&status).is_some() && begun.elapsed() < within {
        std::thread::sleep(PAUSE);
        status = client.ask()?;
    }
    match (&status.input.state, fault(&status)) {
        (Some(state), _) => Err(Failure::unavailable(format!("{}: {state}", run.name))),
        (None, Some(fault)) => Err(Failure::Failed(format!("{}: {fault}", run.name))),
        (None, None) => {
            say!("{}", status.service_line());
            Ok(Exit::Done)
        }
    }
}

/// Why a run is not healthy between two moments.
fn fault(first: &RunStatus, now: &RunStatus) -> Option<String> {
    let stage = |is_it: &dyn Fn(&recorder::status::StageStatus) -> bool| {
        now.stages.iter().find(|stage| is_it(stage)).map(|stage| stage.name.clone())
    };
    if !now.linked {
        return Some(match &now.waiting_for {
            Some(stage) => format!("it waits for the {stage}"),
            None => "it is starting".to_owned(),
        });
    }
    if let Some(state) = &now.input.state {
        return Some(state.clone());
    }
    if let Some(name) = stage(&|stage| stage.process.state == "given up") {
        return Some(format!("the {name} is given up"));
    }
    if let Some(name) = stage(&|stage| stage.alive == Some(false)) {
        return Some(format!("the {name} is silent"));
    }
    (now.report.ticks <= first.report.ticks).then(|| format!("no forecasts after tick {}", now.report.ticks))
}

/// The stage that was restarted since the first moment, or within this time before it.
fn restarted(first: &RunStatus, now: &RunStatus, within: Duration) -> Option<String> {
    let restarts = |status: &RunStatus, name: &str| {
        let stage = status.stages.iter().find(|stage| stage.name == name);
        stage.map_or(0, |stage| stage.process.restarts)
    };
    let since = now.stages.iter().find(|stage| stage.process.restarts > restarts(first, &stage.name));
    let tick_ms = first.report.run.interval_ms.unwrap_or(0.0);
    let newest = first.newest.tick.unwrap_or(0);
    let is_recent = |tick: u64| newest.saturating_sub(tick) as f64 * tick_ms <= within.as_secs_f64() * 1e3;
    let before = first.report.supervision.outages.iter().rfind(|outage| is_recent(outage.tick));
    let name = since.map(|stage| &stage.name).or_else(|| before.map(|outage| &outage.stage))?;
    Some(format!("the {name} was restarted within the last {} s", within.as_secs()))
}

/// Whether fewer forecasts are learned than this share.
fn not_learned(now: &RunStatus, least: f64) -> Option<String> {
    let share = now.recent_learned_share.filter(|share| *share < least)?;
    Some(format!("{:.0} % of the forecasts are learned, less than {:.0} %", share * 1e2, least * 1e2))
}

#[cfg(test)]
mod tests {
    use recorder::{InputStatus, Outage};

    use recorder::status::StageStatus;

    use super::*;

    #[test]
    fn a_run_is_healthy_if_forecasts_arrive_and_every_stage_is_alive() {
        let status = |ticks, alive, state: &str| {
            let stage = StageStatus { name: "decoder".to_owned(), alive, ..StageStatus::default() };
            let mut status = RunStatus { linked: true, stages: vec![stage], ..RunStatus::default() };
            status.stages[0].process.state = state.to_owned();
            status.report.ticks = ticks;
            status
        };
        let first = status(5, Some(true), "running");
        assert_eq!(fault(&first, &status(6, Some(true), "running")), None);
        assert_eq!(fault(&first, &status(6, None, "")), None, "an external stage");
        let text = |now| fault(&first, &now).unwrap();
        assert_eq!(text(status(5, Some(true), "running")), "no forecasts after tick 5");
        assert_eq!(text(status(6, Some(false), "running")), "the decoder is silent");
        assert_eq!(text(status(6, Some(true), "given up")), "the decoder is given up");
        assert_eq!(text(RunStatus::default()), "it is starting");
        let state = Some("NO INPUT for 3.1 s".to_owned());
        let silent = InputStatus { state, ..InputStatus::default() };
        assert_eq!(
            text(RunStatus { input: silent, ..status(6, Some(true), "running") }),
            "NO INPUT for 3.1 s"
        );
    }

    #[test]
    fn a_recent_restart_and_few_learned_forecasts_are_faults() {
        let mut status = RunStatus::default();
        status.report.run.interval_ms = Some(100.0);
        status.newest.tick = Some(100);
        let outage = |tick| Outage { stage: "decoder".to_owned(), tick, ..Outage::default() };
        let within = Duration::from_secs(2);
        status.report.supervision.outages = vec![outage(60)];
        assert_eq!(restarted(&status, &status, within), None);
        status.report.supervision.outages.push(outage(85));
        let text = "the decoder was restarted within the last 2 s";
        assert_eq!(restarted(&status, &status, within).as_deref(), Some(text));
        assert_eq!(not_learned(&status, 0.5), None, "no agents");
        status.recent_learned_share = Some(0.4);
        assert_eq!(
            not_learned(&status, 0.5).as_deref(),
            Some("40 % of the forecasts are learned, less than 50 %")
        );
        assert_eq!([share("40%"), share("0.4")], [Ok(0.4), Ok(0.4)]);
        assert!(share("140%").is_err() && share("x").is_err());
    }
}
