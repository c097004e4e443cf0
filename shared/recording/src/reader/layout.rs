//! The records of a file, from its start to its end or to the torn place.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt as _;

use mcap::MAGIC;
use mcap::records::op;

use super::chunk::{Allowance, RECORD_BYTES_MAX, parts, plausible, unpack, unpacked_len};
use crate::format::PREFIX;

/// Bytes that are searched at a time.
const BLOCK: u64 = 1 << 20;
/// Bytes at the front of a chunk that identify it, with the longest name of a compression.
const HEAD: u64 = PREFIX as u64 + 44;

/// A file of records.
#[derive(Debug)]
pub(super) struct Layout {
    file: File,
    /// Bytes of the file.
    pub len: u64,
}

/// A record's place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub op: u8,
    /// The record's first byte.
    pub at: u64,
    /// Bytes of its body.
    body_len: u64,
}

impl Place {
    /// The first byte of its body.
    pub const fn body_at(&self) -> u64 {
        self.at + PREFIX as u64
    }

    /// The first byte after the record.
    pub const fn end(&self) -> u64 {
        self.body_at() + self.body_len
    }
}

impl Layout {
    pub fn new(file: File) -> io::Result<Self> {
        let len = file.metadata()?.len();
        Ok(Self { file, len })
    }

    /// Whether the magic bytes are at a position.
    pub fn magic_at(&self, at: u64) -> io::Result<bool> {
        Ok(self.bytes(at, at + MAGIC.len() as u64)? == MAGIC)
    }

    /// The bytes between two positions, as far as the file has them.
    pub fn bytes(&self, at: u64, end: u64) -> io::Result<Vec<u8>> {
        let len = end.min(self.len).saturating_sub(at);
        let mut bytes = vec![0; usize::try_from(len).map_err(io::Error::other)?];
        self.file.read_exact_at(&mut bytes, at)?;
        Ok(bytes)
    }

    /// The body of a record.
    pub fn body(&self, place: Place) -> io::Result<Vec<u8>> {
        self.bytes(place.body_at(), place.end())
    }

    /// The record at a position, if it is whole there. 0 is not a valid opcode.
    pub fn record(&self, at: u64) -> io::Result<Option<Place>> {
        let prefix = self.bytes(at, at.saturating_add(PREFIX as u64))?;
        let Some(prefix) = prefix.first_chunk() else { return Ok(None) };
        let (op, body_len) = parts(prefix);
        let most = self.len - at - PREFIX as u64;
        Ok((op != 0 && body_len <= most).then_some(Place { op, at, body_len }))
    }

    /// The first chunk at or after `at` with a valid check value. It skips bytes that are not records. Each
    /// attempt to unpack a chunk is taken from `allowance`.
    pub fn whole_chunk(&self, mut at: u64, allowance: &mut Allowance) -> io::Result<Option<Place>> {
        while at < self.len {
            let block = self.bytes(at, at + BLOCK + HEAD)?;
            let firsts =
                block.iter().enumerate().take(BLOCK as usize).filter(|(_, byte)| **byte == op::CHUNK);
            for (number, _) in firsts {
                let begin = at + number as u64;
                let most = (self.len - begin).min(RECORD_BYTES_MAX);
                let Some(body_len) = plausible(&block[number..], most) else { continue };
                let place = Place { op: op::CHUNK, at: begin, body_len };
                let mut attempts = *allowance;
                attempts.take(unpacked_len(&block[number + PREFIX..])).map_err(io::Error::other)?;
                if unpack(&self.body(place)?).is_ok() {
                    // The scan takes the content of a whole chunk.
                    return Ok(Some(place));
                }
                *allowance = attempts;
            }
            at += BLOCK;
        }
        Ok(None)
    }

    /// Describes a position without a record.
    pub fn why_torn(&self, at: u64) -> io::Result<&'static str> {
        let front = self.bytes(at, at + PREFIX as u64)?;
        Ok(match front.first() {
            None => "the file ends here, without an index",
            Some(_) if front.iter().all(|byte| *byte == 0) => "zeros follow, as after a power loss",
            Some(_) => "what follows is no whole record",
        })
    }

    /// The check value of all bytes between two positions.
    pub fn check_value(&self, mut at: u64, end: u64) -> io::Result<u32> {
        let mut hasher = crc32fast::Hasher::new();
        while at < end {
            let block = self.bytes(at, end.min(at + BLOCK))?;
            hasher.update(&block);
            at += block.len() as u64;
        }
        Ok(hasher.finalize())
    }
}
