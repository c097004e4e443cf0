use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use recorder::status::RunStatus;
use run::Exit;

use crate::failure::Failure;
use crate::runs;
use crate::top::Client;

/// Pause between two questions.
const PAUSE: Duration = Duration::from_millis(100);

/// Arguments of `stgdat health`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Name or folder of the run; not needed if only one is running
    #[arg(long, value_name = "RUN")]
    run: Option<PathBuf>,
    /// Longest wait for the next forecasts, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 2)]
    within: u8,
}

/// Checks that forecasts arrive and that every stage is alive. The exit code is for health checks of
/// containers and supervisors.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = runs::find(arguments.run.as_deref())?;
    let client = Client::new(&run.root);
    let first = client.ask()?;
    let begun = Instant::now();
    let within = Duration::from_secs(arguments.within.into());
    let mut status = first.clone();
    while fault(&first, &status).is_some() && begun.elapsed() < within {
        std::thread::sleep(PAUSE);
        status = client.ask()?;
    }
    match fault(&first, &status) {
        Some(fault) => Err(Failure::Failed(format!("{}: {fault}", run.name))),
        None => {
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
        return Some("it is starting".to_owned());
    }
    if let Some(name) = stage(&|stage| stage.process.state == "given up") {
        return Some(format!("the {name} is given up"));
    }
    if let Some(name) = stage(&|stage| stage.alive == Some(false)) {
        return Some(format!("the {name} is silent"));
    }
    (now.report.ticks <= first.report.ticks).then(|| format!("no forecasts after tick {}", now.report.ticks))
}

#[cfg(test)]
mod tests {
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
    }
}
