//! What a training on own recordings brought, on the recordings that validate it.

use std::path::Path;

use console::failure::Failure;
use data::Recording;
use evaluator::{Errors, Evaluation, Measure, Method, Options, Report, State, Table};
use evaluator::{WeightsChoice, digits, pair};

/// A smaller relative change of an error is none.
const CHANGE_MIN: f64 = 0.02;

/// The errors of all agents by one set of weights, over the whole horizon.
struct Figures {
    network: [Option<Errors>; 2],
    published: [Option<Errors>; 2],
    steady: [Option<Errors>; 2],
    agents: u64,
}

/// A table of the errors before and after a training, and whether the published forecasts became better.
///
/// # Errors
/// [`Failure`] if weights can't be read.
pub fn text(recordings: &[Recording], before: &Path, after: &Path) -> Result<String, Failure> {
    let [before, after] = [figures(recordings, before)?, figures(recordings, after)?];
    let columns = ["single best, ADE / FDE", "best of 20, ADE / FDE"];
    let mut table = Table::new("", "", &["validation, m"], columns);
    for (name, of) in [
        ("network before", before.network),
        ("network after", after.network),
        ("published before", before.published),
        ("published after", after.published),
        ("constant velocity", after.steady),
    ] {
        table.push(&[name], of.map(|errors| errors.map(pair)));
    }
    Ok(format!(
        "{}\n{} forecasts. *Published* forecasts have evidence and retrieval.\n\n{}",
        table.grid(),
        after.agents,
        verdict(&before, &after)
    ))
}

fn verdict(before: &Figures, after: &Figures) -> String {
    let fde_m = |of: &[Option<Errors>; 2]| of[0].map_or(f64::NAN, |errors| errors.fde_m);
    if after.agents == 0 {
        return "No agent of the validation part is present over a whole window.".to_owned();
    }
    let [from, to] = [before, after].map(|of| fde_m(&of.published));
    let change = to / from - 1.0;
    if change <= -CHANGE_MIN {
        return format!(
            "The published single best forecasts are better: FDE {} -> {} m ({:+.0} %).",
            digits(from),
            digits(to),
            100.0 * change
        );
    }
    let outcome = if change < CHANGE_MIN { "did not become better" } else { "are worse" };
    let mut text = format!(
        "The published single best forecasts {outcome}: FDE {} -> {} m ({:+.1} %).",
        digits(from),
        digits(to),
        100.0 * change
    );
    let [network, steady] = [fde_m(&after.network), fde_m(&after.steady)];
    if network > steady {
        text += &format!(
            " The network has {} m, constant velocity {} m. Evidence prefers the smaller error: the network's must \
             fall by {:.0} % before it counts.",
            digits(network),
            digits(steady),
            100.0 * (1.0 - steady / network)
        );
    }
    text
}

fn figures(recordings: &[Recording], weights: &Path) -> Result<Figures, Failure> {
    let options = Options {
        weights: WeightsChoice { file: Some(weights.to_owned()), ..WeightsChoice::default() },
        threads: std::thread::available_parallelism().map_or(1, usize::from),
        ..Options::default()
    };
    let evaluation = Evaluation::new(&options, false).map_err(Failure::data)?;
    let states =
        recordings.iter().map(|recording| Ok((recording.name.clone(), evaluation.opened(recording.clone()))));
    let report = State::merged(states).map_err(Failure::data)?.report();
    let of = |method| [Measure::Single, Measure::BestOf].map(|measure| errors(&report, method, measure));
    let [network, published, steady] = [Method::Network, Method::Evidence, Method::ConstantVelocity].map(of);
    let agents = figure(&report, Method::Network, Measure::Single, "FDE, m").map_or(0, |(_, agents)| agents);
    Ok(Figures { network, published, steady, agents })
}

fn errors(report: &Report, method: Method, measure: Measure) -> Option<Errors> {
    let value = |quantity| figure(report, method, measure, quantity).map(|(value, _)| value);
    Some(Errors { ade_m: value("ADE, m")?, fde_m: value("FDE, m")? })
}

/// A figure of all agents over the whole horizon, and their number. The last part holds all recordings.
fn figure(report: &Report, method: Method, measure: Measure, quantity: &str) -> Option<(f64, u64)> {
    let mut wanted = report.figures.iter().filter(|figure| {
        (figure.method, figure.measure, &*figure.quantity) == (method.name(), measure.name(), quantity)
            && figure.subset == "all"
    });
    wanted.next_back().map(|figure| (figure.value, figure.agents))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(network: f64, published: f64) -> Figures {
        let errors = |fde_m: f64| [Some(Errors { ade_m: fde_m / 2.0, fde_m }); 2];
        Figures { network: errors(network), published: errors(published), steady: errors(3.532), agents: 5 }
    }

    #[test]
    fn the_verdict_is_about_the_published_forecasts() {
        let none = verdict(&of(1.0, 1.0), &Figures { agents: 0, ..of(1.0, 1.0) });
        assert!(none.starts_with("No agent"), "{none}");
        let better = verdict(&of(8.571, 4.0), &of(3.0, 3.0));
        assert_eq!(better, "The published single best forecasts are better: FDE 4.000 -> 3.000 m (-25 %).");
        let same = verdict(&of(8.571, 3.5), &of(5.85, 3.51));
        assert!(same.contains("did not become better: FDE 3.500 -> 3.510 m (+0.3 %)."), "{same}");
        assert!(
            same.contains("5.850 m, constant velocity 3.532 m") && same.contains("fall by 40 %"),
            "{same}"
        );
        let worse = verdict(&of(3.0, 3.0), &of(3.2, 3.2));
        assert_eq!(worse, "The published single best forecasts are worse: FDE 3.000 -> 3.200 m (+6.7 %).");
    }
}
