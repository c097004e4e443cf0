//! `--cost`: the compute cost of agents and modes.

use console::failure::Failure;
use console::tables;
use ports::TemporaryFolder;

use super::arguments::Arguments;
use super::percentile::percentile;
use super::{modes, stages};

/// Measured numbers of agents.
const AGENTS: [usize; 5] = [1, 8, 32, 64, 128];
/// Measured numbers of modes, up to the number in the weights.
const MODES: [usize; 3] = [1, 6, 20];

/// Measures the compute of a whole tick by agents and modes, and the cost of each further agent.
pub(super) fn table(arguments: &Arguments) -> Result<String, Failure> {
    let (_, weights) = arguments.model.open_weights(None)?;
    let modes_of = MODES.into_iter().filter(|&modes| modes <= weights.config().modes);
    let modes_of: Vec<usize> = modes_of.collect();
    let folder = TemporaryFolder::create("stgdat-bench-").map_err(Failure::unavailable)?;
    let file = folder.path().join("first.safetensors");
    let mut columns: Vec<Vec<(f64, f64)>> = vec![Vec::new(); modes_of.len()];
    for agents in AGENTS {
        // The modes alternate, so other load on the machine affects all columns.
        for (column, &modes) in columns.iter_mut().zip(&modes_of) {
            modes::write_first(&weights, modes, &file)?;
            let measured = stages::measure(arguments, agents, Some(&file))?;
            column.push((measured.agents, percentile(&mut measured.ticks_ms(), 0.5)));
        }
    }
    Ok(text(&modes_of, &columns))
}

/// Formats the table; `columns` holds (agents, ms) per number of modes.
fn text(modes: &[usize], columns: &[Vec<(f64, f64)>]) -> String {
    let row = |first: String, values: Vec<f64>, digits: usize| {
        let values = values.into_iter().map(|value| format!("{value:.digits$}"));
        tables::row(std::iter::once(first).chain(values))
    };
    let heads = modes.iter().map(|&modes| format!("{modes} mode{}:", if modes == 1 { "" } else { "s" }));
    let names: Vec<String> = std::iter::once("agents:".to_owned()).chain(heads).collect();
    let mut text = tables::head(&names);
    let rows = columns.first().map_or(0, Vec::len);
    for at in 0..rows {
        let times = columns.iter().map(|column| column[at].1).collect();
        text += &row(format!("{:.0}", columns[0][at].0), times, 2);
    }
    for at in 1..rows {
        let (from, to) = (columns[0][at - 1].0, columns[0][at].0);
        let slope = |column: &Vec<(f64, f64)>| {
            let ((less, before), (more, after)) = (column[at - 1], column[at]);
            (after - before) / (more - less)
        };
        text += &row(format!("each further, {from:.0} to {to:.0}"), columns.iter().map(slope).collect(), 3);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn further_agents_cost_the_slope() {
        let columns =
            [vec![(1.0, 0.5), (8.0, 4.0), (32.0, 28.0)], vec![(1.0, 1.0), (8.0, 8.0), (32.0, 56.0)]];
        let expected = "\
| agents | 1 mode | 20 modes |
|---:|---:|---:|
| 1 | 0.50 | 1.00 |
| 8 | 4.00 | 8.00 |
| 32 | 28.00 | 56.00 |
| each further, 1 to 8 | 0.500 | 1.000 |
| each further, 8 to 32 | 1.000 | 2.000 |
";
        assert_eq!(text(&[1, 20], &columns), expected);
    }
}
