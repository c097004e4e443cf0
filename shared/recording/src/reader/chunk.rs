//! Splits consecutive records, and unpacks the content of a chunk.

use std::io::{self, Read as _};

use lz4_flex::frame::FrameDecoder;
use mcap::records::{Record, op};
use ruzstd::decoding::StreamingDecoder;

use crate::format::PREFIX;

/// Largest record that is read into memory, and largest content of a chunk.
pub(super) const RECORD_BYTES_MAX: u64 = 1 << 30;
/// Bytes that the chunks of any file may unpack to, and further bytes for each byte of the file. A few bytes of a
/// Zstandard frame can stand for gigabytes. LZ4 packs at most 255 bytes into one.
const UNPACKED_BYTES: u64 = 64 << 20;
const UNPACKED_FACTOR: u64 = 255;

/// The bytes that the chunks of a file may still unpack to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Allowance {
    rest: u64,
    most: u64,
}

impl Allowance {
    /// The allowance of a file of this length.
    pub fn new(file_len: u64) -> Self {
        let most = UNPACKED_BYTES.saturating_add(file_len.saturating_mul(UNPACKED_FACTOR));
        Self { rest: most, most }
    }

    /// All bytes of the allowance.
    pub const fn most(self) -> u64 {
        self.most
    }

    /// Takes the content of a chunk from the allowance.
    ///
    /// # Errors
    /// The limit, if the allowance is used up.
    pub fn take(&mut self, unpacked_len: u64) -> Result<(), String> {
        self.rest = self.rest.checked_sub(unpacked_len).ok_or_else(|| {
            let most = self.most;
            format!(
                "the chunks unpack to more than {most} bytes, the limit for this file: {UNPACKED_BYTES} and \
                 {UNPACKED_FACTOR} times its size"
            )
        })?;
        Ok(())
    }
}

/// The length of a chunk's content, from the start of the record's body.
pub(crate) fn unpacked_len(body: &[u8]) -> u64 {
    // The times of the first and last message precede the length.
    body.get(16..).and_then(|body| body.first_chunk()).map_or(0, |bytes| u64::from_le_bytes(*bytes))
}
/// First bytes of a frame that readers skip, except for the lower half of the first byte; the length follows.
/// LZ4 and Zstandard share this format.
const SKIPPED: [u8; 4] = [0x50, 0x2A, 0x4D, 0x18];

/// Splits the first record off `bytes`: its opcode and its body. `None` if the record is not whole.
pub(crate) fn record<'a>(bytes: &mut &'a [u8]) -> Option<(u8, &'a [u8])> {
    let (prefix, rest) = bytes.split_first_chunk::<PREFIX>()?;
    let (op, len) = parts(prefix);
    let (body, rest) = rest.split_at_checked(usize::try_from(len).ok()?)?;
    *bytes = rest;
    Some((op, body))
}

/// A record's opcode, and the length of its body.
pub(super) fn parts(prefix: &[u8; PREFIX]) -> (u8, u64) {
    let [op, len @ ..] = *prefix;
    (op, u64::from_le_bytes(len))
}

/// The records of a chunk, from the record's `body`: decompressed and verified against the check value.
pub(crate) fn unpack(body: &[u8]) -> Result<Vec<u8>, String> {
    let Ok(Record::Chunk { header, data: packed }) = mcap::parse_record(op::CHUNK, body) else {
        return Err("a chunk that is not whole".to_owned());
    };
    let len = header.uncompressed_size;
    if len > RECORD_BYTES_MAX {
        return Err(format!("a chunk of {len} bytes, at most {RECORD_BYTES_MAX} are read"));
    }
    let bytes = match header.compression.as_str() {
        "" => Ok(packed.into_owned()),
        "lz4" => {
            frames(&packed, len, |rest, most, bytes| FrameDecoder::new(rest).take(most).read_to_end(bytes))
        }
        "zstd" => frames(&packed, len, |rest, most, bytes| {
            StreamingDecoder::new(rest).map_err(io::Error::other)?.take(most).read_to_end(bytes)
        }),
        other => return Err(format!("a chunk with the unknown compression \"{other}\"")),
    };
    let bytes = bytes.map_err(|error| format!("a chunk that can't be decompressed: {error}"))?;
    if bytes.len() as u64 != len {
        return Err(format!("a chunk of {} bytes, which should have {len}", bytes.len()));
    }
    let (found, expected) = (crc32fast::hash(&bytes), header.uncompressed_crc);
    // 0 means that the writer computed no check value.
    if expected != 0 && found != expected {
        return Err(format!("the chunk has the check value {found:08x}, not {expected:08x}"));
    }
    Ok(bytes)
}

/// The body length of a chunk that starts with `head`. `None` unless it has a check value and plausible
/// lengths of at most `most` bytes in all. `head` is any part of a file.
pub(super) fn plausible(head: &[u8], most: u64) -> Option<u64> {
    let (op, body) = (head.first()?, head.get(PREFIX..)?);
    let u32_at = |at: usize| Some(u32::from_le_bytes(*body.get(at..)?.first_chunk()?));
    let u64_at = |at: usize| Some(u64::from_le_bytes(*body.get(at..)?.first_chunk()?));
    let (_, body_len) = parts(head.first_chunk()?);
    let (crc, name_len) = (u32_at(24)?, u32_at(28)?);
    let name = body.get(32..)?.get(..usize::try_from(name_len).ok()?)?;
    let packed_len = u64_at(32 + name.len())?;
    let is_plausible = *op == op::CHUNK
        && crc != 0
        && matches!(name, b"" | b"lz4" | b"zstd")
        && packed_len.checked_add(40 + name.len() as u64) == Some(body_len)
        && body_len.checked_add(PREFIX as u64).is_some_and(|len| len <= most);
    is_plausible.then_some(body_len)
}

/// Decompresses consecutive frames until there are `len` bytes, or one byte more; the rest is ignored.
/// `frame` takes a frame from the front of its first argument and appends at most the given number of bytes
/// to its last.
fn frames(
    packed: &[u8],
    len: u64,
    frame: impl Fn(&mut &[u8], u64, &mut Vec<u8>) -> io::Result<usize>,
) -> io::Result<Vec<u8>> {
    let (mut rest, mut bytes) = (packed, Vec::new());
    bytes.try_reserve_exact(usize::try_from(len).map_err(io::Error::other)? + 1).map_err(io::Error::other)?;
    while !rest.is_empty() && (bytes.len() as u64) < len {
        match rest {
            [first, second, third, fourth, a, b, c, d, behind @ ..]
                if [first & 0xF0, *second, *third, *fourth] == SKIPPED =>
            {
                let skipped = u32::from_le_bytes([*a, *b, *c, *d]) as usize;
                rest = behind.get(skipped..).unwrap_or_default();
            }
            _ => {
                // One byte more than expected shows that the content is longer.
                let most = len + 1 - bytes.len() as u64;
                frame(&mut rest, most, &mut bytes)?;
            }
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use lz4_flex::frame::FrameEncoder;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};

    use super::*;
    use crate::format::Body;

    /// The body of a chunk with this content.
    fn chunk(compression: &str, packed: &[u8], content: &[u8]) -> Vec<u8> {
        let body = Body::default().u64(0).u64(0).u64(content.len() as u64).u32(crc32fast::hash(content));
        let mut record = Vec::new();
        body.text(compression).u64(packed.len() as u64).raw(packed).record(op::CHUNK, &mut record);
        record.split_off(PREFIX)
    }

    fn lz4(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = FrameEncoder::new(Vec::new());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn zstd(bytes: &[u8]) -> Vec<u8> {
        compress_to_vec(bytes, CompressionLevel::Fastest)
    }

    #[test]
    fn every_compression_is_read_in_any_number_of_frames() {
        let content: Vec<u8> = (0..200_000_u32).flat_map(|i| (i / 7).to_le_bytes()).collect();
        let halves = content.split_at(123_456);
        let skipped = [&SKIPPED[..], &3_u32.to_le_bytes(), b"abc"].concat();
        for (name, pack) in [("lz4", lz4 as fn(&[u8]) -> Vec<u8>), ("zstd", zstd)] {
            let two = [pack(halves.0), skipped.clone(), pack(halves.1), b"padding".to_vec()].concat();
            for packed in [pack(&content), two] {
                assert_eq!(unpack(&chunk(name, &packed, &content)), Ok(content.clone()), "{name}");
                let error = unpack(&chunk(name, &packed[..packed.len() / 2], &content)).unwrap_err();
                assert!(error.starts_with("a chunk"), "{error}");
            }
        }
        assert_eq!(unpack(&chunk("", &content, &content)), Ok(content.clone()));
        let error = unpack(&chunk("xz", &content, &content)).unwrap_err();
        assert!(error.ends_with("the unknown compression \"xz\""), "{error}");
    }

    #[test]
    fn a_wrong_check_value_is_found_and_none_is_accepted() {
        let mut body = chunk("", b"abc", b"abc");
        body[24] ^= 1;
        assert!(unpack(&body).unwrap_err().contains("check value"));
        body[24..28].fill(0);
        assert_eq!(unpack(&body), Ok(b"abc".to_vec()));
    }
}
