//! The pipeline and the arguments of a specification's run.

use std::path::Path;
use std::process::{Command, Stdio};

use configuration::Pipeline;
use configuration::pipeline_file;
use configuration::stages::declared;
use console::failure::Failure;
use run::injected_name;

use crate::spec::Spec;

/// Formats the points at which stages kill themselves, for their environment variable.
pub fn points(spec: &Spec) -> String {
    let mut points: Vec<(u64, String)> = Vec::new();
    for (stage, point, ticks) in &spec.faults.points {
        let entry = |tick: &u64| (*tick, format!("{}:{}@{tick}", stage.name(), point.name()));
        points.extend(ticks.iter().map(entry));
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
    for (stage, command) in &spec.faults.commands {
        let is_it = |table: &&mut &mut toml::Table| {
            table.get("name").and_then(toml::Value::as_str) == Some(stage.name())
        };
        if let Some(table) = stages.iter_mut().find(is_it) {
            table.insert("command".to_owned(), command.clone().into());
        }
    }
    toml::to_string(&pipeline).map_err(Failure::config)
}

#[cfg(test)]
mod tests {
    use wire::StageId;

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
        let declared = configuration::stages::declared();
        let pipeline =
            configuration::Pipeline::parse("a.toml", &pipeline(&spec).unwrap(), &declared).unwrap();
        let stage = |id| pipeline.stages.iter().find(|stage| stage.id == id).unwrap();
        assert_eq!(stage(StageId::Tracker).topics["tracks"], "tracks-injected");
        assert!(stage(StageId::Localiser).topics.is_empty());
        assert_eq!(stage(StageId::Encoder).command.as_deref(), Some(&["/nowhere".to_owned()][..]));
    }
}
