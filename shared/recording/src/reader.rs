mod chunk;
mod layout;
mod messages;
mod parts;

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use mcap::records::{self, Record, op};
use wire::{SCHEMA, TABLE};

use self::layout::{Layout, Place};
use self::parts::{Channel, Content, Part, channels};
use crate::format::{BEGIN, END, PREFIX};
use crate::{About, ReadError};

use chunk::RECORD_BYTES_MAX;
pub(crate) use chunk::{Allowance, record, unpack, unpacked_len};
pub use messages::Messages;

/// Messages outside of chunks are read in parts of about this size.
const LOOSE_BYTES: u64 = 1 << 20;
/// Largest record of metadata, of a channel, or of another description of the file.
const DESCRIPTION_BYTES_MAX: u64 = 16 << 20;
/// Bytes of a chunk's body up to the length of its content.
const CHUNK_HEADER: u64 = 24;
/// Bytes of a message before its data.
const MESSAGE_HEADER: u64 = 22;

/// A recording to read: a file that this program wrote, or that an MCAP tool derived from one.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    layout: Layout,
    about: About,
    /// Channels by number.
    channels: BTreeMap<u16, Channel>,
    /// Topics that this program does not know.
    foreign: Vec<String>,
    /// Sorted by the time of their first message.
    parts: Vec<Part>,
    ending: Ending,
    /// Ranges of the file with their check values.
    checks: Vec<Check>,
}

/// A range of a file and its check value.
#[derive(Clone, Copy, Debug)]
struct Check {
    begin: u64,
    end: u64,
    expected: u32,
    what: &'static str,
}

/// How a recording ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The recorder ended it, with a reason.
    Complete {
        /// The reason.
        how: String,
        /// Messages that could not be written to disk, by topic, as JSON.
        lost_on_disk: String,
    },
    /// It stops in the middle: the recorder was killed, the disk was full, or the power failed.
    Incomplete {
        /// End of the last whole record.
        at: u64,
        /// Description of the content at that place.
        why: String,
    },
}

/// The state of a scan over the file's records.
struct Scan {
    /// What the chunks may unpack to.
    allowance: Allowance,
    channels: Vec<records::Channel>,
    /// Number of channels before the index.
    data_channels: usize,
    begin: Option<BTreeMap<String, String>>,
    end: Option<BTreeMap<String, String>>,
    parts: Vec<Part>,
    checks: Vec<Check>,
    /// The first byte after the data.
    data_end: Option<u64>,
    /// The first byte after the footer.
    footer_end: Option<u64>,
}

impl Recording {
    /// Opens a file and finds its parts. [`Recording::messages`] reads and checks their content.
    ///
    /// # Errors
    /// [`ReadError`] if the file is not a recording of this program's version.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let failed = |source| ReadError::File { path: path.to_owned(), source };
        let layout = File::open(path).and_then(Layout::new).map_err(failed)?;
        if !layout.magic_at(0).map_err(failed)? {
            return Err(ReadError::Foreign { path: path.to_owned() });
        }
        let mut recording = Self {
            path: path.to_owned(),
            layout,
            about: About::default(),
            channels: BTreeMap::new(),
            foreign: Vec::new(),
            parts: Vec::new(),
            ending: Ending::Incomplete { at: 0, why: String::new() },
            checks: Vec::new(),
        };
        let (mut scan, at) = recording.scan()?;
        if scan.footer_end.is_none() {
            // A torn index may contain anything.
            scan.channels.truncate(scan.data_channels);
            scan.checks.clear();
        }
        recording.ending = recording.read_ending(&mut scan, at)?;
        let Some(begin) = scan.begin else {
            return Err(ReadError::NotOurs { path: path.to_owned(), wanted: BEGIN });
        };
        recording.about = recording.read_about(&begin)?;
        recording.parts = scan.parts;
        recording.checks = scan.checks;
        if scan.channels.is_empty() {
            scan.channels = recording.channels_in_chunks();
        }
        for channel in &scan.channels {
            recording.channels.entry(channel.id).or_insert(Channel::of(channel, &recording.about));
        }
        let is_foreign = |channel: &&records::Channel| recording.channels[&channel.id] == Channel::Foreign;
        let mut foreign: Vec<String> =
            scan.channels.iter().filter(is_foreign).map(|c| c.topic.clone()).collect();
        foreign.sort();
        foreign.dedup();
        recording.foreign = foreign;
        recording.parts.sort_by_key(|part| part.begin_ns);
        Ok(recording)
    }

    /// Scans the records up to the end of the file or of its intact part; also returns that position.
    fn scan(&self) -> Result<(Scan, u64), ReadError> {
        let mut scan = Scan::new(self.layout.len);
        let mut at = mcap::MAGIC.len() as u64;
        loop {
            match self.io(self.layout.record(at))? {
                Some(place) => {
                    self.take(place, &mut scan)?;
                    at = place.end();
                    if place.op == op::FOOTER {
                        return Ok((scan, at));
                    }
                }
                // Only an index follows the data.
                None if scan.data_end.is_some() => return Ok((scan, at)),
                None => {
                    let next = self.io(self.layout.whole_chunk(at + 1, &mut scan.allowance))?;
                    let Some(next) = next else { return Ok((scan, at)) };
                    let what = format!("{} bytes that are no whole records", next.at - at);
                    scan.damage(at, what);
                    at = next.at;
                }
            }
        }
    }

    /// Processes a record of the file.
    fn take(&self, place: Place, scan: &mut Scan) -> Result<(), ReadError> {
        let (at, end) = (place.at, place.end());
        let first_u64 = |bytes: &[u8]| bytes.first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes));
        let most = match place.op {
            op::CHUNK | op::MESSAGE => RECORD_BYTES_MAX,
            // The content of attachments and the like is not read.
            op::CHANNEL | op::METADATA | op::DATA_END | op::FOOTER => DESCRIPTION_BYTES_MAX,
            _ => u64::MAX,
        };
        if end - place.body_at() > most {
            let len = end - place.body_at();
            return Err(self.damaged(at, format!("a record of {len} bytes, at most {most} are read")));
        }
        match place.op {
            op::CHUNK => {
                let header =
                    self.io(self.layout.bytes(place.body_at(), end.min(place.body_at() + CHUNK_HEADER)))?;
                let begin_ns = first_u64(&header);
                let content = match scan.allowance.take(unpacked_len(&header)) {
                    Ok(()) => Content::Chunk,
                    Err(problem) => Content::Damage(problem),
                };
                scan.parts.push(Part { begin_ns, at, end, content });
            }
            op::MESSAGE => {
                let header =
                    self.io(self.layout.bytes(place.body_at(), end.min(place.body_at() + MESSAGE_HEADER)))?;
                // The channel and a sequence number precede the time.
                let log_ns = first_u64(header.get(6..).unwrap_or_default());
                match scan.parts.last_mut() {
                    Some(part)
                        if part.content == Content::Loose
                            && part.end == at
                            && end - part.at < LOOSE_BYTES =>
                    {
                        part.begin_ns = part.begin_ns.min(log_ns);
                        part.end = end;
                    }
                    _ => scan.parts.push(Part { begin_ns: log_ns, at, end, content: Content::Loose }),
                }
            }
            op::CHANNEL | op::METADATA | op::DATA_END | op::FOOTER => {
                let body = self.io(self.layout.body(place))?;
                match mcap::parse_record(place.op, &body) {
                    Ok(Record::Channel(channel)) => {
                        scan.channels.push(channel);
                        scan.data_channels += usize::from(scan.data_end.is_none());
                    }
                    Ok(Record::Metadata(found)) if found.name == BEGIN => {
                        if scan.begin.as_ref().is_some_and(|begin| *begin != found.metadata) {
                            let what = "two runs are in it: a replay needs one".to_owned();
                            return Err(self.damaged(at, what));
                        }
                        scan.begin = Some(found.metadata);
                    }
                    Ok(Record::Metadata(found)) if found.name == END => scan.end = Some(found.metadata),
                    Ok(Record::DataEnd(found)) => {
                        scan.data_end = Some(end);
                        scan.check(0, at, found.data_section_crc, "the data");
                    }
                    Ok(Record::Footer(found)) => {
                        let begin = scan.data_end.unwrap_or(at);
                        scan.check(begin, end - 4, found.summary_crc, "the index");
                        scan.footer_end = Some(end);
                    }
                    Ok(_) => {}
                    Err(error) => scan.damage(at, format!("a record of kind {:#04x}: {error}", place.op)),
                }
            }
            // Indexes, statistics, attachments, schemas, and kinds that other programs added.
            _ => {}
        }
        Ok(())
    }

    /// Determines how the file ends. In a torn file the last chunks may have only their length; such chunks
    /// are removed.
    fn read_ending(&self, scan: &mut Scan, at: u64) -> Result<Ending, ReadError> {
        let magic = mcap::MAGIC.len() as u64;
        let why = match (scan.footer_end, &scan.end) {
            (Some(end), _) if !self.io(self.layout.magic_at(end))? => "the last bytes are missing",
            (Some(end), _) if end + magic < self.layout.len => "more bytes follow the end of the recording",
            (Some(_), Some(pairs)) => {
                let of = |key: &str| pairs.get(key).cloned().unwrap_or_default();
                return Ok(Ending::Complete { how: of("ended"), lost_on_disk: of("lost_on_disk") });
            }
            (Some(_), None) => "it does not say how the run ended: the metadata \"stgdat.end\" is missing",
            (None, _) if scan.data_end.is_some() => "the index is missing or cut off",
            (None, _) => self.io(self.layout.why_torn(at))?,
        };
        let mut ending = Ending::Incomplete { at, why: why.to_owned() };
        while scan.footer_end.is_none()
            && let Some(last) = scan.parts.last()
            && let Err(what) = self.content(last)?
        {
            ending = Ending::Incomplete { at: last.at, why: what };
            scan.parts.pop();
        }
        Ok(ending)
    }

    fn read_about(&self, pairs: &BTreeMap<String, String>) -> Result<About, ReadError> {
        let wrong = |what: String| self.damaged(0, format!("metadata \"{BEGIN}\": {what}"));
        let of = |key: &str| pairs.get(key).map_or("", String::as_str);
        let schema: u32 = of("schema").parse().map_err(|_| wrong("no schema".to_owned()))?;
        // Other versions have other fields.
        if schema != SCHEMA {
            let (path, program) = (self.path.clone(), of("program").to_owned());
            return Err(ReadError::Schema { path, found: schema, expected: SCHEMA, program });
        }
        serde_json::from_str(of("about")).map_err(|error| wrong(error.to_string()))
    }

    /// The channels of a file that defines them only in its chunks and has no index.
    fn channels_in_chunks(&self) -> Vec<records::Channel> {
        let chunks = self.parts.iter().filter_map(|part| self.content(part).ok()?.ok());
        chunks.flat_map(|bytes| channels(&bytes)).collect()
    }

    /// The records of a part.
    fn content(&self, part: &Part) -> Result<Result<Vec<u8>, String>, ReadError> {
        Ok(match &part.content {
            Content::Chunk => chunk::unpack(&self.io(self.layout.bytes(part.at + PREFIX as u64, part.end))?),
            Content::Loose => Ok(self.io(self.layout.bytes(part.at, part.end))?),
            Content::Damage(what) => Err(what.clone()),
        })
    }

    /// The description of the run.
    pub const fn about(&self) -> &About {
        &self.about
    }

    /// The path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the file ends.
    pub const fn ending(&self) -> &Ending {
        &self.ending
    }

    /// Whether the end of the file is complete.
    pub const fn is_complete(&self) -> bool {
        matches!(self.ending, Ending::Complete { .. })
    }

    /// Whether the topic was requested for the recording.
    #[must_use]
    pub fn has_topic(&self, name: &str) -> bool {
        self.element_bytes(name).is_some()
    }

    /// Number of recorded bytes per element of a topic; `None` if the topic was not recorded.
    #[must_use]
    pub fn element_bytes(&self, name: &str) -> Option<usize> {
        let number = crate::topic_number(name)?;
        self.channels.values().find_map(|channel| match channel {
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

    /// Topics of the file that this program does not know. Their messages are not read.
    pub fn foreign_topics(&self) -> &[String] {
        &self.foreign
    }

    /// All messages in the order of their times. An error stands for a part that can't be read; the messages
    /// after that part follow.
    pub fn messages(&self) -> Messages<'_> {
        Messages::new(self)
    }

    /// Reads the whole file and verifies its check values; returns each damaged part.
    pub fn damages(&self) -> Vec<ReadError> {
        let mut damages: Vec<ReadError> = self.messages().filter_map(Result::err).collect();
        // Check values of larger ranges add nothing to the place of a damage.
        if damages.is_empty() {
            damages.extend(self.checks.iter().filter_map(|check| self.check(*check).err()));
        }
        damages
    }

    /// Reads the whole file and verifies its check values.
    ///
    /// # Errors
    /// [`ReadError`] with the place of the first damaged part.
    pub fn verify(&self) -> Result<(), ReadError> {
        self.damages().into_iter().next().map_or(Ok(()), Err)
    }

    fn check(&self, Check { begin, end, expected, what }: Check) -> Result<(), ReadError> {
        let found = self.io(self.layout.check_value(begin, end))?;
        if found == expected {
            return Ok(());
        }
        Err(self.damaged(begin, format!("{what} has the check value {found:08x}, not {expected:08x}")))
    }

    fn io<T>(&self, result: io::Result<T>) -> Result<T, ReadError> {
        result.map_err(|source| ReadError::File { path: self.path.clone(), source })
    }

    fn damaged(&self, offset: u64, what: String) -> ReadError {
        ReadError::Damaged { path: self.path.clone(), offset, what }
    }
}

impl Scan {
    fn new(file_len: u64) -> Self {
        Self {
            allowance: Allowance::new(file_len),
            channels: Vec::new(),
            data_channels: 0,
            begin: None,
            end: None,
            parts: Vec::new(),
            checks: Vec::new(),
            data_end: None,
            footer_end: None,
        }
    }

    /// Adds a range with its check value; 0 means that the writer computed none.
    fn check(&mut self, begin: u64, end: u64, expected: u32, what: &'static str) {
        if expected != 0 {
            self.checks.push(Check { begin, end, expected, what });
        }
    }

    /// Adds a part that can't be read.
    fn damage(&mut self, at: u64, what: String) {
        let begin_ns = self.parts.last().map_or(0, |part| part.begin_ns);
        self.parts.push(Part { begin_ns, at, end: at, content: Content::Damage(what) });
    }
}
