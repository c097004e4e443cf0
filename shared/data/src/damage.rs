//! Doubts about files that end in the middle or are damaged.

use audit::Found;

use crate::{Input, Recording};

/// A doubt about the file as a whole.
pub(crate) fn doubt(kind: &str, sentence: String) -> Found {
    Found { kind: kind.to_owned(), sentence, doubtful: true, ..Found::default() }
}

/// The doubt about a file that ends in the middle.
pub(crate) fn cut_finding(part: &Input, at: usize, recording: &Recording) -> Found {
    let (path, len) = (&part.path, part.bytes.len());
    let stamps_ns = || recording.frames.iter().map(|frame| frame.stamp_ns);
    let last_ns = stamps_ns().next_back().unwrap_or(0);
    let span_s = (last_ns - stamps_ns().next().unwrap_or(0)) as f64 * 1e-9;
    let last_s = last_ns as f64 * 1e-9;
    let sentence = format!(
        "the file {path} is cut off at byte {at} of {len}: it is played up to {span_s:.3} s, stamp {last_s:.3}, and what \
         followed is missing"
    );
    doubt("cut_off", sentence)
}

/// The doubt about chunks that can't be read to their end, by their first bytes.
pub(crate) fn damage_finding(part: &Input, chunks: &[usize]) -> Option<Found> {
    let (first, count) = (chunks.first()?, chunks.len());
    let (path, len) = (&part.path, part.bytes.len());
    let sentence = format!(
        "the file {path} is damaged: the rest of {count} chunks is left out, the first one of the chunk at byte {first} of {len}"
    );
    Some(doubt("damaged", sentence))
}
