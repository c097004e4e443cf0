//! The built-in specifications, and specifications in files and folders.

use std::path::{Path, PathBuf};

use console::failure::Failure;

use crate::spec::Spec;

/// Lists the files of `tests/faults` with their texts.
macro_rules! scenarios {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../tests/faults/", $name, ".toml")))),*]
    };
}

/// The built-in specifications, by name.
const BUILT_IN: &[(&str, &str)] = scenarios![
    "01-kill",
    "01-kill-behind-injector",
    "02-kill-in-a-step",
    "02-reclaim",
    "03-kill-at-start",
    "04-broken-command",
    "04-crash-loop",
    "04-restart-limit",
    "05-stop",
    "05-stopped-launcher",
    "06-delay",
    "07-drop",
    "07-drop-controls",
    "08-duplicate",
    "08-reorder",
    "08-reorder-unchecked",
    "09-bit-flip",
    "09-bit-flip-header-unchecked",
    "09-bit-flip-lockstep",
    "09-bit-flip-unchecked",
    "10-foreign",
    "10-not-finite",
    "11-frozen-content",
    "11-frozen-stamps",
    "12-clock-jump-back",
    "12-clock-jump-forward",
    "13-dying-consumers",
    "13-greedy-consumer",
    "14-descriptors",
    "14-disk-full",
    "14-file-limit",
    "15-cpu",
    "16-launcher-killed",
    "17-broken-replacement",
    "17-replace",
    "18-spare",
    "18-spare-in-a-step",
];

/// The built-in specifications.
pub fn built_in() -> Result<Vec<Spec>, Failure> {
    BUILT_IN.iter().map(|(name, text)| Ok(Spec::parse(Path::new(&format!("{name}.toml")), text)?)).collect()
}

/// Returns the specifications in files and folders, and the built-in ones with these names.
pub fn find_all(places: &[PathBuf]) -> Result<Vec<Spec>, Failure> {
    let mut specs = Vec::new();
    for place in places {
        let name = place.to_string_lossy();
        if place.is_dir() {
            let entries = std::fs::read_dir(place).map_err(|error| Failure::file(place, error))?;
            let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
            files.retain(|file| file.extension().is_some_and(|extension| extension == "toml"));
            files.sort_by(|a, b| a.file_stem().cmp(&b.file_stem()));
            for file in files {
                specs.push(Spec::read(&file)?);
            }
        } else if let Some((_, text)) = BUILT_IN.iter().find(|(known, _)| *known == name && !place.exists()) {
            specs.push(Spec::parse(place, text)?);
        } else {
            specs.push(Spec::read(place)?);
        }
    }
    if specs.is_empty() {
        return Err(Failure::Usage("no specification in these folders: they end with .toml".to_owned()));
    }
    Ok(specs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_built_in_and_can_be_used() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/faults");
        let in_folder: Vec<String> = find_all(&[folder]).unwrap().into_iter().map(|spec| spec.name).collect();
        let known: Vec<String> = built_in().unwrap().into_iter().map(|spec| spec.name).collect();
        assert_eq!(in_folder, known);
    }
}
