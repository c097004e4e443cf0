//! The messages of any MCAP file, such as a rosbag2 of ROS 2.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Read as _};

use lz4_flex::frame::FrameDecoder;
use mcap::MAGIC;
use mcap::records::{Record, op};
use ruzstd::decoding::StreamingDecoder;

use crate::reader::{Allowance, record, unpack, unpacked_len};

/// A message of a bag.
#[derive(Clone, Copy, Debug)]
pub struct BagMessage<'a> {
    /// Its place among all messages of the file, from 1.
    pub number: usize,
    /// The topic.
    pub topic: &'a str,
    /// The name of its schema, such as `std_msgs/msg/String`; empty without a schema.
    pub schema: &'a str,
    /// The encoding, such as `cdr`.
    pub encoding: &'a str,
    /// When it was recorded, in Unix time.
    pub log_ns: u64,
    /// The message.
    pub data: &'a [u8],
}

#[derive(Default)]
struct Known {
    schemas: BTreeMap<u16, String>,
    /// Topic, schema and encoding.
    channels: BTreeMap<u16, [String; 3]>,
    message_count: usize,
}

/// Whether the bytes begin as an MCAP file.
#[must_use]
pub fn is_bag(bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
}

/// Whether the bytes end as an MCAP file.
#[must_use]
pub fn is_end_of_bag(bytes: &[u8]) -> bool {
    bytes.ends_with(MAGIC)
}

/// The content of a file that may be compressed as a whole with Zstandard or LZ4, as rosbag2 compresses files. A
/// compressed file that was cut off has the content up to the cut.
///
/// # Errors
/// The limit, if the content is larger than `most`, or than that of any plausible file of this size.
pub fn unpacked_file(bytes: &[u8], most: u64) -> Result<Cow<'_, [u8]>, String> {
    let most = Allowance::new(bytes.len() as u64).most().min(most);
    let mut unpacked = Vec::new();
    let read = match bytes {
        [0x28, 0xB5, 0x2F, 0xFD, ..] => StreamingDecoder::new(bytes)
            .map_err(io::Error::other)
            .and_then(|decoder| decoder.take(most + 1).read_to_end(&mut unpacked)),
        [0x04, 0x22, 0x4D, 0x18, ..] => FrameDecoder::new(bytes).take(most + 1).read_to_end(&mut unpacked),
        _ => return Ok(Cow::Borrowed(bytes)),
    };
    match read {
        _ if unpacked.len() as u64 > most => {
            Err(format!("unpacks to more than {most} bytes, the limit for this file"))
        }
        Err(error) if unpacked.is_empty() => Err(format!("can't be decompressed: {error}")),
        _ => Ok(Cow::Owned(unpacked)),
    }
}

/// The parts of a bag that can't be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// The byte at which the file is cut off.
    pub cut: Option<usize>,
    /// The chunks without a check value whose records do not follow each other, by their first byte. Their records up
    /// to the damage are read.
    pub chunks: Vec<usize>,
}

/// Calls `take` with each message, in the order of the file. A file that was cut off has the messages up to its
/// last whole record. Returns what can't be read.
///
/// # Errors
/// The damaged part of the file, or the error of `take`.
pub fn bag_messages<E: From<String>>(
    bytes: &[u8],
    mut take: impl FnMut(BagMessage<'_>) -> Result<(), E>,
) -> Result<Damage, E> {
    let mut chunks = Vec::new();
    let cut = messages(bytes, &mut chunks, &mut take)?;
    Ok(Damage { cut, chunks })
}

/// Reads the messages, and returns the place of the cut. `damaged` receives the damaged chunks.
fn messages<E: From<String>>(
    bytes: &[u8],
    damaged: &mut Vec<usize>,
    take: &mut impl FnMut(BagMessage<'_>) -> Result<(), E>,
) -> Result<Option<usize>, E> {
    let mut rest = bytes.strip_prefix(MAGIC).ok_or_else(|| "not an MCAP file".to_owned())?;
    let (mut known, mut allowance) = (Known::default(), Allowance::new(bytes.len() as u64));
    loop {
        let at = bytes.len() - rest.len();
        let Some((op, body)) = record(&mut rest) else { return Ok(Some(at)) };
        // Zeros follow the cut after a power loss. They may be part of the last record.
        let is_last = !rest.is_empty() && rest.iter().all(|byte| *byte == 0);
        match op {
            0 => return Ok(Some(at)),
            op::CHUNK => {
                allowance.take(unpacked_len(body))?;
                let limits = Limits::of(body);
                let chunk = match unpack(body) {
                    Err(_) if is_last => return Ok(Some(at)),
                    chunk => chunk?,
                };
                let mut chunk = &chunk[..];
                if is_last && !is_whole(chunk) {
                    return Ok(Some(at));
                }
                while let Some((op, body)) = record(&mut chunk) {
                    if limits.is_some_and(|limits| !known.fits(op, body, limits)) {
                        damaged.push(at);
                        chunk = &[];
                        break;
                    }
                    known.take(op, body, take)?;
                }
                if limits.is_some() && !chunk.is_empty() {
                    damaged.push(at);
                }
            }
            op::MESSAGE if is_last && body.last() == Some(&0) => return Ok(Some(at)),
            op::DATA_END | op::FOOTER => return Ok(None),
            op => known.take(op, body, take)?,
        }
    }
}

/// Whether the content of a chunk consists of whole records that do not end with zeros. 0 is not a valid opcode.
fn is_whole(mut chunk: &[u8]) -> bool {
    let mut is_whole = true;
    while let Some((op, body)) = record(&mut chunk) {
        is_whole = op != 0 && (op != op::MESSAGE || body.last() != Some(&0));
        if op == 0 {
            break;
        }
    }
    is_whole && chunk.is_empty()
}

/// First and last time of the messages in a chunk without a check value, in ns.
#[derive(Clone, Copy, Debug)]
struct Limits([u64; 2]);

impl Limits {
    /// The limits of a chunk, from its record. `None` if the chunk has a check value.
    fn of(body: &[u8]) -> Option<Self> {
        let u64_at = |at: usize| Some(u64::from_le_bytes(*body.get(at..)?.first_chunk()?));
        let has_check_value = body.get(24..28)? != [0; 4];
        if has_check_value { None } else { Some(Self([u64_at(0)?, u64_at(8)?])) }
    }
}

impl Known {
    /// Whether a record can be one of this chunk: it can be parsed, and a message has a known channel and a time of the
    /// chunk. Some writers leave out the times.
    fn fits(&self, op: u8, body: &[u8], Limits([first_ns, last_ns]): Limits) -> bool {
        match op {
            0 => false,
            op::SCHEMA | op::CHANNEL => mcap::parse_record(op, body).is_ok(),
            op::MESSAGE => match mcap::parse_record(op, body) {
                Ok(Record::Message { header, .. }) => {
                    self.channels.contains_key(&header.channel_id)
                        && (last_ns == 0 || (first_ns..=last_ns).contains(&header.log_time))
                }
                _ => false,
            },
            _ => true,
        }
    }

    fn take<E: From<String>>(
        &mut self,
        op: u8,
        body: &[u8],
        take: &mut impl FnMut(BagMessage<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        if !matches!(op, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        match mcap::parse_record(op, body).map_err(|error| error.to_string())? {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                self.channels.insert(channel.id, [channel.topic, schema, channel.message_encoding]);
            }
            Record::Message { header, data } => {
                self.message_count += 1;
                let (number, log_ns) = (self.message_count, header.log_time);
                let Some([topic, schema, encoding]) = self.channels.get(&header.channel_id) else {
                    return Err(format!("message {number}: its channel is missing").into());
                };
                take(BagMessage { number, topic, schema, encoding, log_ns, data: &data })?;
            }
            _ => {}
        }
        Ok(())
    }
}
