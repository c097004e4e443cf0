use console::mistake::line_of;
use console::mistake::{Mistake, SourceError};
use run::Declared;

use super::file::File;
use super::{Pipeline, check};

impl Pipeline {
    /// Reads and checks the text of a pipeline.toml. `name` is the file's name in errors. `declared` contains
    /// the stages for which this project has programs.
    ///
    /// # Errors
    /// [`SourceError`] points to the first fault in the text.
    pub fn parse(name: &str, text: &str, declared: &[&dyn Declared]) -> Result<Self, SourceError> {
        let mut file: File = toml::from_str(text).map_err(|e| Mistake::syntax(text, &e).at(name, text))?;
        file.add_topics_of(declared);
        let mut pipeline = check::check(&file, declared).map_err(|mistake| mistake.at(name, text))?;
        for (stage, table) in pipeline.stages.iter_mut().zip(&file.stages) {
            let place = |at: usize| format!("{name}:{}", line_of(text, at));
            let options = table.get_ref().options.iter();
            stage.places =
                options.map(|(key, value)| (key.get_ref().clone(), place(value.span().start))).collect();
        }
        Ok(pipeline)
    }

    /// Refuses a file that this machine cannot run: `find` does not find a `command`, or `has_cpu` does not
    /// know a processor.
    ///
    /// # Errors
    /// [`SourceError`] points to the first fault in the text. [`Pipeline::parse`] must accept the text.
    pub fn check_here(
        name: &str,
        text: &str,
        find: &dyn Fn(&str) -> Result<(), String>,
        has_cpu: &dyn Fn(u32) -> bool,
    ) -> Result<(), SourceError> {
        let file: File = toml::from_str(text).map_err(|e| Mistake::syntax(text, &e).at(name, text))?;
        check::check_here(&file, find, has_cpu).map_err(|mistake| mistake.at(name, text))
    }
}
