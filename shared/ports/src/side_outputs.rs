//! Added stages whose output no forecast waits for.

use run::Run;
use wire::Header;

use crate::{Node, PortError, RawSubscriber, RawTopic};

/// Reads the headers of added stages whose output no forecast waits for: the forecasts' headers do not
/// contain their hops.
#[derive(Debug)]
pub struct SideOutputs(Vec<RawSubscriber>);

impl SideOutputs {
    /// Opens one output topic of each of these stages.
    ///
    /// # Errors
    /// As [`Node::raw_subscriber`].
    pub fn open(node: &Node, run: &Run) -> Result<Self, PortError> {
        let stages = run.side_stages();
        let stages = stages.iter().filter_map(|stage| run.stage(*stage));
        let names = stages.filter_map(|stage| stage.writes.iter().find(|name| run.topic(name).is_some()));
        let topics = names.filter_map(|name| RawTopic::of(run, name));
        topics.map(|topic| node.raw_subscriber(&topic)).collect::<Result<_, _>>().map(Self)
    }

    /// The headers that have arrived, unchecked.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn take(&self) -> Result<Vec<Header>, PortError> {
        let mut headers = Vec::new();
        for topic in &self.0 {
            topic.drain()?;
            while let Some(frame) = topic.receive()? {
                headers.push(*frame.header());
            }
        }
        Ok(headers)
    }
}
