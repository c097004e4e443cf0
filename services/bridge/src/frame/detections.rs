//! Detections as the body of a frame: a [`TickHead`], and a [`wire::Detection`] for each. They are exact: a run
//! gets from the bridge what its sender has sent.

use bytemuck::{bytes_of, cast_slice};
use wire::{DETECTIONS_MAX, Detection};

use super::{Bytes, Refused, TickHead};

/// Most bytes of a body.
pub const BODY_BYTES_MAX: usize = size_of::<TickHead>() + DETECTIONS_MAX * size_of::<Detection>();

/// A sensor's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Detections {
    /// Stamp, interval and pose.
    pub head: TickHead,
    /// The detections.
    pub detections: Vec<Detection>,
}

/// Writes a body with the first [`DETECTIONS_MAX`] detections. The others are added to the count of those left
/// out.
pub fn write(body: &mut Vec<u8>, head: &TickHead, detections: &[Detection]) {
    let (sent, left_out) = detections.split_at(detections.len().min(DETECTIONS_MAX));
    let left_out_len = head.left_out_len.saturating_add(u16::try_from(left_out.len()).unwrap_or(u16::MAX));
    let head = TickHead { elements_len: sent.len() as u16, left_out_len, ..*head };
    body.clear();
    body.extend_from_slice(bytes_of(&head));
    body.extend_from_slice(cast_slice(sent));
}

/// Reads a body.
///
/// # Errors
/// [`Refused`] names the first impossible value.
pub fn read(body: &[u8]) -> Result<Detections, Refused> {
    let mut bytes = Bytes(body);
    let head = bytes.head(DETECTIONS_MAX)?;
    let mut detections = Vec::with_capacity(head.elements_len.into());
    for _ in 0..head.elements_len {
        let detection: Detection = bytes.take()?;
        detection.check()?;
        detections.push(detection);
    }
    bytes.end()?;
    Ok(Detections { head, detections })
}
