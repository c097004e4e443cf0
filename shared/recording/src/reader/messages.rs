//! The messages of a file in the order of their times, for any order of the parts in the file.

use std::collections::{BTreeMap, VecDeque};

use mcap::records::{self, Record, op};

use super::Recording;
use super::chunk::record;
use super::parts::{Channel, Part, channel};
use crate::{Frame, Message, ReadError};

/// The messages of a recording, read part by part.
#[derive(Debug)]
pub struct Messages<'a> {
    recording: &'a Recording,
    channels: BTreeMap<u16, Channel>,
    next: usize,
    /// Messages that are already read, with their times.
    ready: VecDeque<(u64, Result<Message, ReadError>)>,
}

impl<'a> Messages<'a> {
    pub(super) fn new(recording: &'a Recording) -> Self {
        Self { recording, channels: recording.channels.clone(), next: 0, ready: VecDeque::new() }
    }

    /// Reads the messages of a part.
    fn read(&mut self, part: &Part) {
        let damaged = |what| self.recording.damaged(part.at, what);
        let bytes = match self.recording.content(part) {
            Ok(Ok(bytes)) => bytes,
            Ok(Err(what)) => return self.ready.push_back((part.begin_ns, Err(damaged(what)))),
            Err(error) => return self.ready.push_back((part.begin_ns, Err(error))),
        };
        let (mut rest, mut number, mut at_ns) = (&bytes[..], 0, part.begin_ns);
        while !rest.is_empty() {
            let Some((op, body)) = record(&mut rest) else {
                let what = format!("message {number} of the part is cut short");
                return self.ready.push_back((at_ns, Err(damaged(what))));
            };
            if let Some(channel) = channel(op, body) {
                self.channels.insert(channel.id, Channel::of(&channel, self.recording.about()));
            } else if op == op::MESSAGE {
                let message = match mcap::parse_record(op, body) {
                    Ok(Record::Message { header, data }) => {
                        at_ns = header.log_time;
                        self.message(part, number, &header, &data)
                    }
                    _ => Some(Err(damaged(format!("message {number} of the part is cut short")))),
                };
                self.ready.extend(message.map(|message| (at_ns, message)));
                number += 1;
            }
        }
    }

    /// A message; `None` if it belongs to another program.
    fn message(
        &self,
        part: &Part,
        number: usize,
        header: &records::MessageHeader,
        data: &[u8],
    ) -> Option<Result<Message, ReadError>> {
        let wrong = |what: String| {
            let what = format!("message {number} of the part: {what}");
            self.recording.damaged(part.at, what)
        };
        let json = |error: serde_json::Error| wrong(error.to_string());
        let id = header.channel_id;
        let (topic, element_bytes, wrap): (_, _, fn(Frame) -> Message) = match self.channels.get(&id) {
            Some(Channel::Foreign) => return None,
            Some(Channel::Events) => {
                return Some(serde_json::from_slice(data).map(Message::Event).map_err(json));
            }
            Some(Channel::Log) => return Some(serde_json::from_slice(data).map(Message::Line).map_err(json)),
            Some(Channel::Topic(topic, bytes)) => (*topic, *bytes, Message::Frame),
            Some(Channel::Before(topic, bytes)) => (*topic, *bytes, Message::Before),
            None => return Some(Err(wrong(format!("channel {id} is not in the file")))),
        };
        let offset_ns = self.recording.about().clock_offset_ns;
        let received_ns = header.log_time.saturating_add_signed(-offset_ns);
        let frame = Frame::read_leading(topic, element_bytes, data.into(), received_ns);
        Some(frame.map(wrap).map_err(|source| ReadError::Frame {
            path: self.recording.path().to_owned(),
            offset: part.at,
            message: number,
            source,
        }))
    }
}

impl Iterator for Messages<'_> {
    type Item = Result<Message, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        // Parts that start before the next message may contain earlier ones.
        while let Some(part) = self.recording.parts.get(self.next)
            && self.ready.front().is_none_or(|(at_ns, _)| part.begin_ns <= *at_ns)
        {
            self.next += 1;
            self.read(part);
            // Messages of equal times keep the order of the file.
            self.ready.make_contiguous().sort_by_key(|(at_ns, _)| *at_ns);
        }
        self.ready.pop_front().map(|(_, message)| message)
    }
}
