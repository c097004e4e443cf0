use std::fmt;

use crate::Message;

/// Adds messages for other tools to a recording.
pub trait View: fmt::Debug + Send {
    /// The profile of the file.
    fn profile(&self) -> &'static str;

    /// The channels.
    fn channels(&self) -> Vec<ViewChannel>;

    /// Takes a message of the recording. `output` receives the messages that follow from it, each with the
    /// place of its channel in [`View::channels`].
    fn add(&mut self, message: &Message, output: &mut dyn FnMut(u16, &[u8]));
}

/// A channel of a [`View`].
#[derive(Clone, Debug)]
pub struct ViewChannel {
    /// The topic.
    pub topic: &'static str,
    /// Encoding of the messages.
    pub encoding: &'static str,
    /// Name of the schema.
    pub schema: &'static str,
    /// Encoding of the schema.
    pub schema_encoding: &'static str,
    /// The schema.
    pub schema_data: Vec<u8>,
    /// Names and values for readers.
    pub metadata: Vec<(&'static str, String)>,
}
