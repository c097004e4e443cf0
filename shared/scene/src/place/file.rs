//! Memory files: what is remembered of N moments, oldest first, as safetensors.
//!
//! `memory.gait` u8 \[N\], 0 driving, 1 walking; `memory.moment` f32 \[N, 6\], of who drives x, y, heading, speed, acceleration and turn
//! rate, of who walks x, y and the velocity's x and y; `memory.driven` u8 \[N\], steps driven since; `memory.departure` f32
//! \[N, steps, 2\], NaN where unknown; `memory.skill` f32 \[2 gaits, steps, 2, 2\]; `memory.step_ns` i64 \[1\]. The metadata `weights` are the
//! SHA-256 of those whose forecasts were departed from.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensorError, TensorView};
use safetensors::{SafeTensors, serialize};
use wire::{HORIZON_MAX, POSITION_MAX_M};

use super::moment::COMPONENTS;
use super::path::{DEPARTURE_MAX, Departures, Skill};
use super::{Gait, MOMENTS_MAX, Memory, Moment, PlaceMemory};
use crate::FileError;
use crate::file::{Target, finite_numbers, numbers};

const GAIT: &str = "memory.gait";
const MOMENT: &str = "memory.moment";
const DRIVEN: &str = "memory.driven";
const DEPARTURE: &str = "memory.departure";
const SKILL: &str = "memory.skill";
const STEP_NS: &str = "memory.step_ns";
const WEIGHTS: &str = "weights";
/// The largest memory with a generous header.
const BYTES_MAX: u64 = (MOMENTS_MAX * (2 + 4 * (COMPONENTS + 2 * HORIZON_MAX)) + (1 << 20)) as u64;

impl PlaceMemory {
    /// Writes what is remembered, of forecasts of these weights, to a file, all of it or nothing.
    ///
    /// # Errors
    /// [`FileError::Io`] where the folder can't be written.
    pub fn save(&self, path: &Path, weights_sha256: &str) -> Result<(), FileError> {
        let target = target(path);
        let bytes = self.to_bytes(weights_sha256).map_err(|source| target.format(source))?;
        target.write(&bytes)
    }

    /// Reads what was remembered during other stays, of forecasts of these weights, which have so many steps of such a length.
    ///
    /// # Errors
    /// [`FileError`] where the file can't be read, is no memory, is one of other weights' forecasts, or holds numbers that no
    /// memory has.
    pub fn load(
        path: &Path,
        weights_sha256: &str,
        (horizon_len, step_ns): (usize, u64),
    ) -> Result<Self, FileError> {
        let target = target(path);
        let memory = Self::from_bytes(&target.read(BYTES_MAX)?, weights_sha256, target)?;
        if (memory.horizon_len, memory.step_ns) == (horizon_len, step_ns.cast_signed()) {
            return Ok(memory);
        }
        let (found_len, found_ns) = (memory.horizon_len, memory.step_ns);
        let expected = format!("expected {horizon_len} of {step_ns} ns");
        Err(target.content(format!("its forecasts have {found_len} steps of {found_ns} ns, {expected}")))
    }

    fn to_bytes(&self, weights_sha256: &str) -> Result<Vec<u8>, SafeTensorError> {
        // What no bucket has any more is told to nobody.
        let kept: BTreeSet<usize> = self.buckets.keys().flat_map(|key| self.bucket(key)).collect();
        let moments = || kept.iter().map(|place| &self.entries[*place].moment);
        let memories = || kept.iter().map(|place| &self.memories[*place]);
        let len = kept.len();
        let bytes =
            |numbers: &mut dyn Iterator<Item = f32>| numbers.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
        let gait: Vec<u8> = moments().map(|moment| moment.gait() as u8).collect();
        let moment = bytes(&mut moments().flat_map(Moment::components));
        let driven: Vec<u8> = memories().map(|memory| memory.driven_len as u8).collect();
        let departure = bytes(&mut memories().flat_map(|memory| memory.departures.numbers(self.horizon_len)));
        let skill = bytes(&mut self.skill.iter().flat_map(|skill| skill.numbers(self.horizon_len)));
        let steps_len = self.horizon_len;
        let step = self.step_ns.to_le_bytes();
        serialize(
            [
                (GAIT, TensorView::new(Dtype::U8, vec![len], &gait)?),
                (MOMENT, TensorView::new(Dtype::F32, vec![len, COMPONENTS], &moment)?),
                (DRIVEN, TensorView::new(Dtype::U8, vec![len], &driven)?),
                (DEPARTURE, TensorView::new(Dtype::F32, vec![len, steps_len, 2], &departure)?),
                (SKILL, TensorView::new(Dtype::F32, vec![2, steps_len, 2, 2], &skill)?),
                (STEP_NS, TensorView::new(Dtype::I64, vec![1], &step)?),
            ],
            Some([(WEIGHTS.to_owned(), weights_sha256.to_owned())].into()),
        )
    }

    fn from_bytes(bytes: &[u8], weights_sha256: &str, target: Target<'_>) -> Result<Self, FileError> {
        let (format, content) = (|source| target.format(source), |reason| target.content(reason));
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(format)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(format)?;
        check_weights(metadata.metadata().as_ref(), weights_sha256, target)?;
        let tensor = |name| tensors.tensor(name).map_err(format);
        let step_ns = step_ns(&tensor(STEP_NS)?).map_err(content)?;
        let departure = tensor(DEPARTURE)?;
        let [len, steps_len, 2] = departure.shape()[..] else {
            return Err(content(format!(
                "{DEPARTURE} has shape {:?}, expected [moments, steps, 2]",
                departure.shape()
            )));
        };
        if len > MOMENTS_MAX || !(1..=HORIZON_MAX).contains(&steps_len) {
            let most = format!("at most {MOMENTS_MAX} of 1 to {HORIZON_MAX} allowed");
            return Err(content(format!("{len} moments of {steps_len} steps, {most}")));
        }
        let gait = small(GAIT, &tensor(GAIT)?, len, 1).map_err(content)?;
        let driven = small(DRIVEN, &tensor(DRIVEN)?, len, steps_len as u8).map_err(content)?;
        let moment = finite_numbers(MOMENT, &tensor(MOMENT)?, &[len, COMPONENTS]).map_err(content)?;
        let departure = numbers(DEPARTURE, &departure, &[len, steps_len, 2]).map_err(content)?;
        let skill = finite_numbers(SKILL, &tensor(SKILL)?, &[2, steps_len, 2, 2]).map_err(content)?;

        // They lie as Σ told · driven, Σ told².
        if let Some(negative) = skill.iter().skip(1).step_by(2).find(|square| **square < 0.0) {
            return Err(content(format!("{SKILL} holds {negative}, a sum of squares can't be negative")));
        }

        let mut memory = Self::new(steps_len, step_ns);
        for (skill, numbers) in memory.skill.iter_mut().zip(skill.chunks_exact(4 * steps_len)) {
            *skill = Skill::of_numbers(numbers);
        }
        let moments = moment.as_chunks::<COMPONENTS>().0.iter().zip(departure.chunks_exact(2 * steps_len));
        for (number, (components, departure)) in moments.enumerate() {
            let gait = if gait[number] == 0 { Gait::Driving } else { Gait::Walking };
            if let Some(beyond) = components[..2].iter().find(|x| x.abs() > POSITION_MAX_M) {
                return Err(content(format!("{MOMENT}[{number}] is at {beyond} m, outside the world")));
            }
            let most = DEPARTURE_MAX[gait as usize];
            let impossible =
                |(place, x): (usize, &f32)| (x.is_infinite() || x.abs() > most[place % 2]).then_some(*x);
            if let Some(departure) = departure.iter().enumerate().find_map(impossible) {
                return Err(content(format!("{DEPARTURE}[{number}] holds {departure}")));
            }
            let moment = Moment::of_components(gait, components);
            let departures = Departures::of_numbers(departure);
            let driven_len = usize::from(driven[number]);
            memory.keep(moment, Memory { agent: 0, stay: 0, driven_len, departures });
        }
        memory.leave();
        Ok(memory)
    }
}

/// Refuses metadata that tell of other weights, or of none.
fn check_weights(
    metadata: Option<&HashMap<String, String>>,
    weights_sha256: &str,
    target: Target<'_>,
) -> Result<(), FileError> {
    let Some(weights) = metadata.and_then(|metadata| metadata.get(WEIGHTS)) else {
        return Err(target.content(format!("its metadata lack `{WEIGHTS}`")));
    };
    if weights == weights_sha256 {
        return Ok(());
    }
    let [found, expected] =
        [weights, weights_sha256].map(|sha256| sha256.chars().take(12).collect::<String>());
    Err(FileError::OtherWeights { path: target.path.into(), found, expected })
}

/// The one number of a tensor, a length of time that steps may have.
fn step_ns(view: &TensorView<'_>) -> Result<u64, String> {
    let (Dtype::I64, Ok(bytes)) = (view.dtype(), view.data().try_into()) else {
        return Err(format!("{STEP_NS} is {:?} {:?}, expected I64 [1]", view.dtype(), view.shape()));
    };
    let step_ns = i64::from_le_bytes(bytes);
    if step_ns < 1 {
        return Err(format!("{STEP_NS} is {step_ns}, expected 1 or more"));
    }
    Ok(step_ns.cast_unsigned())
}

/// Bytes of which none is larger.
fn small(name: &str, view: &TensorView<'_>, len: usize, most: u8) -> Result<Vec<u8>, String> {
    if view.dtype() != Dtype::U8 || view.shape() != [len] {
        return Err(format!("{name} is {:?} {:?}, expected U8 [{len}]", view.dtype(), view.shape()));
    }
    match view.data().iter().position(|x| *x > most) {
        Some(at) => Err(format!("{name}[{at}] is {}, at most {most} allowed", view.data()[at])),
        None => Ok(view.data().to_vec()),
    }
}

const fn target(path: &Path) -> Target<'_> {
    Target { path, what: "memory of a place" }
}
