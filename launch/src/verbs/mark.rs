use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use console::failure::Failure;
use console::show::show;
use recording::tap::{Client, Item, Marked, Request};
use run::Exit;

use crate::runs;

/// Time limit for the tap to answer.
const ANSWER_LIMIT: Duration = Duration::from_secs(10);

/// Arguments of `stgdat mark`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Text of the mark
    #[arg(value_name = "TEXT")]
    text: String,
    /// Name or folder of the run; not needed if only one is running
    #[arg(long, value_name = "NAME")]
    run: Option<PathBuf>,
}

/// Marks this moment in all recordings of a run.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let run = runs::find(arguments.run.as_deref())?;
    let (tool, mark) = ("mark".to_owned(), Some(arguments.text.clone()));
    let request = Request { tool, topics: Vec::new(), events: false, mark, recording: None };
    let mut client = Client::attach(&run.root, &request).map_err(Failure::unavailable)?;
    let marked = loop {
        match client.next(ANSWER_LIMIT).map_err(Failure::unavailable)? {
            Some(Item::Marked(marked)) => break marked,
            Some(Item::Refused(why)) => return Err(Failure::unavailable_about(&run.name, why)),
            Some(_) => {}
            None => return Err(Failure::Failed(format!("the tap of {} does not answer", run.name))),
        }
    };
    show(&text(&run.name, &marked)?)
}

/// Lists the recordings that have the mark. Returns an error if no recording has it.
fn text(run: &str, Marked { tick, recordings }: &Marked) -> Result<String, Failure> {
    if recordings.is_empty() {
        let why = format!(
            "no recording with events is made of {run}, so the mark is lost: \
             `stgdat record FILE --run {run}` starts one"
        );
        return Err(Failure::Failed(why));
    }
    let tick = tick.map_or_else(String::new, |tick| format!(" at tick {tick}"));
    Ok(format!("marked {run}{tick} in {}\n", recordings.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_names_its_run_its_tick_and_its_recordings() {
        let recordings = vec!["a.mcap".to_owned(), "b.mcap".to_owned()];
        let marked = Marked { tick: Some(12), recordings };
        assert_eq!(text("stgdat_1", &marked).unwrap(), "marked stgdat_1 at tick 12 in a.mcap, b.mcap\n");
        let error = text("stgdat_1", &Marked::default()).unwrap_err().to_string();
        assert!(error.contains("stgdat record FILE --run stgdat_1"), "{error}");
    }
}
