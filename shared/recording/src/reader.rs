use std::cell::RefCell;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use lz4_flex::frame::FrameDecoder;
use wire::{SCHEMA, TABLE};

use crate::format::{FOOTER, LZ4, MAGIC, PREFIX, Parts, op};
use crate::sink::read_at;
use crate::writer::{BEFORE, BEGIN, END, EVENT_CHANNEL, LOG_CHANNEL, channel_topic};
use crate::{About, Event, Frame, LogLine, ReadError};

/// Largest record that is read into memory: a chunk has one frame more than its limit at most.
const RECORD_MAX: u64 = 1 << 28;
/// Bytes of a file that are checked at a time.
const BLOCK: usize = 1 << 20;

/// A recording that is read.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    file: RefCell<File>,
    about: About,
    channels: Vec<(u16, Channel)>,
    chunks: Vec<Chunk>,
    ending: Ending,
    /// Where the data ends, with the check value of all before it.
    data_end: Option<(u64, u32)>,
    /// Where the summary begins, and the file's length.
    summary: Option<(u64, u64)>,
}

/// How a recording ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// By the recorder's will, with its words.
    Complete {
        /// Why it ended.
        how: String,
        /// Messages that the disk did not take, by topic, as JSON.
        lost_on_disk: String,
    },
    /// In the middle: the recorder was killed, or the disk was full.
    Incomplete {
        /// Where the last whole record ends.
        at: u64,
        /// What is there.
        why: String,
    },
}

/// What a channel holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Channel {
    /// Frames of a topic, with so many bytes of each element.
    Topic(u8, usize),
    /// The same of what was before.
    Before(u8, usize),
    Events,
    Log,
}

/// A chunk's place in the file.
#[derive(Clone, Copy, Debug)]
struct Chunk {
    offset: u64,
    body_len: u64,
}

/// A message of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A frame.
    Frame(Frame),
    /// A frame of what was before the file: its header, and of its elements no more than a replay needs.
    Before(Frame),
    /// Something that happened.
    Event(Event),
    /// A line of a stage's log.
    Line(LogLine),
}

impl Message {
    /// When it was received or happened, `CLOCK_MONOTONIC`.
    #[must_use]
    pub const fn at_ns(&self) -> u64 {
        match self {
            Self::Frame(frame) | Self::Before(frame) => frame.received_ns(),
            Self::Event(event) => event.at_ns,
            Self::Line(line) => line.at_ns,
        }
    }
}

impl Recording {
    /// Opens a file, and finds its chunks; their content is read and checked by [`Recording::messages`].
    ///
    /// # Errors
    /// [`ReadError`] where it is no recording of this program's version.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let failed = |source| ReadError::File { path: path.to_owned(), source };
        let mut file = File::open(path).map_err(failed)?;
        let len = file.metadata().map_err(failed)?.len();
        let magic = MAGIC.len() as u64;
        if len < magic || read_at(&mut file, 0, MAGIC.len()).map_err(failed)? != MAGIC {
            return Err(ReadError::Foreign { path: path.to_owned() });
        }
        let mut recording = Self {
            path: path.to_owned(),
            file: RefCell::new(file),
            about: About::default(),
            channels: vec![],
            chunks: vec![],
            ending: Ending::Incomplete { at: magic, why: String::new() },
            data_end: None,
            summary: None,
        };
        recording.scan(magic, len)?;
        if recording.about.schema != SCHEMA {
            let (found, program) = (recording.about.schema, recording.about.program);
            return Err(ReadError::Schema { path: path.to_owned(), found, expected: SCHEMA, program });
        }
        Ok(recording)
    }

    /// Walks along the records up to the end of the data, or of what is whole.
    fn scan(&mut self, mut at: u64, len: u64) -> Result<(), ReadError> {
        let (mut is_ours, mut ended) = (false, None);
        let why = loop {
            if at + PREFIX as u64 > len {
                break if at == len { "the file ends here, without an index" } else { "part of a record" };
            }
            let prefix = self.bytes(at, PREFIX)?;
            let body_len = u64::from_le_bytes(prefix[1..].try_into().unwrap_or_default());
            let body_at = at + PREFIX as u64;
            if body_at.checked_add(body_len).is_none_or(|end| end > len) {
                break "part of a record";
            }
            if body_len > RECORD_MAX {
                return Err(self.damaged(at, format!("a record of {body_len} bytes")));
            }
            match prefix[0] {
                op::CHUNK => self.chunks.push(Chunk { offset: at, body_len }),
                op::CHANNEL => self.channel(at, body_len)?,
                op::METADATA => {
                    let (name, pairs) = self.metadata(at, body_len)?;
                    if name == BEGIN {
                        self.about = self.read_about(at, &pairs)?;
                        is_ours = true;
                    } else if name == END {
                        ended = Some(pairs);
                    }
                }
                op::DATA_END => {
                    let body = self.bytes(body_at, body_len as usize)?;
                    let value = Parts(&body).u32().ok_or_else(|| self.damaged(at, "a short end".into()))?;
                    self.data_end = Some((at, value));
                    at = body_at + body_len;
                    break "the index is missing or cut off";
                }
                op::HEADER | op::SCHEMA | op::MESSAGE_INDEX => {}
                other => {
                    return Err(self.damaged(
                        at,
                        format!("a record of kind {other:#04x}, which recordings do not have"),
                    ));
                }
            }
            at = body_at + body_len;
        };
        if !is_ours {
            return Err(ReadError::NotOurs { path: self.path.clone(), wanted: BEGIN });
        }
        self.ending = Ending::Incomplete { at, why: why.to_owned() };
        let tail = (FOOTER + MAGIC.len()) as u64;
        if let (Some(pairs), Some(_)) = (ended, self.data_end)
            && len >= at + tail
            && self.bytes(len - MAGIC.len() as u64, MAGIC.len())? == MAGIC
        {
            let of = |key: &str| {
                pairs.iter().find(|(name, _)| name == key).map(|(_, v)| v.clone()).unwrap_or_default()
            };
            self.ending = Ending::Complete { how: of("ended"), lost_on_disk: of("lost_on_disk") };
            self.summary = Some((at, len));
        }
        Ok(())
    }

    fn channel(&mut self, at: u64, body_len: u64) -> Result<(), ReadError> {
        let body = self.bytes(at + PREFIX as u64, body_len as usize)?;
        let mut parts = Parts(&body);
        let mut read = || {
            let (id, _) = (parts.u16()?, parts.u16()?);
            let (topic, _) = (parts.text()?, parts.text()?);
            Some((id, topic, Parts(parts.bytes()?).texts()?))
        };
        let (id, topic, pairs) =
            read().ok_or_else(|| self.damaged(at, "a channel that is cut short".into()))?;
        let before = topic.strip_prefix(BEFORE);
        let channel = match (id, channel_topic(before.unwrap_or(topic))) {
            (EVENT_CHANNEL, _) => Channel::Events,
            (LOG_CHANNEL, _) => Channel::Log,
            (_, Some(number)) => {
                let told = pairs.iter().find(|(key, _)| *key == "element_bytes");
                let bytes = told.and_then(|(_, bytes)| bytes.parse().ok());
                let what = || self.damaged(at, format!("topic \"{topic}\" without the size of its elements"));
                let bytes = bytes.ok_or_else(what)?;
                if before.is_some() { Channel::Before(number, bytes) } else { Channel::Topic(number, bytes) }
            }
            (_, None) => return Err(self.damaged(at, format!("a channel of the unknown topic \"{topic}\""))),
        };
        self.channels.push((id, channel));
        Ok(())
    }

    fn metadata(&self, at: u64, body_len: u64) -> Result<(String, Vec<(String, String)>), ReadError> {
        let body = self.bytes(at + PREFIX as u64, body_len as usize)?;
        let read = || {
            let mut parts = Parts(&body);
            let name = parts.text()?.to_owned();
            let pairs = Parts(parts.bytes()?).texts()?.into_iter();
            Some((name, pairs.map(|(key, value)| (key.to_owned(), value.to_owned())).collect()))
        };
        read().ok_or_else(|| self.damaged(at, "metadata that is cut short".into()))
    }

    fn read_about(&self, at: u64, pairs: &[(String, String)]) -> Result<About, ReadError> {
        let of = |key: &str| pairs.iter().find(|(name, _)| name == key).map_or("", |(_, value)| value);
        // Other versions may say other things of the run; of them only the version is wanted.
        let schema: u32 =
            of("schema").parse().map_err(|_| self.damaged(at, "metadata without a schema".into()))?;
        if schema != SCHEMA {
            return Ok(About { schema, program: of("program").to_owned(), ..About::default() });
        }
        serde_json::from_str(of("about"))
            .map_err(|error| self.damaged(at, format!("metadata \"{BEGIN}\": {error}")))
    }

    /// What it says about its run.
    #[must_use]
    pub const fn about(&self) -> &About {
        &self.about
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How it ends.
    #[must_use]
    pub const fn ending(&self) -> &Ending {
        &self.ending
    }

    /// Whether nothing is missing at its end.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        matches!(self.ending, Ending::Complete { .. })
    }

    /// Whether the recording was to have that topic.
    #[must_use]
    pub fn has_topic(&self, name: &str) -> bool {
        self.element_bytes(name).is_some()
    }

    /// How many bytes of each element of a topic it has; none where it was not recorded.
    #[must_use]
    pub fn element_bytes(&self, name: &str) -> Option<usize> {
        let number = channel_topic(name)?;
        self.channels.iter().find_map(|(_, channel)| match channel {
            Channel::Topic(of, bytes) if *of == number => Some(*bytes),
            _ => None,
        })
    }

    /// Whether a topic was recorded with all fields of its elements.
    #[must_use]
    pub fn has_whole(&self, name: &str) -> bool {
        let entry = TABLE.topics.iter().find(|topic| topic.name == name);
        entry.is_some_and(|topic| self.element_bytes(name) == Some(topic.element.size))
    }

    /// All messages, in the order in which they were received. After an error the messages of the next chunk
    /// follow.
    #[must_use]
    pub const fn messages(&self) -> Messages<'_> {
        Messages { recording: self, next: 0, ready: VecDeque::new() }
    }

    /// Reads all of the file and checks it against its check values.
    ///
    /// # Errors
    /// [`ReadError`] with the place of the first part that is not what was written.
    pub fn verify(&self) -> Result<(), ReadError> {
        for message in self.messages() {
            message?;
        }
        if let Some((end, expected)) = self.data_end {
            let found = self.check_value(0, end)?;
            if found != expected {
                let what = format!("the data up to here has the check value {found:08x}, not {expected:08x}");
                return Err(self.damaged(end, what));
            }
        }
        if let Some((start, len)) = self.summary {
            let value_at = len - MAGIC.len() as u64 - 4;
            let stored = self.bytes(value_at, 4)?;
            let expected = u32::from_le_bytes(stored.try_into().unwrap_or_default());
            let found = self.check_value(start, value_at)?;
            if found != expected {
                let what = format!("the index has the check value {found:08x}, not {expected:08x}");
                return Err(self.damaged(start, what));
            }
        }
        Ok(())
    }

    fn check_value(&self, mut at: u64, end: u64) -> Result<u32, ReadError> {
        let mut hasher = crc32fast::Hasher::new();
        while at < end {
            let block = self.bytes(at, (end - at).min(BLOCK as u64) as usize)?;
            hasher.update(&block);
            at += block.len() as u64;
        }
        Ok(hasher.finalize())
    }

    fn bytes(&self, at: u64, len: usize) -> Result<Vec<u8>, ReadError> {
        let read = read_at(&mut self.file.borrow_mut(), at, len);
        read.map_err(|source| ReadError::File { path: self.path.clone(), source })
    }

    fn damaged(&self, offset: u64, what: String) -> ReadError {
        ReadError::Damaged { path: self.path.clone(), offset, what }
    }

    /// The messages of a chunk.
    fn chunk(&self, chunk: Chunk) -> Result<VecDeque<Message>, ReadError> {
        let body = self.bytes(chunk.offset + PREFIX as u64, chunk.body_len as usize)?;
        let bytes = unpack(&body).map_err(|what| self.damaged(chunk.offset, what))?;
        let mut parts = Parts(&bytes);
        let mut messages = VecDeque::new();
        while !parts.0.is_empty() {
            let number = messages.len();
            let cut = || self.damaged(chunk.offset, format!("message {number} of the chunk is cut short"));
            let (kind, body) = parts.record().ok_or_else(cut)?;
            if kind == op::MESSAGE {
                messages.push_back(self.message(chunk, number, body)?);
            }
        }
        Ok(messages)
    }

    fn message(&self, chunk: Chunk, number: usize, body: &[u8]) -> Result<Message, ReadError> {
        let wrong = |what: &str| self.damaged(chunk.offset, format!("message {number} of the chunk: {what}"));
        let mut parts = Parts(body);
        let read = parts.u16().zip(parts.u32()).zip(parts.u64()).zip(parts.u64());
        let (((id, _), log_ns), _) = read.ok_or_else(|| wrong("cut short"))?;
        let channel = self.channels.iter().find(|(of, _)| *of == id);
        let json = |error: serde_json::Error| wrong(&error.to_string());
        let channel = channel.map(|(_, channel)| *channel);
        match channel {
            Some(Channel::Events) => Ok(Message::Event(serde_json::from_slice(parts.0).map_err(json)?)),
            Some(Channel::Log) => Ok(Message::Line(serde_json::from_slice(parts.0).map_err(json)?)),
            Some(Channel::Topic(topic, element_bytes) | Channel::Before(topic, element_bytes)) => {
                let received_ns = log_ns.saturating_add_signed(-self.about.clock_offset_ns);
                let frame = Frame::read_leading(topic, element_bytes, parts.0.into(), received_ns);
                let is_before = matches!(channel, Some(Channel::Before(..)));
                let message = if is_before { Message::Before } else { Message::Frame };
                frame.map(message).map_err(|source| ReadError::Frame {
                    path: self.path.clone(),
                    offset: chunk.offset,
                    message: number,
                    source,
                })
            }
            None => Err(wrong(&format!("channel {id} is not in the file"))),
        }
    }
}

/// The messages of a chunk's body.
pub(crate) fn unpack(body: &[u8]) -> Result<Vec<u8>, String> {
    let mut parts = Parts(body);
    let mut read = || {
        let (_, _, len) = (parts.u64()?, parts.u64()?, parts.u64()?);
        let value = parts.u32()?;
        let compression = parts.text()?;
        let packed_len = parts.u64()?;
        let packed = parts.raw(usize::try_from(packed_len).ok()?)?;
        Some((len, value, compression, packed))
    };
    let (len, expected, compression, packed) = read().ok_or("a chunk that is cut short")?;
    if len > RECORD_MAX {
        return Err(format!("a chunk of {len} bytes"));
    }
    let mut bytes = Vec::new();
    match compression {
        "" => bytes.extend_from_slice(packed),
        LZ4 => {
            // One byte more than is expected shows that there is more.
            let unpacked = FrameDecoder::new(packed).take(len + 1).read_to_end(&mut bytes);
            unpacked.map_err(|error: io::Error| format!("a chunk that can't be unpacked: {error}"))?;
        }
        other => return Err(format!("a chunk with the unknown compression \"{other}\"")),
    }
    if bytes.len() as u64 != len {
        return Err(format!("a chunk of {} bytes, which should have {len}", bytes.len()));
    }
    let found = crc32fast::hash(&bytes);
    if found != expected {
        return Err(format!("the chunk has the check value {found:08x}, not {expected:08x}"));
    }
    Ok(bytes)
}

/// The messages of a recording, read chunk by chunk.
#[derive(Debug)]
pub struct Messages<'a> {
    recording: &'a Recording,
    next: usize,
    ready: VecDeque<Message>,
}

impl Iterator for Messages<'_> {
    type Item = Result<Message, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ready.is_empty() {
            let chunk = *self.recording.chunks.get(self.next)?;
            self.next += 1;
            match self.recording.chunk(chunk) {
                Ok(messages) => self.ready = messages,
                Err(error) => return Some(Err(error)),
            }
        }
        self.ready.pop_front().map(Ok)
    }
}
