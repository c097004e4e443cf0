//! What a specification asks for: the pipeline and the arguments of its run, and the actions during the run.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use ports::{POINTS_VARIABLE, Point};
use run::injected_name;
use wire::StageId;

use crate::config::Pipeline;
use crate::failure::Failure;
use crate::faults::effect::Random;
use crate::faults::spec::{Fault, Resource, Spec, Target, When};
use crate::pipeline_file;
use crate::program;
use crate::stages::declared;

/// An action on a process at a given time.
#[derive(Clone, Debug)]
pub struct Action {
    /// The time.
    pub at: Due,
    /// The action.
    pub what: What,
}

/// The time of an action.
#[derive(Clone, Copy, Debug)]
pub enum Due {
    /// A tick.
    Tick(u64),
    /// A time after the start of a process.
    AfterStart(Target, Duration),
}

/// What is done to a process.
#[derive(Clone, Debug)]
pub enum What {
    /// SIGKILL.
    Kill(Target),
    /// SIGSTOP, and SIGCONT after a time.
    Stop(Target, Duration),
    /// A limit of a resource.
    Limit(StageId, Resource, u64),
    /// Threads that only use the CPU, for a time.
    Cpu(usize, Duration),
    /// A replacement by this program; empty for the built-in one.
    Replace(StageId, Vec<String>),
}

/// Lists the actions at ticks and times.
pub fn actions(spec: &Spec) -> Result<Vec<Action>, Failure> {
    let mut actions = Vec::new();
    for fault in &spec.faults {
        let mut at = |at, what| actions.push(Action { at, what });
        match fault {
            Fault::Kill { target, when: When::Ticks(ticks) } => {
                ticks.iter().for_each(|tick| at(Due::Tick(*tick), What::Kill(*target)));
            }
            Fault::Kill { target, when: When::AfterStart { ms } } => {
                at(Due::AfterStart(*target, Duration::from_millis(*ms)), What::Kill(*target));
            }
            Fault::Kill { target, when: When::Within { ms: [shortest, longest] } } => {
                let ms = shortest + Random::new(spec.run.seed, 0).below(longest - shortest + 1);
                at(Due::AfterStart(*target, Duration::from_millis(ms)), What::Kill(*target));
            }
            Fault::Random { stages, ticks: [first, last], count, stop_ms } => {
                for place in 0..*count {
                    let mut random = Random::new(spec.run.seed, place);
                    let target = Target::Stage(stages[random.below(stages.len() as u64) as usize]);
                    let what = match stop_ms {
                        Some(ms) => What::Stop(target, Duration::from_millis(*ms)),
                        None => What::Kill(target),
                    };
                    at(Due::Tick(first + random.below(last - first + 1)), what);
                }
            }
            Fault::Stop { target, ticks, for_ms } => {
                let time = Duration::from_millis(*for_ms);
                ticks.iter().for_each(|tick| at(Due::Tick(*tick), What::Stop(*target, time)));
            }
            Fault::Limit { stage, tick, resource, value } => {
                at(Due::Tick(*tick), What::Limit(*stage, *resource, *value));
            }
            Fault::CrashLoop { stage, tick, .. } => at(Due::Tick(*tick), What::Kill(Target::Stage(*stage))),
            Fault::Replace { stage, ticks, command, point } => {
                let command = match point {
                    Some(point) => dying(*stage, *point)?,
                    None => command.clone().unwrap_or_default(),
                };
                ticks.iter().for_each(|tick| at(Due::Tick(*tick), What::Replace(*stage, command.clone())));
            }
            Fault::Cpu { tick, for_ms, threads } => {
                at(Due::Tick(*tick), What::Cpu(*threads, Duration::from_millis(*for_ms)));
            }
            Fault::KillAt { .. } | Fault::Command { .. } | Fault::Topic(_) | Fault::Consumer { .. } => {}
        }
    }
    Ok(actions)
}

/// Formats the points at which stages kill themselves, for their environment variable.
pub fn points(spec: &Spec) -> String {
    let mut points: Vec<(u64, String)> = Vec::new();
    for fault in &spec.faults {
        if let Fault::KillAt { stage, point, ticks } = fault {
            let entry = |tick: &u64| (*tick, format!("{}:{}@{tick}", stage.name(), point.name()));
            points.extend(ticks.iter().map(entry));
        }
    }
    points.sort();
    let entries: Vec<String> = points.into_iter().map(|(_, entry)| entry).collect();
    entries.join(",")
}

/// The arguments of `stgdat run`.
pub fn arguments(command: &mut Command, spec: &Spec, folder: &Path) {
    let run = &spec.run;
    let forecasts = run.forecasts.clone().unwrap_or_else(|| folder.join("forecasts.jsonl"));
    command.arg("run").arg("--quiet").stdin(Stdio::null());
    command
        .arg("--pipeline")
        .arg(folder.join("pipeline.toml"))
        .arg("--announce")
        .arg(folder.join("announce"));
    command.arg("--report").arg(folder.join("report.json")).arg("--forecasts").arg(forecasts);
    command.arg("--ticks").arg(run.ticks.to_string()).arg("--seed").arg(run.seed.to_string());
    if let Some(agents) = run.agents {
        command.arg("--agents").arg(agents.to_string());
    }
    if let Some(recording) = &run.recording {
        command.arg("--recording").arg(recording);
    }
    command.args(&run.arguments);
}

/// Returns the run's pipeline. Topics with an injector get other names, and faults may replace programs.
pub fn pipeline(spec: &Spec) -> Result<String, Failure> {
    let text = match &spec.run.pipeline {
        Some(path) => {
            std::fs::read_to_string(path).map_err(|error| Failure::config_about(path.display(), error))?
        }
        None => pipeline_file::SHIPPED.to_owned(),
    };
    let name = spec.run.pipeline.as_ref().map_or_else(String::new, |path| path.display().to_string());
    let parsed = Pipeline::parse(&name, &text, &declared())?;
    let mut pipeline: toml::Table = toml::from_str(&text).map_err(Failure::config)?;
    if let Some(topics) = &spec.run.protect {
        pipeline.insert("protect".to_owned(), topics.clone().into());
    }
    let mut stages: Vec<&mut toml::Table> = pipeline
        .get_mut("stage")
        .and_then(toml::Value::as_array_mut)
        .into_iter()
        .flatten()
        .filter_map(toml::Value::as_table_mut)
        .collect();
    for table in &mut stages {
        let name = table.get("name").and_then(toml::Value::as_str);
        if let Some(keys) = name.and_then(|name| spec.run.stages.get(name)) {
            table.extend(keys.clone());
        }
    }
    for topic in spec.injected_topics() {
        let Some((writer, own)) = parsed.writer(topic) else { continue };
        let is_writer = |table: &&mut &mut toml::Table| {
            table.get("name").and_then(toml::Value::as_str) == Some(writer.name.as_str())
        };
        if let Some(table) = stages.iter_mut().find(is_writer) {
            let topics = table.entry("topics").or_insert_with(|| toml::Table::new().into());
            if let Some(topics) = topics.as_table_mut() {
                topics.insert(own.to_owned(), injected_name(topic).into());
            }
        }
    }
    for fault in &spec.faults {
        let (stage, command) = match fault {
            Fault::Command { stage, command } => (*stage, command.clone()),
            Fault::CrashLoop { stage, exit_code, .. } => (*stage, crashing(*stage, *exit_code)?),
            _ => continue,
        };
        let is_it = |table: &&mut &mut toml::Table| {
            table.get("name").and_then(toml::Value::as_str) == Some(stage.name())
        };
        if let Some(table) = stages.iter_mut().find(is_it) {
            table.insert("command".to_owned(), command.into());
        }
    }
    toml::to_string(&pipeline).map_err(Failure::config)
}

/// Returns a command whose first process is the stage and whose later processes end immediately.
fn crashing(stage: StageId, exit_code: u8) -> Result<Vec<String>, Failure> {
    let this = program::this_program();
    let words =
        format!("test $STGDAT_INCARNATION = 0 || exit {exit_code}; exec \"$0\" stage {}", stage.name());
    Ok(vec!["sh".to_owned(), "-c".to_owned(), words, this.display().to_string()])
}

/// Returns the built-in stage as a command that kills itself at a point of its first step, in any
/// incarnation.
fn dying(stage: StageId, point: Point) -> Result<Vec<String>, Failure> {
    let this = program::this_program();
    let (stage, point) = (stage.name(), point.name());
    let words = format!(
        "for i in $(seq 0 $STGDAT_INCARNATION); do p=${{p}}{stage}:{point}@0,; done; export {POINTS_VARIABLE}=$p; \
         exec \"$0\" stage {stage}"
    );
    Ok(vec!["sh".to_owned(), "-c".to_owned(), words, this.display().to_string()])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec(faults: &str) -> Spec {
        let text = format!("shows = \"a test\"\n[run]\nticks = 90\n{faults}");
        Spec::parse(Path::new("a.toml"), &text).unwrap()
    }

    #[test]
    fn points_of_all_faults_are_in_the_order_of_their_ticks() {
        let spec = spec(
            "[[fault]]\nkind = \"kill\"\nstage = \"decoder\"\npoint = \"idle\"\nat = [40, 80]\n\
             [[fault]]\nkind = \"kill\"\nstage = \"decoder\"\npoint = \"mid-write\"\nat = 60",
        );
        assert_eq!(points(&spec), "decoder:idle@40,decoder:mid-write@60,decoder:idle@80");
    }

    #[test]
    fn the_writer_of_a_faulty_topic_opens_it_under_another_name() {
        let spec = spec(
            "[[fault]]\nkind = \"drop\"\ntopic = \"tracks\"\nticks = [1, 2]\n\
             [[fault]]\nkind = \"command\"\nstage = \"encoder\"\ncommand = [\"/nowhere\"]",
        );
        let declared = crate::stages::declared();
        let pipeline =
            crate::config::Pipeline::parse("a.toml", &pipeline(&spec).unwrap(), &declared).unwrap();
        let stage = |id| pipeline.stages.iter().find(|stage| stage.id == id).unwrap();
        assert_eq!(stage(StageId::Tracker).topics["tracks"], "tracks-injected");
        assert!(stage(StageId::Localiser).topics.is_empty());
        assert_eq!(stage(StageId::Encoder).command.as_deref(), Some(&["/nowhere".to_owned()][..]));
    }
}
