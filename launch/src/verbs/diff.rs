use std::collections::{BTreeMap, BTreeSet};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use clap::Args;
use console::failure::Failure;
use console::show::show;
use recorder::Report;
use recording::{About, Comparison};
use run::Exit;

use crate::differences::{table, title};
use crate::files::check_new;
use crate::pages::write_page;
use crate::recorded::{self, open_and_check};
use crate::report_differences::ReportComparison;

/// Arguments of `stgdat diff`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// A recording of a run, or a report (`run --report`)
    #[arg(value_name = "A")]
    a: PathBuf,
    /// Another one of the same kind and scene
    #[arg(value_name = "B")]
    b: PathBuf,
    /// Print the comparison as JSON
    #[arg(long)]
    json: bool,
    /// Also write the comparison as an HTML page, as `stgdat report A B` does
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Replace the file of --html if it exists
    #[arg(long, requires = "html")]
    force: bool,
}

/// Compares two recordings tick by tick, or two reports figure by figure and agent by agent.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let kinds = [is_report(&arguments.a)?, is_report(&arguments.b)?];
    if let (Some(page), true) = (&arguments.html, kinds[0] == kinds[1]) {
        check_new(page, arguments.force)?;
        // The comparison below names damaged parts.
        write_page(page, &[&arguments.a, &arguments.b])?;
    }
    match kinds {
        [false, false] => recordings(arguments),
        [true, true] => reports(arguments),
        [first, _] => {
            let (report, recording) =
                if first { (&arguments.a, &arguments.b) } else { (&arguments.b, &arguments.a) };
            let (report, recording) = (report.display(), recording.display());
            Err(Failure::Usage(format!("{report} is a report and {recording} is none: name two of a kind")))
        }
    }
}

/// Whether a file is a report: its first character is `{`, as in JSON.
fn is_report(path: &Path) -> Result<bool, Failure> {
    let failed = |error| Failure::file(path, error);
    let mut begin = Vec::new();
    std::fs::File::open(path).map_err(failed)?.take(64).read_to_end(&mut begin).map_err(failed)?;
    Ok(begin.trim_ascii_start().first() == Some(&b'{'))
}

fn reports(arguments: &Arguments) -> Result<Exit, Failure> {
    let [a, b] = [&arguments.a, &arguments.b].map(|path| Report::read(path).map_err(Failure::data));
    let compared = ReportComparison::of(&a?, &b?);
    if arguments.json {
        show(&(serde_json::to_string_pretty(&compared).map_err(Failure::data)? + "\n"))?;
    } else {
        let [a, b] = [&arguments.a, &arguments.b].map(|path| path.display());
        let equal = if compared.is_equal() { "equal but for the clock\n" } else { "" };
        show(&format!("A: {a}\nB: {b}\n{}{equal}", compared.text()))?;
    }
    Ok(if compared.is_equal() { Exit::Done } else { Exit::Different })
}

fn recordings(arguments: &Arguments) -> Result<Exit, Failure> {
    let (a, mut damages) = open_and_check(&arguments.a)?;
    let (b, damages_of_b) = open_and_check(&arguments.b)?;
    let comparison = Comparison::of(&a, &b);
    if arguments.json {
        show(&(serde_json::to_string_pretty(&comparison).map_err(Failure::data)? + "\n"))?;
    } else {
        let mut text = title(&a, &damages) + &title(&b, &damages_of_b);
        for what in differing(a.about(), b.about()) {
            text += &format!("  the runs differ in {what}\n");
        }
        text += &table(&comparison, ["in A", "in B"]);
        text += &match (comparison.ticks(), comparison.is_equal()) {
            (0, _) => "no topic has a tick that is in both\n".to_owned(),
            (ticks, true) => format!("equal to the byte: {ticks} ticks\n"),
            (_, false) => String::new(),
        };
        show(&text)?;
    }
    damages.extend(damages_of_b);
    recorded::end_with(damages)?;
    Ok(if comparison.is_equal() && comparison.ticks() > 0 { Exit::Done } else { Exit::Different })
}

/// Lists the differences in the inputs of two runs.
fn differing(a: &About, b: &About) -> Vec<String> {
    let pairs = [
        ("seed", a.run.seed.to_string(), b.run.seed.to_string()),
        ("scene", a.scene.clone(), b.scene.clone()),
        ("weights", a.weights_sha256.clone(), b.weights_sha256.clone()),
        ("kernels", a.kernels.clone(), b.kernels.clone()),
        ("program", a.program.clone(), b.program.clone()),
        ("lockstep", a.run.lockstep.to_string(), b.run.lockstep.to_string()),
    ];
    let pairs = pairs.into_iter().filter(|(_, a, b)| a != b);
    let mut found: Vec<String> = pairs.map(|(name, a, b)| format!("{name}: {a} and {b}")).collect();
    let [of_a, of_b] = [a, b].map(view::options_of);
    let names: BTreeSet<&String> = of_a.keys().chain(of_b.keys()).collect();
    let value =
        |of: &BTreeMap<String, String>, name| of.get(name).map_or("default", String::as_str).to_owned();
    let options = names.into_iter().map(|name| (name, value(&of_a, name), value(&of_b, name)));
    found.extend(options.filter(|(_, a, b)| a != b).map(|(name, a, b)| format!("{name}: {a} and {b}")));
    found
}
