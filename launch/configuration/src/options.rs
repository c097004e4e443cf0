//! The options of all stages: pipeline.toml with the overrides of the command line.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::pipeline::{Pipeline, Stage};
use console::failure::Failure;
use run::options::OptionSchema;
use run::{Declaration, Declared, OptionError, StageRun};
use serde::de::DeserializeOwned;
use thiserror::Error;
use toml::{Table, Value};
use wire::StageId;

use crate::stages;

/// A setting of the command line: one option of one stage.
#[derive(Clone, Debug)]
pub struct Setting {
    stage: StageId,
    option: String,
    value: Given,
    /// The arguments that it was written as.
    written: String,
}

/// The value of a setting.
#[derive(Clone, Debug)]
enum Given {
    /// Text, as a user writes it.
    Written(String),
    /// A value.
    Value(Value),
    /// The default, even if the file has another value.
    Default,
}

/// Text that is not a setting.
#[derive(Debug, Error)]
pub enum SettingError {
    /// It does not have the form of one.
    #[error("expected STAGE.OPTION=VALUE, as in tracker.fov=90,80")]
    Form,
    /// No stage has that name.
    #[error("there is no stage \"{0}\": expected one of {known}", known = StageId::ALL.map(StageId::name).join(", "))]
    Stage(String),
}

impl FromStr for Setting {
    type Err = SettingError;

    fn from_str(text: &str) -> Result<Self, SettingError> {
        let (place, value) = text.split_once('=').ok_or(SettingError::Form)?;
        let (stage, option) = place.split_once('.').ok_or(SettingError::Form)?;
        let (stage, option) = (stage.trim(), option.trim().to_owned());
        let stage = StageId::from_name(stage).ok_or_else(|| SettingError::Stage(stage.to_owned()))?;
        Ok(Self {
            stage,
            option,
            value: Given::Written(value.trim().to_owned()),
            written: format!("--set {text}"),
        })
    }
}

impl Setting {
    /// The setting of a flag.
    pub fn of_flag(flag: &str, stage: StageId, option: &str, value: impl Into<Value>) -> Self {
        let value = value.into();
        let written = match &value {
            Value::Boolean(_) => flag.to_owned(),
            Value::String(text) => format!("{flag} {text}"),
            other => format!("{flag} {other}"),
        };
        Self { stage, option: option.to_owned(), value: Given::Value(value), written }
    }

    /// The setting of a flag that resets an option to its default.
    pub fn unset(flag: &str, stage: StageId, option: &str) -> Self {
        Self { stage, option: option.to_owned(), value: Given::Default, written: flag.to_owned() }
    }

    /// Its arguments on a command line.
    pub fn arguments(&self) -> impl Iterator<Item = &str> {
        self.written.splitn(2, ' ')
    }

    /// Whether it sets that option.
    pub fn is_of(&self, stage: StageId, option: &str) -> bool {
        self.stage == stage && self.option == option
    }

    /// The failure of a setting that can't be used.
    pub fn refused(&self, why: impl fmt::Display) -> Failure {
        Failure::Usage(format!("{}: {why}", self.written))
    }
}

/// The options of one stage.
#[derive(Clone, Debug)]
struct Options {
    /// Declaration of the built-in stage; `None` for an external program, whose options are not known here.
    declared: Option<&'static dyn Declared>,
    table: Table,
    /// Where each option is set, for the errors of external programs.
    places: BTreeMap<String, String>,
}

/// The options of all stages of a pipeline.
#[derive(Clone, Debug)]
pub struct StageOptions(BTreeMap<StageId, Options>);

impl StageOptions {
    /// The options in a pipeline.toml.
    pub fn of_pipeline(pipeline: &Pipeline) -> Self {
        let of_stage = |stage: &Stage| {
            let built_in = stages::built_in(stage.id).filter(|_| stage.command.is_none());
            let declared = built_in.map(|built_in| built_in.declared);
            let (table, places) = (stage.options.clone(), stage.places.clone());
            (stage.id, Options { declared, table, places })
        };
        Self(pipeline.stages.iter().map(of_stage).collect())
    }

    /// The defaults of these built-in stages.
    pub fn defaults(ids: &[StageId]) -> Self {
        let of_stage = |id: &StageId| {
            let declared = stages::built_in(*id).map(|built_in| built_in.declared);
            (*id, Options { declared, table: Table::new(), places: BTreeMap::new() })
        };
        Self(ids.iter().map(of_stage).collect())
    }

    /// Applies settings in their order. Paths become absolute, as stages may run in other folders.
    pub fn apply(&mut self, settings: &[Setting]) -> Result<(), Failure> {
        for setting in settings {
            self.apply_one(setting)?;
        }
        for (id, options) in &mut self.0 {
            let Some(declared) = options.declared else { continue };
            let refused = |error: OptionError| {
                let of_key = |setting: &&Setting| error.key().is_some_and(|key| setting.is_of(*id, key));
                let of_stage = |setting: &&Setting| setting.stage == *id;
                let setting = settings.iter().rfind(of_key).or_else(|| settings.iter().rfind(of_stage));
                let why = format!("{error}: {}", error.advice());
                setting.map_or_else(|| Failure::config(why.as_str()), |setting| setting.refused(&why))
            };
            declared.check(&options.table).map_err(refused)?;
            for option in declared.schema().iter().filter(|option| option.is_path) {
                if let Some(Value::String(path)) = options.table.get_mut(&option.name) {
                    *path = text(&absolute(Path::new(path))?)?;
                }
            }
        }
        self.check_precision(settings)
    }

    /// Refuses a precision that this process can't compute in, before a stage would.
    fn check_precision(&self, settings: &[Setting]) -> Result<(), Failure> {
        let Err(why) = self.read(&decoder::STAGE)?.precision.check() else { return Ok(()) };
        let setting = settings.iter().rfind(|setting| setting.is_of(StageId::Decoder, "precision"));
        let about = setting.map_or("precision of the decoder", |setting| setting.written.as_str());
        Err(Failure::config_about(about, why))
    }

    fn apply_one(&mut self, setting: &Setting) -> Result<(), Failure> {
        let stage = setting.stage.name();
        let Some(Options { declared, table, places }) = self.0.get_mut(&setting.stage) else {
            return Err(setting.refused(format!("there is no {stage} here")));
        };
        let schema = declared.map(|declared| declared.schema());
        let key = setting.option.clone();
        let value = match &setting.value {
            Given::Written(text) => value(text, schema.as_ref().and_then(|schema| schema.get(&key))),
            Given::Value(value) => value.clone(),
            Given::Default => {
                table.remove(&key);
                return Ok(());
            }
        };
        // Checked separately, so the error names this setting.
        if let Some(declared) = declared {
            match declared.check(&Table::from_iter([(key.clone(), value.clone())])) {
                Ok(()) | Err(OptionError::Conflict(_)) => {}
                Err(error) => return Err(setting.refused(format!("{error}: {}", error.advice()))),
            }
        }
        places.insert(key.clone(), setting.written.clone());
        table.insert(key, value);
        Ok(())
    }

    /// Whether a stage is built in.
    pub fn is_built_in(&self, id: StageId) -> bool {
        self.0.get(&id).is_some_and(|options| options.declared.is_some())
    }

    /// The value of an option, if it is set.
    pub fn get(&self, id: StageId, option: &str) -> Option<&Value> {
        self.0.get(&id)?.table.get(option)
    }

    /// Sets an option to a path.
    pub fn set_path(&mut self, id: StageId, option: &str, path: &Path) -> Result<(), Failure> {
        let path = text(path)?;
        if let Some(options) = self.0.get_mut(&id) {
            options.table.insert(option.to_owned(), Value::String(path));
        }
        Ok(())
    }

    /// A stage's options as its struct. Defaults if the stage is missing or an external program.
    pub fn read<O: Default + DeserializeOwned>(&self, declaration: &Declaration<O>) -> Result<O, Failure> {
        let options = self.0.get(&declaration.id()).filter(|options| options.declared.is_some());
        let Some(Options { table, .. }) = options else { return Ok(O::default()) };
        Value::Table(table.clone()).try_into().map_err(Failure::config)
    }

    /// The stages of a run record, with their options and without budgets.
    pub fn stage_runs(&self) -> Vec<StageRun> {
        let of_stage = |(id, options): (&StageId, &Options)| StageRun {
            stage: id.number(),
            budget_ms: None,
            built_in: options.declared.is_some(),
            options: options.table.to_string(),
            name: if id.is_added() { id.name().to_owned() } else { String::new() },
            program: String::new(),
            places: options.places.clone(),
            reads: Vec::new(),
            writes: Vec::new(),
        };
        self.0.iter().map(of_stage).collect()
    }
}

/// Parses a value of the command line as TOML, or else as text. If the option takes only text, the value is
/// always text.
pub fn value(written: &str, option: Option<&OptionSchema>) -> Value {
    let parsed = format!("value = {written}").parse::<Table>().ok();
    let parsed = parsed.filter(|table| table.len() == 1).and_then(|mut table| table.remove("value"));
    let takes_text = option.is_some_and(|option| option.is_text);
    match parsed {
        Some(value) if !takes_text || value.is_str() => value,
        _ => Value::String(written.to_owned()),
    }
}

/// Absolute path of a file that may not exist.
pub fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|error| Failure::file(path, error))
}

/// A path as the value of an option.
pub fn text(path: &Path) -> Result<String, Failure> {
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| Failure::Usage(format!("{}: a path must be UTF-8 to be an option", path.display())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline_file::SHIPPED;

    /// The options after these settings, or the error.
    fn applied(pipeline: &str, settings: &[&str]) -> Result<StageOptions, String> {
        let pipeline = Pipeline::parse("p.toml", pipeline, &stages::declared()).expect("a good file");
        let mut options = StageOptions::of_pipeline(&pipeline);
        let settings: Result<Vec<Setting>, _> = settings.iter().map(|text| text.parse()).collect();
        options
            .apply(&settings.map_err(|error| error.to_string())?)
            .map_err(|failure| failure.to_string())?;
        Ok(options)
    }

    /// The shipped pipeline with other options of the sampler.
    fn with_sampler(options: &str) -> String {
        assert!(SHIPPED.contains("{ deadline_ms = 72 }"));
        SHIPPED.replace("{ deadline_ms = 72 }", options)
    }

    #[test]
    fn settings_override_the_file_and_the_file_the_defaults() {
        let file = with_sampler("{ deadline_ms = 40, particles = 8 }");
        let sampler = |settings: &[&str]| {
            let options = applied(&file, settings)?.read(&sampler::STAGE).map_err(|e| e.to_string())?;
            Ok::<_, String>((options.deadline_ms, options.particles, options.retrieval))
        };
        assert_eq!(sampler(&[]), Ok((40.0, 8, true)));
        assert_eq!(sampler(&["sampler.deadline_ms=30"]), Ok((30.0, 8, true)));
        assert_eq!(
            sampler(&["sampler.deadline_ms=30", "sampler.retrieval = false", "sampler.deadline_ms=31.5"]),
            Ok((31.5, 8, false)),
            "the last one counts"
        );
    }

    #[test]
    fn values_are_toml_or_else_text() {
        let options = applied(
            SHIPPED,
            &[
                "tracker.fov=90,80",
                "tracker.prior=kinematic",
                "tracker.associate=true",
                "sampler.memory=2024",
            ],
        )
        .unwrap();
        let tracker = options.read(&tracker::STAGE).unwrap();
        assert_eq!(tracker.fov, Some(tracker::FieldOfView { width_deg: 90.0, range_m: 80.0 }));
        assert_eq!((tracker.prior, tracker.associate), (tracker::Prior::Kinematic, true));
        let memory = options.read(&sampler::STAGE).unwrap().memory.unwrap();
        assert!(memory.is_absolute() && memory.ends_with("2024"), "text, whatever it looks like: {memory:?}");
        let quoted = applied(SHIPPED, &["localiser.map=\"none\""]).unwrap();
        assert_eq!(quoted.read(&localiser::STAGE).unwrap().map, localiser::MapChoice::None);
    }

    #[test]
    fn refused_settings_are_quoted_with_the_reason() {
        let cases = [
            ("tracker.fov", "expected STAGE.OPTION=VALUE"),
            ("fov=90,80", "expected STAGE.OPTION=VALUE"),
            ("radar.fov=90,80", "there is no stage \"radar\": expected one of source, tracker"),
            (
                "tracker.view_deg=90",
                "--set tracker.view_deg=90: the tracker has no option `view_deg`: its options are associate, association, cyclist_speed_max_mps, fov, frozen_frames, pedestrian_speed_max_mps, prior, vehicle_speed_max_mps",
            ),
            (
                "tracker.fov=90",
                "--set tracker.fov=90: `fov` of the tracker: no field of view \"90\": expected WIDTH,RANGE",
            ),
            (
                "sampler.deadline_ms=95",
                "--set sampler.deadline_ms=95: `deadline_ms` is out of range: expected more than 0 and at most 80",
            ),
            (
                "sampler.deadline_ms=soon",
                "--set sampler.deadline_ms=soon: `deadline_ms` of the sampler: invalid type: string",
            ),
            ("extractor.workers=0", "`workers` is out of range: expected 1 to 64"),
            ("source.agents=129", "`agents` is out of range: expected 1 to 128"),
            ("source.format=xml", "unknown format \"xml\""),
            ("source.fps=0.05", "`fps` is out of range: expected 0.1 to 1000"),
            ("source.fps=fast", "--set source.fps=fast: `fps` of the source: invalid type: string"),
            ("tracker.association=guess", "expected assignment or jpda"),
        ];
        for (setting, message) in cases {
            let refused = applied(SHIPPED, &[setting]).expect_err(setting);
            assert!(refused.contains(message), "{setting}: {refused}");
        }
    }

    #[test]
    fn conflicting_options_are_refused_from_any_source() {
        let message = "a memory that nothing is to be retrieved from: `retrieval` is false";
        let file = with_sampler("{ memory = \"a\" }");
        for (file, settings) in [
            (SHIPPED, &["sampler.memory=a", "sampler.retrieval=false"][..]),
            (SHIPPED, &["sampler.retrieval=false", "sampler.memory=a"]),
            (&file, &["sampler.retrieval=false"]),
        ] {
            let refused = applied(file, settings).expect_err("both");
            assert!(refused.contains(message), "{refused}");
        }
        let turned_on = with_sampler("{ retrieval = false }");
        assert!(applied(&turned_on, &["sampler.memory=a", "sampler.retrieval=true"]).is_ok());
    }

    #[test]
    fn options_of_external_programs_are_passed_on_unchecked() {
        let file = SHIPPED.replace("name = \"encoder\"", "name = \"encoder\"\ncommand = [\"./mine\"]");
        let options = applied(&file, &["encoder.gain=[1, 2]", "encoder.mode=fast"]).unwrap();
        assert_eq!(options.get(StageId::Encoder, "mode"), Some(&Value::String("fast".into())));
        let runs = options.stage_runs();
        let encoder = runs.iter().find(|run| run.stage == StageId::Encoder.number()).unwrap();
        assert_eq!(encoder.options, "gain = [1, 2]\nmode = \"fast\"\n");
        assert!(!encoder.built_in);
        assert_eq!(encoder.places["mode"], "--set encoder.mode=fast");
    }
}
