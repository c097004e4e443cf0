mod gain;

use std::path::PathBuf;

use clap::Args;
use console::failure::Failure;
use console::say;
use run::Exit;
use trainer::TrainOptions;

use super::card;
use launch::arguments::canonical;
use launch::files::check_place;

/// Arguments of `stgdat train`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Your recordings, or folders with recordings. Training starts from the embedded weights and resumes by
    /// itself. The last fifth validates: of the files, or of the time if there is one file
    #[arg(value_name = "FILE", conflicts_with_all = ["recipe", "options", "data"])]
    files: Vec<PathBuf>,
    /// Recipe of shipped weights: eth, hotel, univ, zara1, zara2, sdd, interaction, interaction-without-FT,
    /// interaction-without-EP1, onboard or onboard-free
    #[arg(long, value_name = "NAME", conflicts_with = "options")]
    recipe: Option<String>,
    /// Variant of the model: paper, plus, compact, full, T, T+C-ATT, T+C, T+C+K, same-node, equal-attention,
    /// no-attention, literal, no-map, site-map, online-map or centred-patch; several are applied in order
    #[arg(long, value_name = "NAME")]
    preset: Vec<String>,
    /// Set an option by its path in the output of --print-options, such as `objective.plus.candidates=6`;
    /// several are applied in order
    #[arg(long, value_name = "OPTION=VALUE")]
    set: Vec<String>,
    /// Folder with the data sets in their published layout; by default the folder in the options, or `data`
    #[arg(long, value_name = "DIR", env = "STGDAT_DATA")]
    data: Option<PathBuf>,
    /// Options as JSON, such as the options of a model card; missing ones have their defaults
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
    /// Weights file, written when validation improves; by default RECIPE.safetensors, or weights.safetensors
    /// without a recipe
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Folder for checkpoints; by default checkpoints/RECIPE, or checkpoints without a recipe
    #[arg(long, value_name = "DIR")]
    checkpoints: Option<PathBuf>,
    /// Resume from the newest checkpoint, if there is one
    #[arg(long)]
    resume: bool,
    /// Seed of the random numbers
    #[arg(long)]
    seed: Option<u64>,
    /// Number of updates
    #[arg(long, value_name = "N")]
    steps: Option<u64>,
    /// Number of threads for each batch; the last digits of the figures depend on it
    #[arg(long, value_name = "N")]
    workers: Option<usize>,
    /// Print the options and exit
    #[arg(long)]
    print_options: bool,
}

/// Trains weights and prints their card.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let mut options = options(arguments)?;
    if arguments.print_options {
        say!("{}", serde_json::to_string_pretty(&options).map_err(Failure::data)?);
        return Ok(Exit::Done);
    }
    check_place(&options.out)?;
    if !options.files.is_empty() && options.begin_with.is_empty() {
        trainer::begin_with_onboard(&mut options).map_err(Failure::data)?;
    }
    let summary = trainer::train(&options).map_err(Failure::data)?;
    say!("{}\n{} updates: {}", card::text(&summary.card), summary.steps, options.out.display());
    if let ([before], false) = (&options.begin_with[..], options.files.is_empty()) {
        let recordings = trainer::validation_recordings(&options.files).map_err(Failure::data)?;
        say!("{}", gain::text(&recordings, before, &options.out)?);
    }
    Ok(Exit::Done)
}

/// The recordings of the command line, including those in its folders.
fn own_files(arguments: &Arguments) -> Result<Vec<PathBuf>, Failure> {
    let mut files = Vec::new();
    for path in &arguments.files {
        match canonical(path)? {
            folder if folder.is_dir() => files.extend(data::recordings_in(&folder).map_err(Failure::data)?),
            file => files.push(file),
        }
    }
    if files.is_empty() {
        return Err(Failure::Usage("there is no recording in the folder".to_owned()));
    }
    Ok(files)
}

/// The options of a file, a recipe or the defaults, changed by presets and the rest of the command line.
fn options(arguments: &Arguments) -> Result<TrainOptions, Failure> {
    let mut options = match &arguments.recipe {
        Some(name) => recipe(name)?,
        None if !arguments.files.is_empty() => trainer::own(own_files(arguments)?),
        None => TrainOptions::default(),
    };
    if let Some(path) = &arguments.options {
        let text = std::fs::read_to_string(path).map_err(|error| Failure::file(path, error))?;
        options = serde_json::from_str(&text).map_err(|error| Failure::file(path, error))?;
    }
    for name in &arguments.preset {
        options = with_preset(options, name)?;
    }
    for set in &arguments.set {
        options = changed(&options, set)?;
    }
    options.resume |= arguments.resume;
    let paths = [
        (&mut options.data, &arguments.data),
        (&mut options.out, &arguments.out),
        (&mut options.checkpoints, &arguments.checkpoints),
    ];
    for (option, asked) in paths {
        if let Some(path) = asked {
            option.clone_from(path);
        }
    }
    if !options.files.is_empty() && arguments.checkpoints.is_none() {
        options.checkpoints = options.out.with_extension("checkpoints");
    }
    options.seed = arguments.seed.unwrap_or(options.seed);
    options.steps = arguments.steps.unwrap_or(options.steps);
    options.workers = arguments.workers.unwrap_or(options.workers);
    Ok(options)
}

/// A recipe's options.
pub(super) fn recipe(name: &str) -> Result<TrainOptions, Failure> {
    trainer::recipe(name).ok_or_else(|| {
        let known = trainer::RECIPES.join(", ");
        Failure::Usage(format!("unknown recipe \"{name}\": expected one of {known}"))
    })
}

/// The options changed by a preset.
pub(super) fn with_preset(options: TrainOptions, name: &str) -> Result<TrainOptions, Failure> {
    options.with_preset(name).ok_or_else(|| {
        let known = trainer::PRESETS.join(", ");
        Failure::Usage(format!("unknown preset \"{name}\": expected one of {known}"))
    })
}

/// The options with one of them set by `option.part=value`. The value is JSON, or else a string.
pub(super) fn changed(options: &TrainOptions, set: &str) -> Result<TrainOptions, Failure> {
    let refused = |reason: &dyn std::fmt::Display| Failure::Usage(format!("--set {set}: {reason}"));
    let (option, value) = set.split_once('=').ok_or_else(|| refused(&"expected OPTION=VALUE"))?;
    let mut all = serde_json::to_value(options).map_err(Failure::data)?;
    let mut place = &mut all;
    for part in option.split('.') {
        place = place.get_mut(part).ok_or_else(|| refused(&format!("there is no option \"{part}\"")))?;
    }
    *place = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    serde_json::from_value(all).map_err(|error| refused(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_option_can_be_set_and_no_other() {
        let options = TrainOptions::default();
        let changed_to = |set: &str| changed(&options, set).map_err(|failure| failure.to_string());
        let steps = changed_to("steps=7").map(|options| options.steps);
        assert_eq!(steps, Ok(7));
        let stem = changed_to("model.stem=imagenet").map(|options| options.model.stem);
        assert!(stem.is_ok_and(|stem| stem != options.model.stem));
        for (value, paths) in [("a", &["a"][..]), ("[\"a\",\"b\"]", &["a", "b"]), ("null", &[])] {
            let set = format!("begin_with={value}");
            let begin_with = changed_to(&set).map(|options| options.begin_with);
            assert_eq!(begin_with, Ok(paths.iter().map(PathBuf::from).collect()));
        }
        for (set, reason) in [
            ("begin_with=3", "a path or a list of paths"),
            ("steps", "OPTION=VALUE"),
            ("model.nonsense=1", "no option \"nonsense\""),
            ("steps=many", "invalid type"),
        ] {
            let refused = changed_to(set).expect_err(set);
            assert!(refused.contains(reason) && refused.contains(set), "{refused}");
        }
    }
}
