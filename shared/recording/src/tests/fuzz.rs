//! Fuzz targets of recordings: the bytes of a file, and the content of its chunks with valid check values.
//!
//! No input may panic, and the result has the properties that replays rely on. `tests/fuzz/readers.rs` has
//! the command for a longer search.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use wire::{Detection, DetectionsTopic, Header, Hop, StageId, TracksTopic};

use mcap::MAGIC;
use mcap::records::op;

use crate::format::Body;
use crate::reader::{record, unpack};
use crate::{About, Event, Frame, Happened, LogLine, Message, Recording, Writer};

/// Iterations of a target in an ordinary test run.
const ITERATIONS: usize = 2_000;
/// Longest list of edits, in bytes.
const EDITS_BYTES_MAX: usize = 64;
/// Byte sequences that tend to break readers of lengths, numbers and JSON.
const WORDS: [&[u8]; 10] = [
    &[0; 8],
    &[0xFF; 8],
    &[0xFF, 0xFF, 0xFF, 0x7F],
    &[0, 0, 0, 0x10, 0, 0, 0, 0],
    &[0, 0, 0xC0, 0x7F],
    b"{}",
    b"\"",
    b"1e999",
    b"null",
    &[op::CHUNK],
];

/// A record of a file; chunks are decompressed.
struct Record {
    op: u8,
    bytes: Vec<u8>,
}

fn frame(seq: u64) -> Frame {
    let mut header = Header::new(7, seq, (seq * 80_000_000) as i64);
    header.counts.agents_len = 2;
    header.push_hop(Hop { stage: StageId::Source.number(), sent_ns: seq * 80_000_000, ..Hop::default() });
    let detections = [1, 2].map(|id| Detection { id, x_m: id as f32, ..bytemuck::Zeroable::zeroed() });
    Frame::of::<DetectionsTopic>(&header, &detections, seq * 80_000_000 + 5)
}

/// A valid file with a message of every kind.
fn good(folder: &Path) -> Vec<u8> {
    let path = folder.join("good.mcap");
    let about = About { program: "stgdat 0".to_owned(), before: true, ..About::default() };
    let mut writer = Writer::create(&path, &about, "{}").expect("the file can be made");
    writer.before(&Frame::of::<TracksTopic>(&Header::new(7, 0, 0), &[], 1));
    for seq in 1..4 {
        writer.frame(&frame(seq));
        let what = Happened::Died { stage: "encoder".to_owned(), how: "was killed".to_owned(), next: 1 };
        writer.event(&Event { at_ns: seq * 80_000_000 + 6, what });
        let (at_ns, stage) = (seq * 80_000_000 + 7, "encoder".to_owned());
        writer.line(&LogLine { at_ns, stage, line: "\"x\" ü".to_owned() });
    }
    writer.finish("the run has ended").expect("the file can be finished");
    fs::read(path).expect("the file is there")
}

/// The file's records.
fn records(file: &[u8]) -> Vec<Record> {
    let mut rest = &file[MAGIC.len()..file.len() - MAGIC.len()];
    let read = || {
        let (op, body) = record(&mut rest)?;
        let bytes = if op == op::CHUNK { unpack(body).expect("a good chunk") } else { body.to_vec() };
        Some(Record { op, bytes })
    };
    std::iter::from_fn(read).collect()
}

/// A file of records; each chunk gets a valid check value for its content.
fn file(records: &[Record]) -> Vec<u8> {
    let mut file = MAGIC.to_vec();
    for Record { op, bytes } in records {
        let body = if *op == op::CHUNK {
            let head = Body::default().u64(0).u64(0).u64(bytes.len() as u64).u32(crc32fast::hash(bytes));
            head.text("").u64(bytes.len() as u64).raw(bytes)
        } else {
            Body::default().raw(bytes)
        };
        body.record(*op, &mut file);
    }
    file.extend(MAGIC);
    file
}

/// Applies edits of four bytes each: position (two bytes), operation, and byte or word.
fn edit(bytes: &mut Vec<u8>, edits: &[u8]) {
    for edit in edits.chunks_exact(4) {
        let place = usize::from(u16::from_le_bytes([edit[0], edit[1]])) % (bytes.len() + 1);
        let word = WORDS[usize::from(edit[3]) % WORDS.len()];
        let end = (place + word.len()).min(bytes.len());
        match edit[2] % 6 {
            0 if place < bytes.len() => bytes[place] = edit[3],
            1 => bytes.insert(place, edit[3]),
            2 => drop(bytes.drain(place..(place + usize::from(edit[3] % 16)).min(bytes.len()))),
            3 => bytes.truncate(place),
            _ => drop(bytes.splice(place..end, word.iter().copied())),
        }
    }
}

/// A folder for files, and a reader for them.
struct Reader {
    _folder: TempDir,
    path: PathBuf,
}

impl Reader {
    /// Reads the whole file. Returns the number of messages, or `None` if the file can't be opened.
    fn read(&self, bytes: &[u8]) -> Option<usize> {
        fs::write(&self.path, bytes).expect("the file can be written");
        let recording =
            Recording::open(&self.path).map_err(|error| assert!(!error.to_string().is_empty())).ok()?;
        let _ = recording.verify();
        let messages = recording.messages().filter_map(Result::ok).map(|message| {
            if let Message::Frame(frame) | Message::Before(frame) = message {
                let _ = frame.elements::<DetectionsTopic>();
                let _ = frame.elements::<TracksTopic>();
                let _ = (frame.header().hops(), frame.topic().name);
            }
        });
        Some(messages.count())
    }
}

fn fuzz(change: impl Fn(&[u8], &[u8]) -> Vec<u8> + std::panic::RefUnwindSafe) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let good = good(folder.path());
    let reader = Reader { path: folder.path().join("hurt.mcap"), _folder: folder };
    assert_eq!(reader.read(&change(&good, &[])), Some(10), "nothing is lost of a good file");
    bolero::check!().with_iterations(ITERATIONS).with_max_len(EDITS_BYTES_MAX).for_each(|edits: &[u8]| {
        reader.read(&change(&good, edits));
    });
}

#[test]
fn recording_bytes() {
    fuzz(|good, edits| {
        let mut hurt = good.to_vec();
        edit(&mut hurt, edits);
        hurt
    });
}

/// One byte selects the record: a chunk, the channels, or the description of the run.
#[test]
fn recording_records() {
    fuzz(|good, edits| {
        let mut records = records(good);
        if let Some((which, edits)) = edits.split_first() {
            let which = usize::from(*which) % records.len();
            // Most of the content is in the chunk.
            let chunk = records.iter().position(|record| record.op == op::CHUNK).unwrap_or(which);
            let which = if which.is_multiple_of(2) { chunk } else { which };
            edit(&mut records[which].bytes, edits);
        }
        file(&records)
    });
}
