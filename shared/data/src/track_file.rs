//! Tracks as files: a tracker's output, one row per track and frame.
//!
//! | [`TrackFormat`] | a row |
//! |---|---|
//! | `csv` | [`crate::formats::csv`] with velocity, status, covariance; an `ego` or `above` row per frame |
//! | `kitti` | `frame id type truncated occluded alpha x1 y1 x2 y2 h w l x y z rot_y score`, camera frame |
//! | `mot` | `frame,id,-1,-1,-1,-1,confidence,x,y,z`, frames from 1, positions in the world frame, z 0 |
//!
//! Positions are in the recording's own frame: the run's origin is added again. The score is the existence
//! probability. Values that a track does not have are -1: the box in the image, truncation and occlusion. The
//! height in KITTI's rows is the mean height of the labelled objects of the type. The position is on the
//! plane on which the car stands.
//!
//! The CSV can be [opened](crate::open) again as a recording with identities. So can the KITTI file if it is
//! beside its `calib` and `oxts`.

use std::fmt;
use std::io::{self, Write};
use std::str::FromStr;

use thiserror::Error;
use wire::{AgentType, Header, Quality, Track, TrackStatus, WorldOrigin, flags};

use crate::formats::csv;
use crate::formats::kitti::{self, WorldFromCamera};
use crate::text;

wire::named! {
    /// A file format for tracks.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum TrackFormat {
        /// The project's own format.
        #[default]
        Csv => "csv",
        /// KITTI's format for results of tracking.
        Kitti => "kitti",
        /// The format of the MOT challenges, with positions in the world frame.
        Mot => "mot",
    }
}

/// A name that is not a track format's.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown format \"{0}\" of tracks: expected csv, kitti or mot")]
pub struct UnknownTrackFormat(String);

impl fmt::Display for TrackFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for TrackFormat {
    type Err = UnknownTrackFormat;

    fn from_str(name: &str) -> Result<Self, UnknownTrackFormat> {
        let format = Self::ALL.into_iter().find(|format| format.name() == name);
        format.ok_or_else(|| UnknownTrackFormat(name.to_owned()))
    }
}

/// A format with the poses that its rows need.
#[derive(Clone, Debug)]
pub enum TrackRows {
    /// [`TrackFormat::Csv`].
    Csv,
    /// [`TrackFormat::Kitti`], of the sequence with these poses.
    Kitti(Box<WorldFromCamera>),
    /// [`TrackFormat::Mot`].
    Mot,
}

/// Writes the tracks frame by frame.
#[derive(Debug)]
pub struct TrackWriter<W> {
    output: W,
    rows: TrackRows,
    origin: WorldOrigin,
}

impl<W: Write> TrackWriter<W> {
    /// Starts a file. `origin` is the world frame's origin in the recording's own frame.
    ///
    /// # Errors
    /// Those of the output.
    pub fn new(mut output: W, rows: TrackRows, origin: WorldOrigin) -> io::Result<Self> {
        if matches!(rows, TrackRows::Csv) {
            writeln!(output, "{}", CSV_COLUMNS.join(","))?;
        }
        Ok(Self { output, rows, origin })
    }

    /// Writes the tracks of a frame.
    ///
    /// # Errors
    /// Those of the output; [`io::ErrorKind::InvalidInput`] for an unknown agent type, and in KITTI's format
    /// for a frame without a pose.
    pub fn write(&mut self, header: &Header, tracks: &[Track]) -> io::Result<()> {
        let (output, origin) = (&mut self.output, self.origin);
        if matches!(self.rows, TrackRows::Csv) {
            write_ego(output, header, origin)?;
        }
        for track in tracks {
            let agent_type = AgentType::try_from(track.agent_type).map_err(invalid)?;
            let place = Place([track.x_m, track.y_m], origin);
            match &self.rows {
                TrackRows::Csv => write_csv(output, header, track, agent_type, &place)?,
                TrackRows::Kitti(poses) => write_kitti(output, header, track, agent_type, poses)?,
                TrackRows::Mot => {
                    let Track { id, existence, .. } = track;
                    writeln!(output, "{},{id},-1,-1,-1,-1,{existence},{place},0", header.seq + 1)?;
                }
            }
        }
        Ok(())
    }

    /// Flushes the output and returns it.
    ///
    /// # Errors
    /// Those of the output.
    pub fn finish(mut self) -> io::Result<W> {
        self.output.flush()?;
        Ok(self.output)
    }
}

fn invalid(error: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, error)
}

/// The columns of [`csv::NAMES`] that a track has.
const CSV_COLUMNS: [&str; csv::NAMES.len() - 2] = {
    let [stamp, id, kind, x, y, heading, speed, length, width, score, _sigma, _sensor, rest @ ..] =
        csv::NAMES;
    let [vx, vy, status, unseen, xx, xy, yy, prior, age] = rest;
    [
        stamp, id, kind, x, y, heading, speed, length, width, score, vx, vy, status, unseen, xx, xy, yy,
        prior, age,
    ]
};

fn write_ego(output: &mut impl Write, header: &Header, origin: WorldOrigin) -> io::Result<()> {
    let (place, heading) = (Place(header.ego_m, origin), header.ego_heading_rad);
    let kind = if header.has(flags::SEEN_FROM_EGO) { csv::EGO } else { csv::ABOVE };
    writeln!(output, "{},,{kind},{place},{heading},,,,,,,,,,,,,", Seconds(header.stamp_ns))
}

/// A position of the world frame, written as `x,y` in the recording's own frame. If the two frames differ, it
/// is written to 0.1 mm.
struct Place([f32; 2], WorldOrigin);

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self([x, y], origin) = *self;
        if origin.is_zero() {
            return write!(f, "{x},{y}");
        }
        let [x, y] = origin.own_m([x, y]).map(|x| (x * 1e4).round() / 1e4);
        write!(f, "{x},{y}")
    }
}

fn write_csv(
    output: &mut impl Write,
    header: &Header,
    track: &Track,
    agent_type: AgentType,
    place: &Place,
) -> io::Result<()> {
    let Track { id, heading_rad, speed_mps, existence, vx_mps, vy_mps, .. } = track;
    let (stamp, kind) = (Seconds(header.stamp_ns), agent_type.name());
    write!(output, "{stamp},{id},{kind},{place},{heading_rad},{speed_mps},")?;
    match (track.length_m, track.width_m) {
        (length_m, width_m) if length_m > 0.0 && width_m > 0.0 => write!(output, "{length_m},{width_m},")?,
        _ => write!(output, ",,")?,
    }
    let coasts = track.status == TrackStatus::Coasting as u32;
    let (status, unseen) = (csv::STATUS[usize::from(coasts)], Seconds(track.unseen_ns.cast_signed()));
    let [xx, xy] = [track.covariance[0], track.covariance[1]];
    // The covariance is packed: its second row starts after `state_len` numbers.
    let yy = track.covariance[(track.state_len as usize + 1).min(24)];
    let prior = Quality::ALL.get(track.prior as usize).map_or("", |quality| quality.name());
    let age = Seconds(track.prior_age_ns.cast_signed());
    writeln!(output, "{existence},{vx_mps},{vy_mps},{status},{unseen},{xx},{xy},{yy},{prior},{age}")
}

fn write_kitti(
    output: &mut impl Write,
    header: &Header,
    track: &Track,
    agent_type: AgentType,
    poses: &WorldFromCamera,
) -> io::Result<()> {
    let frame = usize::try_from(header.stamp_ns / kitti::INTERVAL_NS.cast_signed()).map_err(invalid)?;
    let position_m = [track.x_m, track.y_m].map(f64::from);
    let standing = poses.standing(frame, position_m, f64::from(track.heading_rad));
    let no_pose = || invalid(format!("frame {frame}: ego motion is known of {} frames", poses.frames_len()));
    let ([x, y, z], rotation) = standing.ok_or_else(no_pose)?;
    let kind = match agent_type {
        AgentType::Vehicle => "Car",
        AgentType::Cyclist => "Cyclist",
        AgentType::Pedestrian => "Pedestrian",
    };
    let Track { id, width_m, length_m, existence, .. } = track;
    let (height_m, alpha) = (kitti::height_m(agent_type), text::wrapped(rotation - x.atan2(z)));
    writeln!(
        output,
        "{frame} {id} {kind} -1 -1 {alpha:.6} -1 -1 -1 -1 {height_m} {width_m} {length_m} {x:.6} {y:.6} {z:.6} {rotation:.6} {existence}"
    )
}

/// Nanoseconds, written as seconds with all digits.
pub(crate) struct Seconds(pub(crate) i64);

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (sign, ns) = (if self.0 < 0 { "-" } else { "" }, self.0.unsigned_abs());
        let text = format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000);
        write!(f, "{sign}{}", text.trim_end_matches('0').trim_end_matches('.'))
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use wire::detection_flags;

    use super::*;
    use crate::{Format, Input, Role, parse};

    const CALIBRATION: &str = "P2: 721.5 0 609.5 44.8 0 721.5 172.8 0.2 0 0 1 0.003\nR_rect 1 0 0 0 1 0 0 0 1\n\
        Tr_velo_cam 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\nTr_imu_velo 1 0 0 -0.81 0 1 0 0.32 0 0 1 -0.8\n";
    /// Two poses, the car tilted.
    const EGO_MOTION: &str = "49.0 8.4 112.8 0.02 -0.03 0.5 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0.1 0.1 4 10 4 4 0\n\
        49.0001 8.4 112.9 0.02 -0.03 0.6 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0.1 0.1 4 10 4 4 0\n";

    fn track(id: u64, agent_type: AgentType, x_m: f32) -> Track {
        let mut track = Track { id, agent_type: agent_type as u32, x_m, y_m: -3.3, ..Track::zeroed() };
        (track.heading_rad, track.speed_mps, track.existence) = (0.7, 4.25, 0.9375);
        (track.length_m, track.width_m) = (4.1, 1.9);
        (track.vx_mps, track.vy_mps) = (3.25, 2.74);
        (track.state_len, track.unseen_ns) = (5, 200_000_000);
        (track.prior, track.prior_age_ns) = (Quality::Held as u32, 480_000_000);
        (track.covariance[0], track.covariance[1], track.covariance[6]) = (0.25, -0.125, 0.5);
        track
    }

    /// Frames with two tracks, none, and one.
    fn frames() -> Vec<(Header, Vec<Track>)> {
        let unsized_one = Track {
            length_m: 0.0,
            status: TrackStatus::Coasting as u32,
            ..track(9, AgentType::Pedestrian, 8.1)
        };
        let tracks = [
            vec![track(7, AgentType::Vehicle, 12.3), unsized_one],
            vec![],
            vec![track(7, AgentType::Vehicle, 12.7)],
        ];
        let header = |seq: u64| Header {
            ego_m: [1.5, seq as f32],
            ego_heading_rad: 0.5,
            flags: if seq == 0 { flags::SEEN_FROM_EGO } else { 0 },
            ..Header::new(0, seq, seq.cast_signed() * 100_000_000 - 100_000_000)
        };
        (0..).map(header).zip(tracks).collect()
    }

    fn written(rows: TrackRows, frames: &[(Header, Vec<Track>)]) -> io::Result<String> {
        let mut writer = TrackWriter::new(Vec::new(), rows, WorldOrigin::default())?;
        for (header, tracks) in frames {
            writer.write(header, tracks)?;
        }
        String::from_utf8(writer.finish()?).map_err(invalid)
    }

    fn input(role: Role, text: &str) -> Input {
        Input::new(role, format!("{}.txt", role.name()), text)
    }

    #[test]
    fn csv_reads_back_with_the_same_numbers() {
        let text = written(TrackRows::Csv, &frames()).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[1], "-0.1,,ego,1.5,0,0.5,,,,,,,,,,,,,");
        assert_eq!(
            rows[2],
            "-0.1,7,vehicle,12.3,-3.3,0.7,4.25,4.1,1.9,0.9375,3.25,2.74,confirmed,0.2,0.25,-0.125,0.5,held,0.48"
        );
        let input = Input::new(Role::Rows, "tracks.csv", text);
        assert_eq!(Format::detect(&input).unwrap(), Format::Csv);
        let recording = parse(Format::Csv, &[input]).unwrap();
        assert!(recording.has_identities);
        // A pose alone makes no frame.
        let with_tracks: Vec<_> = frames().into_iter().filter(|(_, tracks)| !tracks.is_empty()).collect();
        assert_eq!((recording.frames.len(), with_tracks.len()), (2, 2));
        for (frame, (header, tracks)) in recording.frames.iter().zip(with_tracks) {
            assert_eq!((frame.stamp_ns, frame.ego.position_m), (header.stamp_ns, header.ego_m));
            assert_eq!(frame.ego.is_sensor, header.has(flags::SEEN_FROM_EGO));
            assert_eq!(frame.detections.len(), tracks.len());
            for (read, track) in frame.detections.iter().zip(tracks) {
                assert_eq!(
                    (read.id, read.agent_type, read.score),
                    (track.id, track.agent_type, track.existence)
                );
                assert_eq!((read.x_m, read.y_m), (track.x_m, track.y_m));
                assert_eq!((read.heading_rad, read.speed_mps), (track.heading_rad, track.speed_mps));
                assert_eq!(read.has(detection_flags::HAS_SIZE), track.length_m > 0.0);
            }
        }
    }

    #[test]
    fn tracks_are_in_the_frame_of_the_recording() {
        let origin: WorldOrigin = "458000,5428000".parse().unwrap();
        let mut writer = TrackWriter::new(Vec::new(), TrackRows::Csv, origin).unwrap();
        for (header, tracks) in frames() {
            writer.write(&header, &tracks).unwrap();
        }
        let text = String::from_utf8(writer.finish().unwrap()).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[1], "-0.1,,ego,458001.5,5428000,0.5,,,,,,,,,,,,,");
        assert!(rows[2].starts_with("-0.1,7,vehicle,458012.3,5427996.7,0.7,4.25,"), "{}", rows[2]);
        let input = Input { origin, ..Input::new(Role::Rows, "tracks.csv", text) };
        let recording = parse(Format::Csv, &[input]).unwrap();
        let read = recording.frames[0].detections[0];
        assert_eq!((read.x_m, read.y_m), (12.3, -3.3));
        assert_eq!(recording.frames[0].ego.position_m, [1.5, 0.0]);
    }

    #[test]
    fn kitti_reads_back_with_the_same_world_positions() {
        let sensors = [input(Role::Calibration, CALIBRATION), input(Role::EgoMotion, EGO_MOTION)];
        let poses = WorldFromCamera::parse(&sensors[0], &sensors[1]).unwrap();
        let frames = &frames()[1..];
        let text = written(TrackRows::Kitti(Box::new(poses.clone())), frames).unwrap();
        assert_eq!(text.split_whitespace().count(), 18);
        let rows = input(Role::Rows, &text);
        assert_eq!(Format::detect(&rows).unwrap(), Format::KittiLabels);
        let recording = parse(Format::KittiLabels, &[vec![rows], sensors.to_vec()].concat()).unwrap();
        let [read] = recording.frames[1].detections[..] else { panic!("one track in the second frame") };
        let [track] = frames[1].1[..] else { panic!("one track was written") };
        assert!((read.x_m - track.x_m).hypot(read.y_m - track.y_m) < 1e-4, "{read:?}");
        assert!((read.heading_rad - track.heading_rad).abs() < 2e-3, "{read:?}");
        assert_eq!((read.id, read.length_m, read.width_m), (7, track.length_m, track.width_m));
        let beyond = (Header::new(0, 2, 200_000_000), vec![track]);
        let refused = written(TrackRows::Kitti(Box::new(poses)), &[beyond]).unwrap_err();
        assert_eq!(refused.to_string(), "frame 2: ego motion is known of 2 frames");
    }

    #[test]
    fn mot_rows_have_ten_columns_and_count_frames_from_one() {
        let text = written(TrackRows::Mot, &frames()).unwrap();
        assert_eq!(
            text,
            "1,7,-1,-1,-1,-1,0.9375,12.3,-3.3,0\n1,9,-1,-1,-1,-1,0.9375,8.1,-3.3,0\n3,7,-1,-1,-1,-1,0.9375,12.7,-3.3,0\n"
        );
    }

    #[test]
    fn seconds_are_exact() {
        let written = [0, 80_000_000, 12_000_000_001, -500_000_000].map(|ns| Seconds(ns).to_string());
        assert_eq!(written, ["0", "0.08", "12.000000001", "-0.5"]);
    }

    #[test]
    fn formats_parse_from_their_names() {
        assert!(TrackFormat::ALL.into_iter().all(|format| format.name().parse() == Ok(format)));
        assert_eq!(
            "xml".parse::<TrackFormat>().unwrap_err().to_string(),
            "unknown format \"xml\" of tracks: expected csv, kitti or mot"
        );
    }
}
