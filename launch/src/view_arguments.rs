//! Messages in a recording for other tools.

use std::path::Path;
use std::process::Command;

use clap::Args;
use interop::{Target, ViewOptions};
use recording::{About, View, WriteError, Writer};
use wire::{ForecastsTopic, MODES_MAX, Topic as _, TracksTopic};

use crate::arguments::map_of;
use crate::verbs::wire::layout;

/// The tools that a recording also holds messages for.
#[derive(Clone, Debug, Default, Args)]
pub struct ViewArguments {
    /// Add messages for these tools: `foxglove` (scene, transforms and log in protobuf) and `autoware` (tracked and
    /// predicted objects, tf and diagnostics in CDR)
    #[arg(long = "for", value_name = "TOOLS", value_delimiter = ',')]
    targets: Vec<Target>,
    /// Number of paths of each agent in these messages, the most probable first
    #[arg(long, value_name = "N", requires = "targets", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=MODES_MAX as i64))]
    paths: u16,
    /// Leave out Autoware's predicted objects if their forecasts are older than this, ms. Held forecasts
    /// count too
    #[arg(long = "max-age", value_name = "MS", requires = "targets")]
    max_age_ms: Option<u32>,
}

impl ViewArguments {
    /// Whether a recording holds messages for no other tool.
    pub fn is_empty(&self) -> bool {
        self.targets.is_empty()
    }

    /// Whether the tools of ROS read the messages.
    pub fn is_for_ros(&self) -> bool {
        self.targets.contains(&Target::Autoware)
    }

    /// The topics that the messages are made of, besides `names`.
    pub fn add_topics(&self, names: &mut Vec<String>) {
        for needed in [TracksTopic::NAME, ForecastsTopic::NAME] {
            if !self.is_empty() && !names.iter().any(|name| name == needed) {
                names.push(needed.to_owned());
            }
        }
    }

    /// Creates a recording with these messages.
    pub fn create(&self, file: &Path, about: &About) -> Result<Writer, WriteError> {
        Writer::with_view(file, about, &layout(), self.view(about))
    }

    fn view(&self, about: &About) -> Option<Box<dyn View>> {
        let max_age_ns = self.max_age_ms.map(|age_ms| u64::from(age_ms) * 1_000_000);
        let map = map_of(&about.run).unwrap_or_else(|failure| {
            tracing::warn!("{failure}: the messages have no map");
            None
        });
        let map = map.filter(|_| self.targets.contains(&Target::Foxglove));
        let paths_max = self.paths.into();
        interop::views(ViewOptions { targets: &self.targets, paths_max, max_age_ns, map }, about)
    }

    /// Passes the same arguments to a recording in its own process.
    pub fn pass_on(&self, command: &mut Command) {
        for target in &self.targets {
            command.args(["--for", target.name()]);
        }
        if !self.is_empty() {
            command.arg("--paths").arg(self.paths.to_string());
        }
        if let Some(age_ms) = self.max_age_ms {
            command.arg("--max-age").arg(age_ms.to_string());
        }
    }
}
