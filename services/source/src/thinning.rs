//! Chooses the frames of a recording that are played, and merges or counts the others.
//!
//! An unplayed frame can come from another sensor, whose agents would then never go out. A frame is therefore
//! split into parts, each with the detections of one time. A part is merged into the next played frame if
//! that frame contains less than half of the part's agents. Each detection keeps its own time. All other
//! parts come from a sensor that the played frame also contains, so they are discarded. Detections that go
//! out in neither way are counted.

use std::collections::BTreeSet;

use data::{Frame, Lines, Recording};
use wire::{AgentType, Detection, detection_flags};

/// Uncertainty of a position.
const POSITION_M: f32 = 0.25;

/// The frames that are played.
#[derive(Clone, Debug, Default)]
pub(crate) struct Played {
    /// Their places in the recording.
    pub places: Vec<usize>,
    /// Two cumulative counts for each played frame: detections of unplayed frames that no played frame
    /// contains, and detections that were merged into another frame.
    pub counts: Vec<[u32; 2]>,
}

/// Chooses every `n`th frame by time. Merges detections of other sensors since the previous played frame into
/// each.
pub(crate) fn thin(recording: &mut Recording, n: u64) -> Played {
    let interval_ns = recording.interval_ns.max(1);
    let places = every_nth(&recording.frames, n, interval_ns);
    let mut counts = Vec::with_capacity(places.len());
    let (mut merged_count, mut start) = (0, 0);
    for &place in &places {
        let (unplayed, rest) = recording.frames.split_at_mut(place);
        if recording.own_stamps
            && let Some(frame) = rest.first_mut()
        {
            merged_count += merge(&unplayed[start..], frame, interval_ns);
        }
        counts.push([0, merged_count]);
        start = place + 1;
    }
    count_lost(&recording.frames, &places, &mut counts);
    Played { places, counts }
}

/// The places of every `n`th frame by time. A missing frame does not shift the others.
fn every_nth(frames: &[Frame], n: u64, interval_ns: u64) -> Vec<usize> {
    // A frame that is half an interval early still counts as due.
    let apart_ns = n * interval_ns - interval_ns / 2;
    let mut played: Vec<usize> = Vec::new();
    for (place, frame) in frames.iter().enumerate() {
        let last = played.last().map(|&last| &frames[last]);
        if n == 1 || last.is_none_or(|last| frame.stamp_ns.abs_diff(last.stamp_ns) >= apart_ns) {
            played.push(place);
        }
    }
    played
}

/// Merges the parts of unplayed frames that come from another sensor, newest first. Returns the number of
/// merged detections. `interval_ns` is the interval between the frames.
pub fn merge(unplayed: &[Frame], into: &mut Frame, interval_ns: u64) -> u32 {
    let part_ns = i64::try_from(interval_ns / 10).unwrap_or(i64::MAX);
    let mut merged_count = 0;
    for frame in unplayed.iter().rev() {
        let mut detections: Vec<Detection> = frame.detections.clone();
        detections.sort_by_key(|detection| std::cmp::Reverse(detection.offset_ns));
        for part in detections.chunk_by(|a, b| a.offset_ns - b.offset_ns <= part_ns) {
            let missing: Vec<Detection> =
                part.iter().filter(|d| !contains(into, frame.stamp_ns, d)).copied().collect();
            if 2 * missing.len() <= part.len() {
                continue;
            }
            let shift_ns = frame.stamp_ns - into.stamp_ns;
            for detection in missing {
                let truth = frame.truth.iter().filter(|truth| truth.id == detection.id);
                let truth = truth.filter(|truth| truth.offset_ns == detection.offset_ns);
                into.truth.extend(
                    truth.map(|truth| wire::Truth { offset_ns: truth.offset_ns + shift_ns, ..*truth }),
                );
                into.observed_types |= detection.agent_type().map_or(0, AgentType::bit);
                into.detections.push(Detection { offset_ns: detection.offset_ns + shift_ns, ..detection });
                merged_count += 1;
            }
        }
    }
    if merged_count > 0 {
        // The lines no longer match the detections one to one.
        into.lines = Lines::default();
        into.detections.sort_by_key(|detection| (detection.agent_type, detection.id));
        into.truth.sort_by_key(|truth| (truth.agent_type, truth.id));
    }
    merged_count
}

/// Whether `frame` contains the agent of a detection from a frame at `stamp_ns`. Agents match by identity.
/// Without identities, they match if the types are equal and the agent can have covered the distance.
fn contains(frame: &Frame, stamp_ns: i64, detection: &Detection) -> bool {
    let is_same = |other: &Detection| {
        if detection.has(detection_flags::HAS_ID) || other.has(detection_flags::HAS_ID) {
            return detection.has(detection_flags::HAS_ID)
                && other.has(detection_flags::HAS_ID)
                && detection.id == other.id;
        }
        let speed_max_mps = match detection.agent_type() {
            Ok(AgentType::Vehicle) => 40.0,
            Ok(AgentType::Cyclist) => 12.0,
            _ => 4.0,
        };
        let elapsed_ns = (frame.stamp_ns + other.offset_ns).abs_diff(stamp_ns + detection.offset_ns);
        let way_m = (other.x_m - detection.x_m).hypot(other.y_m - detection.y_m);
        other.agent_type == detection.agent_type
            && way_m <= speed_max_mps * elapsed_ns as f32 * 1e-9 + POSITION_M
    };
    frame.detections.iter().any(is_same)
}

/// Counts the detections of unplayed frames whose agent is in no played frame. Without identities, only the
/// previous and the next played frame are searched.
fn count_lost(frames: &[Frame], places: &[usize], counts: &mut [[u32; 2]]) {
    let identified = |detection: &&Detection| detection.has(detection_flags::HAS_ID);
    let went_out: BTreeSet<u64> = places
        .iter()
        .flat_map(|&place| frames[place].detections.iter().filter(identified).map(|detection| detection.id))
        .collect();
    let mut lost_count = 0;
    for (number, count) in counts.iter_mut().enumerate() {
        let before = number.checked_sub(1).map(|before| places[before]);
        // Frames after the last played one count with it.
        let is_last = number + 1 == places.len();
        let end = if is_last { frames.len() } else { places[number] };
        for frame in &frames[before.map_or(0, |before| before + 1)..end] {
            let near = [before, Some(places[number])].into_iter().flatten();
            if frame.stamp_ns == frames[places[number]].stamp_ns {
                continue;
            }
            let near: Vec<&Frame> = near.map(|place| &frames[place]).collect();
            let is_lost = |detection: &&Detection| match detection.has(detection_flags::HAS_ID) {
                true => !went_out.contains(&detection.id),
                false => !near.iter().any(|near| contains(near, frame.stamp_ns, detection)),
            };
            lost_count += frame.detections.iter().filter(is_lost).count() as u32;
        }
        count[0] = lost_count;
    }
}

#[cfg(test)]
mod tests {
    use wire::Truth;

    use super::*;

    const MS: i64 = 1_000_000;

    fn detection(id: u64, stamp_ms: i64, frame_ms: i64) -> Detection {
        Detection {
            id,
            x_m: stamp_ms as f32 * 1e-3,
            y_m: 6.0 * id as f32,
            agent_type: AgentType::Pedestrian as u32,
            flags: detection_flags::HAS_ID,
            offset_ns: (stamp_ms - frame_ms) * MS,
            ..Detection::default()
        }
    }

    fn truth(d: &Detection) -> Truth {
        Truth { id: d.id, agent_type: d.agent_type, x_m: d.x_m, offset_ns: d.offset_ns, ..Truth::default() }
    }

    /// A recording with a frame for each (stamp, \[(agent, own stamp)\]), in ms.
    fn recording(interval_ms: u64, frames: &[(i64, &[(u64, i64)])]) -> Recording {
        let frame = |&(frame_ms, seen): &(i64, &[(u64, i64)])| {
            let detections: Vec<Detection> =
                seen.iter().map(|&(id, stamp_ms)| detection(id, stamp_ms, frame_ms)).collect();
            Frame {
                stamp_ns: frame_ms * MS,
                observed_types: AgentType::Pedestrian.bit(),
                truth: detections.iter().map(truth).collect(),
                detections,
                ..Frame::default()
            }
        };
        let frames = frames.iter().map(frame).collect();
        let interval_ns = interval_ms * 1_000_000;
        Recording { interval_ns, has_identities: true, own_stamps: true, frames, ..Recording::default() }
    }

    fn without_ids(recording: Recording) -> Recording {
        let mut recording = Recording { has_identities: false, ..recording };
        for detection in recording.frames.iter_mut().flat_map(|frame| &mut frame.detections) {
            (detection.id, detection.flags) = (0, 0);
        }
        recording
    }

    /// (agent, own stamp in ms) of each played frame. Agents are identified by their positions.
    fn played(recording: &Recording, places: &[usize]) -> Vec<Vec<(u64, i64)>> {
        let of_frame = |&place: &usize| {
            let frame = &recording.frames[place];
            let own_ms = |d: &Detection| (frame.stamp_ns + d.offset_ns) / MS;
            let mut agents: Vec<(u64, i64)> =
                frame.detections.iter().map(|d| ((d.y_m / 6.0).round() as u64, own_ms(d))).collect();
            agents.sort_unstable();
            agents
        };
        places.iter().map(of_frame).collect()
    }

    /// A 20 Hz sensor with agents 1 and 2, and a 10 Hz sensor with agent 3. Agent 3 is in every other frame,
    /// and none of these frames is played.
    fn two_sensors() -> Recording {
        recording(
            50,
            &[
                (0, &[(1, 0), (2, 0)]),
                (50, &[(1, 50), (2, 50), (3, 30)]),
                (100, &[(1, 100), (2, 100)]),
                (150, &[(1, 150), (2, 150), (3, 130)]),
                (200, &[(1, 200), (2, 200)]),
            ],
        )
    }

    #[test]
    fn another_sensor_is_merged_and_the_same_one_thinned() {
        let expected: [&[(u64, i64)]; 3] =
            [&[(1, 0), (2, 0)], &[(1, 100), (2, 100), (3, 30)], &[(1, 200), (2, 200), (3, 130)]];
        for mut recording in [two_sensors(), without_ids(two_sensors())] {
            let Played { places, counts } = thin(&mut recording, 2);
            assert_eq!(places, [0, 2, 4]);
            assert_eq!(played(&recording, &places), expected);
            assert_eq!(counts, [[0, 0], [0, 1], [0, 2]]);
        }
        let mut recording = two_sensors();
        thin(&mut recording, 2);
        let third = recording.frames[2].truth.iter().find(|truth| truth.id == 3);
        assert_eq!(third.map(|truth| (truth.x_m, truth.offset_ns)), Some((30.0 * 1e-3, -70 * MS)));
    }

    #[test]
    fn agents_of_unplayed_frames_alone_are_lost() {
        for own_stamps in [false, true] {
            // Agent 9 is in the sensor's frame at 50 ms only.
            let mut recording = recording(
                50,
                &[
                    (0, &[(1, 0), (2, 0)]),
                    (50, &[(1, 50), (2, 50), (9, 50)]),
                    (100, &[(1, 100), (2, 100)]),
                    (150, &[(1, 150), (8, 150)]),
                ],
            );
            recording.own_stamps = own_stamps;
            let before = recording.frames[2].clone();
            let Played { places, counts } = thin(&mut recording, 2);
            assert_eq!((places, counts), (vec![0, 2], vec![[0, 0], [2, 0]]));
            assert_eq!(recording.frames[2], before);
        }
    }

    #[test]
    fn numbered_frames_are_thinned_as_they_are() {
        let mut numbered = Recording { own_stamps: false, ..two_sensors() };
        let frames = numbered.frames.clone();
        let Played { counts, .. } = thin(&mut numbered, 2);
        assert_eq!(numbered.frames, frames);
        assert_eq!(counts, [[0, 0], [1, 0], [2, 0]]);
    }

    #[test]
    fn the_newest_detection_of_an_agent_is_merged() {
        let mut recording = recording(
            25,
            &[(0, &[(1, 0)]), (25, &[(3, 25)]), (50, &[(3, 50)]), (75, &[(3, 75)]), (100, &[(1, 100)])],
        );
        let Played { places, counts } = thin(&mut recording, 4);
        assert_eq!(played(&recording, &places), [vec![(1, 0)], vec![(1, 100), (3, 75)]]);
        assert_eq!(counts, [[0, 0], [0, 1]]);
    }
}
