use std::collections::BTreeMap;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use crc32fast::Hasher;
use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
use mcap::MAGIC;
use mcap::records::op;
use serde::Serialize;
use wire::{Header, TABLE, TopicEntry};

use crate::before::kept_bytes;
use crate::format::{BEFORE, BEGIN, Body, END, JSON, PREFIX, WIRE};
use crate::sink::FileSink;
use crate::{About, EVENTS, Event, Frame, Happened, LOG, LogLine, Message, NO_TOPIC, Sink, View, WriteError};

/// A chunk is written when it has this many bytes …
pub const CHUNK_BYTES: usize = 1 << 20;
/// … or when its messages span this much time: the most that a crash loses.
pub const CHUNK_NS: u64 = 1_000_000_000;

/// Identifies the layout of frames; the channels name the header's record and the elements' record.
const WIRE_SCHEMA: u16 = 1;
/// Identifies the schema of events and log lines.
const JSON_SCHEMA: u16 = 2;
/// Channel number of a topic minus the topic's number.
const TOPIC_CHANNELS: u16 = 1;
/// The same for channels of frames from before the recording.
const BEFORE_CHANNELS: u16 = 50;
/// Profile of a file without a view.
const PROFILE: &str = "stgdat";
const EVENT_CHANNEL: u16 = 100;
const LOG_CHANNEL: u16 = 101;
/// Number of the first channel and of the first schema of a view.
const VIEW_CHANNELS: u16 = 200;
/// Compression of chunks.
const LZ4: &str = "lz4";
/// Messages that are missing in the file, by topic.
pub type Losses = BTreeMap<String, u64>;

/// Size and content of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Written {
    /// Messages in the file.
    pub messages: u64,
    /// Number of messages by topic.
    pub by_topic: BTreeMap<String, u64>,
    /// Bytes of the file.
    pub bytes: u64,
    /// Bytes before compression.
    pub uncompressed_bytes: u64,
    /// Messages that could not be written to disk.
    pub lost: Losses,
}

/// Writes a recording. A block that the disk refuses is lost and counted; later blocks are tried again.
#[derive(Debug)]
pub struct Writer<S: Sink = FileSink> {
    sink: S,
    path: PathBuf,
    clock_offset_ns: i64,
    /// Check value of all bytes after the first magic bytes that the sink has taken.
    checked: Hasher,
    chunk: Chunk,
    /// Records of schemas and of channels, which the summary repeats.
    head: [Vec<u8>; 2],
    channels: Vec<(u16, String)>,
    schema_count: u16,
    view: Option<Box<dyn View>>,
    /// Number of written leading bytes per element, for topics whose elements are written in part.
    element_bytes: BTreeMap<String, usize>,
    chunks: Vec<ChunkIndex>,
    metadata: Vec<(u64, u64, &'static str)>,
    written: Written,
    /// Losses that no event in the file reports yet.
    unwritten_losses: Losses,
    /// The last error of the sink.
    error: Option<io::Error>,
}

/// The messages of a chunk.
#[derive(Debug, Default)]
struct Chunk {
    bytes: Vec<u8>,
    /// Time and offset of each message, by channel.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
    begin_ns: u64,
    end_ns: u64,
}

#[derive(Debug)]
struct ChunkIndex {
    times_ns: [u64; 2],
    offset: u64,
    len: u64,
    index_offsets: Vec<(u16, u64)>,
    index_len: u64,
    sizes: [u64; 2],
}

impl Writer {
    /// Creates a file. `layout` is the output of `stgdat wire --json`.
    ///
    /// # Errors
    /// [`WriteError`] if a file with this name exists or the file can't be started.
    pub fn create(path: &Path, about: &About, layout: &str) -> Result<Self, WriteError> {
        Self::with_view(path, about, layout, None)
    }

    /// Creates a file to which a view adds messages for other tools.
    ///
    /// # Errors
    /// [`WriteError`] if a file with this name exists or the file can't be started.
    pub fn with_view(
        path: &Path,
        about: &About,
        layout: &str,
        view: Option<Box<dyn View>>,
    ) -> Result<Self, WriteError> {
        let failed = |source| WriteError { path: path.to_owned(), source };
        let sink = FileSink::create(path).map_err(failed)?;
        Ok(Self { path: path.to_owned(), ..Self::over(sink, about, layout, view).map_err(failed)? })
    }
}

impl<S: Sink> Writer<S> {
    /// Starts a recording in any sink.
    ///
    /// # Errors
    /// If the sink does not take the first block.
    pub fn over(sink: S, about: &About, layout: &str, view: Option<Box<dyn View>>) -> io::Result<Self> {
        let [mut schemas, mut channel_records] = [Vec::new(), Vec::new()];
        let profile = view.as_ref().map_or(PROFILE, |view| view.profile());
        // Readers of ROS bags refuse files with schemas of encodings that they do not know.
        let encoding = |name| if profile == PROFILE { name } else { "" };
        let wire = format!("stgdat.wire.{}", about.schema);
        Body::default()
            .u16(WIRE_SCHEMA)
            .text(&wire)
            .text(encoding("stgdat-wire-json"))
            .text(layout)
            .record(op::SCHEMA, &mut schemas);
        let object = r#"{"type":"object","properties":{"at_ns":{"type":"integer"}}}"#;
        Body::default()
            .u16(JSON_SCHEMA)
            .text("stgdat.json")
            .text(encoding("jsonschema"))
            .text(object)
            .record(op::SCHEMA, &mut schemas);
        let mut channels = Vec::new();
        for (number, topic) in TABLE.topics.iter().enumerate() {
            let whole = topic.element.size;
            if about.topics.is_empty() || about.topics.iter().any(|name| name == topic.name) {
                let bytes = about.element_bytes.get(topic.name).map_or(whole, |bytes| whole.min(*bytes));
                let id = number as u16 + TOPIC_CHANNELS;
                channel(&mut channel_records, id, topic.name, topic, bytes);
                channels.push((id, topic.name.to_owned()));
            }
            if let Some(bytes) = kept_bytes(topic.name).filter(|_| about.before) {
                let (id, name) = (number as u16 + BEFORE_CHANNELS, format!("{BEFORE}{}", topic.name));
                channel(&mut channel_records, id, &name, topic, bytes);
                channels.push((id, name));
            }
        }
        let has_events = about.topics.iter().all(|name| name != NO_TOPIC);
        for (id, name) in [(EVENT_CHANNEL, EVENTS), (LOG_CHANNEL, LOG)].into_iter().filter(|_| has_events) {
            let body = Body::default().u16(id).u16(JSON_SCHEMA).text(name).text(JSON);
            body.texts(&[]).record(op::CHANNEL, &mut channel_records);
            channels.push((id, name.to_owned()));
        }
        let view_channels = view.as_ref().map(|view| view.channels()).unwrap_or_default();
        for (id, channel) in (VIEW_CHANNELS..).zip(&view_channels) {
            let body = Body::default().u16(id).text(channel.schema).text(channel.schema_encoding);
            body.bytes(&channel.schema_data).record(op::SCHEMA, &mut schemas);
            let body = Body::default().u16(id).u16(id).text(channel.topic).text(channel.encoding);
            body.texts(&channel.metadata).record(op::CHANNEL, &mut channel_records);
            channels.push((id, channel.topic.to_owned()));
        }

        let mut writer = Self {
            sink,
            path: PathBuf::new(),
            clock_offset_ns: about.clock_offset_ns,
            checked: Hasher::new(),
            chunk: Chunk::default(),
            head: [schemas, channel_records],
            channels,
            schema_count: JSON_SCHEMA + view_channels.len() as u16,
            view,
            element_bytes: about.element_bytes.clone(),
            chunks: Vec::new(),
            metadata: Vec::new(),
            written: Written::default(),
            unwritten_losses: Losses::new(),
            error: None,
        };
        let mut begin = MAGIC.to_vec();
        Body::default().text(profile).text(&about.program).record(op::HEADER, &mut begin);
        let at = begin.len() as u64;
        Body::default().text(BEGIN).texts(&about.pairs()).record(op::METADATA, &mut begin);
        writer.metadata.push((at, begin.len() as u64 - at, BEGIN));
        begin.extend(writer.head.iter().flatten());
        writer.append(&begin)?;
        Ok(writer)
    }

    /// Adds a frame.
    pub fn frame(&mut self, frame: &Frame) {
        let channel = u16::from(frame.number()) + TOPIC_CHANNELS;
        if self.channels.iter().all(|(id, _)| *id != channel) {
            return;
        }
        let times_ns = [frame.received_ns(), frame.sent_ns()];
        let sequence = frame.header().seq as u32;
        match self.element_bytes.get(frame.topic().name) {
            Some(bytes) => self.message(channel, sequence, times_ns, frame.leading(*bytes).bytes()),
            None => self.message(channel, sequence, times_ns, frame.bytes()),
        }
    }

    /// Adds a frame from before the recording's start, to a file that will contain them.
    pub fn before(&mut self, frame: &Frame) {
        let channel = u16::from(frame.number()) + BEFORE_CHANNELS;
        let Some(bytes) = kept_bytes(frame.topic().name) else { return };
        if self.channels.iter().all(|(id, _)| *id != channel) {
            return;
        }
        let times_ns = [frame.received_ns(), frame.sent_ns()];
        self.message(channel, frame.header().seq as u32, times_ns, frame.leading(bytes).bytes());
    }

    /// Adds an event.
    pub fn event(&mut self, event: &Event) {
        // JSON can represent all numbers, texts and text keys.
        let json = serde_json::to_vec(event).unwrap_or_default();
        self.json(EVENT_CHANNEL, event.at_ns, &json);
    }

    /// Adds a log line.
    pub fn line(&mut self, line: &LogLine) {
        let json = serde_json::to_vec(line).unwrap_or_default();
        self.json(LOG_CHANNEL, line.at_ns, &json);
    }

    fn json(&mut self, channel: u16, at_ns: u64, json: &[u8]) {
        if self.channels.iter().any(|(id, _)| *id == channel) {
            self.message(channel, 0, [at_ns; 2], json);
        }
    }

    /// Adds a message.
    pub fn add(&mut self, message: &Message) {
        match message {
            Message::Frame(frame) => self.frame(frame),
            Message::Before(frame) => self.before(frame),
            Message::Event(event) => self.event(event),
            Message::Line(line) => self.line(line),
        }
        if let Some(mut view) = self.view.take() {
            let (sequence, times_ns) = match message {
                Message::Frame(frame) => (frame.header().seq as u32, [frame.received_ns(), frame.sent_ns()]),
                other => (0, [other.at_ns(); 2]),
            };
            view.add(message, &mut |channel, data| {
                self.message(VIEW_CHANNELS + channel, sequence, times_ns, data);
            });
            self.view = Some(view);
        }
    }

    /// The last error of the disk; returned once.
    pub fn take_error(&mut self) -> Option<io::Error> {
        self.error.take()
    }

    fn message(&mut self, channel: u16, sequence: u32, times_ns: [u64; 2], data: &[u8]) {
        // Unix time, as tools expect.
        let [log_ns, publish_ns] = times_ns.map(|ns| ns.saturating_add_signed(self.clock_offset_ns));
        let is_full = self.chunk.bytes.len() + data.len() > CHUNK_BYTES
            || log_ns.saturating_sub(self.chunk.begin_ns) >= CHUNK_NS;
        if is_full && !self.chunk.index.is_empty() {
            self.flush();
        }
        let chunk = &mut self.chunk;
        if chunk.index.is_empty() {
            (chunk.begin_ns, chunk.end_ns) = (log_ns, log_ns);
        }
        (chunk.begin_ns, chunk.end_ns) = (chunk.begin_ns.min(log_ns), chunk.end_ns.max(log_ns));
        chunk.index.entry(channel).or_default().push((log_ns, chunk.bytes.len() as u64));
        let body = Body::default().u16(channel).u32(sequence).u64(log_ns).u64(publish_ns);
        body.raw(data).record(op::MESSAGE, &mut chunk.bytes);
    }

    /// Writes the current chunk. If the disk does not take it, its messages are lost and counted.
    pub fn flush(&mut self) {
        if self.chunk.index.is_empty() {
            return;
        }
        let mut chunk = std::mem::take(&mut self.chunk);
        match self.write_chunk(&chunk) {
            Ok(()) => {
                for (channel, index) in &chunk.index {
                    let topic = self.topic(*channel).to_owned();
                    *self.written.by_topic.entry(topic).or_default() += index.len() as u64;
                    self.written.messages += index.len() as u64;
                }
                self.written.uncompressed_bytes += chunk.bytes.len() as u64;
                self.write_losses(chunk.end_ns);
            }
            Err(error) => {
                self.error = Some(error);
                for (channel, index) in &chunk.index {
                    let topic = self.topic(*channel).to_owned();
                    *self.written.lost.entry(topic.clone()).or_default() += index.len() as u64;
                    *self.unwritten_losses.entry(topic).or_default() += index.len() as u64;
                }
            }
        }
        if self.chunk.index.is_empty() {
            // The memory is used again.
            chunk.bytes.clear();
            self.chunk.bytes = chunk.bytes;
        }
    }

    /// Writes pending loss events as soon as the file takes blocks again.
    fn write_losses(&mut self, end_ns: u64) {
        let at_ns = end_ns.saturating_add_signed(-self.clock_offset_ns);
        for (topic, frames) in std::mem::take(&mut self.unwritten_losses) {
            let what = Happened::Lost { at: "disk".to_owned(), topic, frames };
            self.event(&Event { at_ns, what });
        }
    }

    fn write_chunk(&mut self, chunk: &Chunk) -> io::Result<()> {
        let compressed = compress(&chunk.bytes)?;
        let sizes = [compressed.len() as u64, chunk.bytes.len() as u64];
        let mut block = Vec::with_capacity(compressed.len() + 1024);
        let body = Body::default().u64(chunk.begin_ns).u64(chunk.end_ns).u64(sizes[1]);
        let body = body.u32(crc32fast::hash(&chunk.bytes)).text(LZ4).u64(sizes[0]).raw(&compressed);
        body.record(op::CHUNK, &mut block);
        let (offset, len) = (self.written.bytes, block.len() as u64);
        let mut index_offsets = Vec::new();
        for (channel, index) in &chunk.index {
            index_offsets.push((*channel, offset + block.len() as u64));
            let entries = index.iter().fold(Body::default(), |body, (time, at)| body.u64(*time).u64(*at));
            let mut bytes = Vec::new();
            entries.record(0, &mut bytes);
            Body::default().u16(*channel).bytes(&bytes[PREFIX..]).record(op::MESSAGE_INDEX, &mut block);
        }
        self.append(&block)?;
        let index_len = block.len() as u64 - len;
        let times_ns = [chunk.begin_ns, chunk.end_ns];
        self.chunks.push(ChunkIndex { times_ns, offset, len, index_offsets, index_len, sizes });
        Ok(())
    }

    fn append(&mut self, block: &[u8]) -> io::Result<()> {
        self.sink.append(block)?;
        self.checked.update(block);
        self.written.bytes += block.len() as u64;
        Ok(())
    }

    fn topic(&self, channel: u16) -> &str {
        let found = self.channels.iter().find(|(id, _)| *id == channel);
        found.map_or("unknown", |(_, name)| name)
    }

    /// Writes the current chunk, the losses, and the index. `how` is the reason for the end.
    ///
    /// # Errors
    /// [`WriteError`] if the disk does not take the end. The file is then readable up to its last chunk, and
    /// readers report it as incomplete.
    pub fn finish(mut self, how: &str) -> Result<Written, WriteError> {
        // Flushes again: the first flush may have added loss events.
        self.flush();
        self.flush();
        let ended = self.end(how);
        let (path, written) = (self.path, self.written);
        ended.map(|()| written).map_err(|source| WriteError { path, source })
    }

    fn end(&mut self, how: &str) -> io::Result<()> {
        let mut block = Vec::new();
        let offset = self.written.bytes;
        // A map of texts to numbers.
        let lost = serde_json::to_string(&self.written.lost).unwrap_or_default();
        let pairs = [("ended", how.to_owned()), ("lost_on_disk", lost)];
        Body::default().text(END).texts(&pairs).record(op::METADATA, &mut block);
        self.metadata.push((offset, block.len() as u64, END));
        let mut checked = self.checked.clone();
        checked.update(&block);
        Body::default().u32(checked.finalize()).record(op::DATA_END, &mut block);
        let start = offset + block.len() as u64;
        let summary = self.summary(start);
        block.extend(summary);
        self.append(&block)?;
        self.sink.sync()
    }

    /// Index, footer and magic bytes of a summary that starts at `start`.
    fn summary(&self, start: u64) -> Vec<u8> {
        let mut out = Vec::new();
        let mut groups: Vec<(u8, u64, u64)> = Vec::new();
        let mut group = |number: u8, out: &mut Vec<u8>, records: Vec<u8>| {
            groups.push((number, start + out.len() as u64, records.len() as u64));
            out.extend(records);
        };
        let [schemas, channels] = &self.head;
        group(op::SCHEMA, &mut out, schemas.clone());
        group(op::CHANNEL, &mut out, channels.clone());
        group(op::STATISTICS, &mut out, self.statistics());
        let mut chunks = Vec::new();
        for chunk in &self.chunks {
            let body = Body::default().u64(chunk.times_ns[0]).u64(chunk.times_ns[1]);
            let body = body.u64(chunk.offset).u64(chunk.len).counts(chunk.index_offsets.iter().copied());
            let body = body.u64(chunk.index_len).text(LZ4).u64(chunk.sizes[0]).u64(chunk.sizes[1]);
            body.record(op::CHUNK_INDEX, &mut chunks);
        }
        group(op::CHUNK_INDEX, &mut out, chunks);
        let mut metadata = Vec::new();
        for (offset, len, name) in &self.metadata {
            Body::default().u64(*offset).u64(*len).text(name).record(op::METADATA_INDEX, &mut metadata);
        }
        group(op::METADATA_INDEX, &mut out, metadata);
        let offsets_start = start + out.len() as u64;
        for (number, offset, len) in groups.into_iter().filter(|(_, _, len)| *len > 0) {
            Body::default().raw(&[number]).u64(offset).u64(len).record(op::SUMMARY_OFFSET, &mut out);
        }
        Body::default().u64(start).u64(offsets_start).u32(0).record(op::FOOTER, &mut out);
        // The check value covers the footer up to itself.
        let value_at = out.len() - 4;
        let value = crc32fast::hash(&out[..value_at]);
        out[value_at..].copy_from_slice(&value.to_le_bytes());
        out.extend(MAGIC);
        out
    }

    fn statistics(&self) -> Vec<u8> {
        let begin_ns = self.chunks.iter().map(|chunk| chunk.times_ns[0]).min().unwrap_or(0);
        let end_ns = self.chunks.iter().map(|chunk| chunk.times_ns[1]).max().unwrap_or(0);
        let counts =
            self.channels.iter().filter_map(|(id, name)| Some((*id, *self.written.by_topic.get(name)?)));
        let body = Body::default().u64(self.written.messages).u16(self.schema_count);
        let body = body.u32(self.channels.len() as u32).u32(0).u32(self.metadata.len() as u32);
        let body = body.u32(self.chunks.len() as u32).u64(begin_ns).u64(end_ns).counts(counts);
        let mut out = Vec::new();
        body.record(op::STATISTICS, &mut out);
        out
    }
}

/// Adds the channel of a topic's frames, with the number of bytes per element.
fn channel(head: &mut Vec<u8>, id: u16, name: &str, topic: &TopicEntry, element_bytes: usize) {
    let metadata = [
        ("element", topic.element.name.to_owned()),
        ("element_bytes", element_bytes.to_string()),
        ("header", Header::RECORD.name.to_owned()),
        ("header_bytes", Header::RECORD.size.to_string()),
        ("type_name", topic.type_name.to_owned()),
    ];
    let body = Body::default().u16(id).u16(WIRE_SCHEMA).text(name).text(WIRE);
    body.texts(&metadata).record(op::CHANNEL, head);
}

/// An LZ4 frame, as MCAP requires.
fn compress(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let info = FrameInfo::new().block_mode(BlockMode::Linked).block_size(BlockSize::Max1MB);
    let mut encoder = FrameEncoder::with_frame_info(info, Vec::with_capacity(bytes.len() / 2));
    encoder.write_all(bytes)?;
    encoder.finish().map_err(io::Error::other)
}
