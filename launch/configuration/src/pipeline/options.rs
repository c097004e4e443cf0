use console::mistake::Mistake;
use run::{Declared, OptionError};
use wire::StageId;

use super::file::OptionsTable;

/// The options of one of this project's own programs.
pub(super) fn options(
    stage: &dyn Declared,
    table: &OptionsTable,
    declared: &[&dyn Declared],
) -> Result<toml::Table, Mistake> {
    let mut options = toml::Table::new();
    // The spans of each option's key and value in the text.
    let mut spans = Vec::new();
    for (key, value) in table {
        options.insert(key.get_ref().clone(), value.get_ref().clone());
        spans.push((key.get_ref(), key.span(), value.span()));
    }
    stage.check(&options).map_err(|error| {
        let at_fault = spans.iter().find(|(key, ..)| error.key() == Some(key));
        let (key, value) = at_fault.map_or((0..0, 0..0), |(_, key, value)| (key.clone(), value.clone()));
        let (message, advice) = (error.to_string(), error.advice());
        match &error {
            OptionError::Unknown { key: unknown, .. } => {
                Mistake::new(key, message, owners(unknown, declared)).help(advice)
            }
            _ => Mistake::new(value, message, advice),
        }
    })?;
    Ok(options)
}

/// Names the stages that have an option of this name.
fn owners(key: &str, declared: &[&dyn Declared]) -> String {
    let owners = declared.iter().filter(|stage| stage.schema().get(key).is_some());
    let owners: Vec<&str> = owners.map(|stage| StageId::name(stage.id())).collect();
    match &owners[..] {
        [] => "no stage has an option of this name".to_owned(),
        owners => format!("an option of the {}", owners.join(" and the ")),
    }
}
