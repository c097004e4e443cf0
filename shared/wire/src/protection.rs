//! End-to-end protection: the sender computes a check value over header and payload, and the reader verifies
//! it.

use bytemuck::{bytes_of, cast_slice};
use crc_fast::{CrcAlgorithm, Digest};

use crate::{Header, Protection, RefusalCause, Rejected, Topic};

/// The number of a topic in [`Protection::data_id`]: FNV-1a of its name, in 32 bits.
#[must_use]
pub const fn data_id(topic: &str) -> u32 {
    let (bytes, mut hash, mut i) = (topic.as_bytes(), 0x811C_9DC5_u32, 0);
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u32).wrapping_mul(0x0100_0193);
        i += 1;
    }
    hash
}

impl Protection {
    /// If a frame's counter is at most this far behind the newest one, the frame is repeated or overtaken. If
    /// it is farther behind, the sender has restarted.
    pub const REPEATED_MAX: u32 = 16;

    /// The protection of a frame: it covers `payload`, and `header` except for its own check value.
    #[must_use]
    pub fn of<T: Topic>(header: &Header, payload: &[T::Element], counter: u32) -> Self {
        Self::of_bytes(T::NAME, header, cast_slice(payload), counter)
    }

    /// The protection of a frame of a named topic whose elements are bytes.
    #[must_use]
    pub fn of_bytes(topic: &str, header: &Header, payload: &[u8], counter: u32) -> Self {
        let unchecked =
            Self { crc: 0, length: length(payload), counter, data_id: data_id(topic), reserved: [0; 4] };
        Self { crc: crc(&Header { protection: unchecked, ..*header }, payload), ..unchecked }
    }

    /// Whether the frame has no protection.
    pub fn is_absent(&self) -> bool {
        *self == Self::default()
    }

    /// Refuses a frame that differs from the one its sender protected.
    ///
    /// # Errors
    /// [`Rejected::Unprotected`], [`Rejected::CheckValue`], or [`Rejected::Misdirected`] for a frame of another
    /// topic.
    pub fn check<T: Topic>(header: &Header, payload: &[T::Element]) -> Result<(), Rejected> {
        let protection = header.protection;
        if protection.is_absent() {
            return Err(Rejected::Unprotected);
        }
        let payload = cast_slice(payload);
        let expected = crc(header, payload);
        if protection.crc != expected || protection.length != length(payload) {
            return Err(Rejected::CheckValue { found: protection.crc, expected });
        }
        let expected = data_id(T::NAME);
        if protection.data_id != expected {
            return Err(Rejected::Misdirected { found: protection.data_id, expected });
        }
        Ok(())
    }

    /// Refuses a repeated or overtaken frame. `newest` is the counter of the same sender's newest frame.
    ///
    /// # Errors
    /// [`Rejected::Repeated`].
    pub const fn check_counter(&self, newest: u32) -> Result<(), Rejected> {
        if newest.wrapping_sub(self.counter) <= Self::REPEATED_MAX {
            return Err(Rejected::Repeated { counter: self.counter, newest });
        }
        Ok(())
    }
}

fn length(payload: &[u8]) -> u32 {
    (size_of::<Header>() + payload.len()) as u32
}

fn crc(header: &Header, payload: &[u8]) -> u64 {
    crc64(&[&bytes_of(header)[size_of::<u64>()..], payload])
}

/// CRC-64/XZ of the parts, as if they were one.
// Not generic: the code for each kind of processor is linked once, and not with each topic.
#[must_use]
pub fn crc64(parts: &[&[u8]]) -> u64 {
    let mut digest = Digest::new(CrcAlgorithm::Crc64Xz);
    parts.iter().for_each(|part| digest.update(part));
    digest.finalize()
}

impl Rejected {
    /// The cause for which a refused frame is counted.
    pub const fn cause(&self) -> RefusalCause {
        match self {
            Self::Schema { .. } => RefusalCause::Schema,
            Self::ForeignRun { .. } => RefusalCause::ForeignRun,
            Self::OldIncarnation { .. } => RefusalCause::OldIncarnation,
            Self::TooMany { .. } | Self::Length { .. } | Self::Mismatch { .. } => RefusalCause::Size,
            Self::NotFinite { .. } | Self::Impossible { .. } => RefusalCause::Value,
            Self::Twice { .. } | Self::OutOfOrder { .. } | Self::NotNewer { .. } => RefusalCause::Order,
            Self::CheckValue { .. } | Self::Misdirected { .. } => RefusalCause::CheckValue,
            Self::Unprotected => RefusalCause::Unprotected,
            Self::Repeated { .. } => RefusalCause::Repeated,
            Self::Frozen { .. } => RefusalCause::Frozen,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DetectionsTopic, Forecast, ForecastsTopic, TracksTopic};
    use bytemuck::Zeroable;

    fn forecasts() -> (Header, Vec<Forecast>) {
        let mut header = Header::new(7, 3, 240_000_000);
        header.counts.agents_len = 3;
        (header, vec![Forecast { id: 5, x_m: 1.5, ..Zeroable::zeroed() }; 3])
    }

    fn protected(header: &Header, payload: &[Forecast], counter: u32) -> Header {
        Header { protection: Protection::of::<ForecastsTopic>(header, payload, counter), ..*header }
    }

    #[test]
    fn the_check_value_is_that_of_crc_64_xz() {
        // The catalogue's check value of the ASCII digits 1 to 9.
        assert_eq!(crc64(&[b"123456789"]), 0x995D_C9BB_DF19_39FA);
        assert_eq!(crc64(&[b"1234", b"", b"56789"]), 0x995D_C9BB_DF19_39FA);
        assert_eq!(data_id(""), 0x811C_9DC5);
        assert_eq!(data_id("a"), 0xE40C_292C);
    }

    #[test]
    fn a_protected_frame_passes_and_its_parts_are_told_apart() {
        let (header, payload) = forecasts();
        let good = protected(&header, &payload, 9);
        assert_eq!(Protection::check::<ForecastsTopic>(&good, &payload), Ok(()));
        let shorter = Protection::check::<ForecastsTopic>(&good, &payload[..2]);
        assert!(matches!(shorter, Err(Rejected::CheckValue { .. })));
        let unprotected = Protection::check::<ForecastsTopic>(&header, &payload);
        assert_eq!(unprotected, Err(Rejected::Unprotected));
        let empty = Header { protection: Protection::of::<TracksTopic>(&header, &[], 0), ..header };
        let elsewhere = Protection::check::<DetectionsTopic>(&empty, &[]);
        assert!(matches!(elsewhere, Err(Rejected::Misdirected { .. })), "{elsewhere:?}");
    }

    #[test]
    fn repeated_and_overtaken_frames_are_refused_and_new_senders_are_not() {
        let counter = |counter| Protection { counter, ..Protection::default() };
        assert_eq!(counter(8).check_counter(7), Ok(()));
        assert_eq!(counter(0).check_counter(u32::MAX), Ok(()), "it wraps around");
        assert_eq!(counter(7).check_counter(7), Err(Rejected::Repeated { counter: 7, newest: 7 }));
        assert!(counter(u32::MAX).check_counter(3).is_err());
        assert_eq!(counter(0).check_counter(17), Ok(()), "a sender that began anew");
    }

    /// A xorshift generator: the state and its next number.
    fn next(state: &mut u64) -> u64 {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        *state
    }

    #[test]
    fn ten_thousand_bit_flips_are_refused() {
        let (header, mut payload) = forecasts();
        for (i, byte) in bytemuck::cast_slice_mut::<_, u8>(&mut payload).iter_mut().enumerate() {
            *byte = (i * 31 % 251) as u8;
        }
        let good = protected(&header, &payload, 9);
        let bits = 8 * (size_of::<Header>() + size_of_val(&payload[..])) as u64;
        let mut random = 0x9E37_79B9_7F4A_7C15;
        for flip in 0..10_000 {
            let (mut header, mut payload) = (good, payload.clone());
            for _ in 0..=flip % 3 {
                let bit = (next(&mut random) % bits) as usize;
                let (byte, mask) = (bit / 8, 1 << (bit % 8));
                match byte.checked_sub(size_of::<Header>()) {
                    None => bytemuck::bytes_of_mut(&mut header)[byte] ^= mask,
                    Some(byte) => bytemuck::cast_slice_mut::<_, u8>(&mut payload)[byte] ^= mask,
                }
            }
            let refused = Protection::check::<ForecastsTopic>(&header, &payload);
            assert!(refused.is_err(), "flip {flip} passes");
        }
    }
}
