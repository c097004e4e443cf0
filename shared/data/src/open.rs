//! From a path to a recording: finds and reads the files of the recording.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileTypeExt as _;
use std::path::{Path, PathBuf};

use recording::unpacked_file;
use sha2::{Digest, Sha256};
use wire::WorldOrigin;

use crate::damage::cut_finding;
use crate::folder::bag_parts;
use crate::formats::{
    commonroad, csv, highd, interaction, kitti, levelx, obsmat, positions, rosbag, sdd_raw, vci_dut,
};
use crate::input::{FILE_BYTES_MAX, stem};
use crate::{Format, FrameRate, Input, ReadError, Recording, Role, inspection, text};

/// Information about a recording besides its files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenOptions {
    /// The format; `None` detects it from the content.
    pub format: Option<Format>,
    /// Rate of the frame numbers in frames per second, for formats whose files do not contain it
    /// ([`Format::frame_rate`]). `None` is the usual rate.
    pub fps: Option<FrameRate>,
    /// The world frame's origin in the recording's own frame.
    pub origin: WorldOrigin,
    /// The topics of a bag whose objects are read; empty means the usual ones.
    pub topics: Vec<String>,
}

impl OpenOptions {
    /// A known format, at its usual rate.
    #[must_use]
    pub fn of(format: Format) -> Self {
        Self { format: Some(format), ..Self::default() }
    }
}

/// Reads the recording that the file at `path` belongs to, with its other files; a folder of rosbag2 is one
/// recording. `None` detects the format
/// from the content.
///
/// # Errors
/// [`ReadError`] with file, line, column and value.
pub fn open(path: &Path, format: Option<Format>) -> Result<Recording, ReadError> {
    open_with(path, OpenOptions { format, ..OpenOptions::default() })
}

/// As [`open`], with all options.
///
/// # Errors
/// [`ReadError`] with file, line, column and value; [`ReadError::File`] if a frame rate is given and the
/// files contain their times, or an origin for a format without a world frame.
pub fn open_with(path: &Path, options: OpenOptions) -> Result<Recording, ReadError> {
    let parts = bag_parts(path)?;
    let opened = read(parts.first().map_or(path, |first| first), Role::Rows)?;
    refuse_table(path, &opened)?;
    let format = match options.format {
        Some(format) => format,
        None => Format::detect(&opened)?,
    };
    let mut inputs = with_companions(path, opened, format)?;
    let mut len = inputs[0].bytes.len();
    for part in parts.iter().skip(1) {
        let input = read(part, Role::Rows)?;
        len += input.bytes.len();
        if len as u64 > FILE_BYTES_MAX {
            return Err(ReadError::too_large(path.to_string_lossy(), len as u64, FILE_BYTES_MAX));
        }
        inputs.push(input);
    }
    if !options.topics.is_empty() && format != Format::Rosbag {
        return Err(ReadError::file(
            path.to_string_lossy(),
            format!("{format} has no topics, and takes no --topic"),
        ));
    }
    inputs.iter_mut().for_each(|input| input.origin = options.origin);
    inputs[0].topics = options.topics;
    let recording = parse_as_far_as_whole(format, &mut inputs, options.fps)?;
    // A folder such as `.` has no name in the path.
    let folder = path.canonicalize().ok().filter(|path| path.is_dir());
    Ok(Recording { name: name(&folder.as_deref().unwrap_or(path).to_string_lossy()), ..recording })
}

/// Refuses a file of a data frame, and names the lines of Python that make a CSV of it.
fn refuse_table(path: &Path, opened: &Input) -> Result<(), ReadError> {
    let Some((_, kind, read)) = TABLES.iter().find(|(magic, ..)| opened.bytes.starts_with(magic)) else {
        return Ok(());
    };
    let saved = path.with_extension("csv");
    let problem = format!(
        "a {kind} file. Two lines of Python make a recording of it, if its columns have the names of the CSV \
         format:\n    import pandas, stgdat\n    stgdat.Recording.from_pandas(pandas.{read}({path:?})).save({saved:?})"
    );
    Err(ReadError::file(&opened.path, problem))
}

/// First bytes of the files of data frames, their names, and the readers of pandas.
const TABLES: [(&[u8], &str, &str); 2] =
    [(b"PAR1", "Parquet", "read_parquet"), (b"ARROW1", "Feather", "read_feather")];

/// The name of a recording in a single file of another reader, and the SHA-256 of the file, as
/// [`Recording::name`] and [`Recording::sha256`].
///
/// # Errors
/// [`ReadError`] if the file can't be read.
pub fn identity(path: &Path) -> Result<(String, String), ReadError> {
    let input = read(path, Role::Rows)?;
    Ok((name(&path.to_string_lossy()), sha256([&input])))
}

fn sha256<'a>(inputs: impl IntoIterator<Item = &'a Input>) -> String {
    let mut hasher = Sha256::new();
    inputs.into_iter().for_each(|input| hasher.update(&input.bytes));
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Reads a recording from the content of its files.
///
/// [`Recording::sha256`] is the hash of the files' contents one after the other, in the given order.
///
/// # Errors
/// [`ReadError`] with file, line, column and value.
pub fn parse(format: Format, inputs: &[Input]) -> Result<Recording, ReadError> {
    parse_at(format, inputs, None)
}

/// As [`parse`], with a rate of the frame numbers in frames per second.
///
/// # Errors
/// [`ReadError`] with file, line, column and value; [`ReadError::File`] if a frame rate is given and the
/// files contain their times.
pub fn parse_at(format: Format, inputs: &[Input], fps: Option<FrameRate>) -> Result<Recording, ReadError> {
    if fps.is_some() && format.frame_rate().is_none() {
        let names = Format::ALL.into_iter().filter(|format| format.frame_rate().is_some());
        let names: Vec<_> = names.map(Format::name).collect();
        let path = inputs.first().map_or("", |input| &input.path);
        let names = names.join(", ");
        let problem =
            format!("{format} has a time for every frame, and takes no frame rate: that is for {names}");
        return Err(ReadError::file(path, problem));
    }
    if let Some(input) = inputs.iter().find(|input| !input.origin.is_zero() && !format.has_world_frame()) {
        let problem = format!("{format} has its origin at the scene, and takes no --origin");
        return Err(ReadError::file(&input.path, problem));
    }
    let at = |usual: FrameRate| fps.unwrap_or(usual);
    let mut recording = match format {
        Format::EthUcy => positions::parse_eth_ucy(inputs, at(positions::ETH_UCY_RATE)),
        Format::Obsmat => obsmat::parse(inputs, at(obsmat::RATE)),
        Format::SddTrajnet => positions::parse_trajnet(inputs, at(positions::TRAJNET_RATE)),
        Format::SddRaw => sdd_raw::parse(inputs, at(sdd_raw::RATE)),
        Format::Interaction => interaction::parse(inputs),
        Format::VciDut => vci_dut::parse(inputs, at(vci_dut::RATE)),
        Format::KittiDetections => kitti::parse_detections(inputs),
        Format::KittiLabels => kitti::parse_labels(inputs),
        Format::LevelX => levelx::parse(inputs),
        Format::HighD => highd::parse(inputs),
        Format::CommonRoad => commonroad::parse(inputs),
        Format::Rosbag => rosbag::parse(inputs),
        Format::Csv => csv::parse(inputs),
    }?;
    inspection::drop_unknown(&mut recording);
    Ok(Recording {
        name: inputs.first().map_or_else(String::new, |input| name(&input.path)),
        sha256: sha256(inputs),
        ..recording
    })
}

/// As [`parse_at`]. If only the last line of a file is wrong and nothing ends it, the file was cut off there. The line
/// is left out then, with a doubt.
fn parse_as_far_as_whole(
    format: Format,
    inputs: &mut [Input],
    fps: Option<FrameRate>,
) -> Result<Recording, ReadError> {
    let error = match parse_at(format, inputs, fps) {
        Err(error @ (ReadError::Columns { .. } | ReadError::Value { .. } | ReadError::Line { .. })) => error,
        outcome => return outcome,
    };
    let place = error.place();
    let (Some(cut), Some(line)) = (inputs.iter().position(|input| input.path == place.path), place.line)
    else {
        return Err(error);
    };
    let Some(at) = cut_at(&inputs[cut].bytes, line) else { return Err(error) };
    let sha256 = sha256(&*inputs);
    let last = inputs[cut].bytes.split_off(at);
    let Ok(mut recording) = parse_at(format, inputs, fps) else { return Err(error) };
    inputs[cut].bytes.extend(last);
    recording.findings.push(cut_finding(&inputs[cut], at, &recording));
    Ok(Recording { sha256, ..recording })
}

/// The byte at which the last line begins, if it is this line (from 1) and nothing ends it.
fn cut_at(bytes: &[u8], line: usize) -> Option<usize> {
    let at = bytes.iter().rposition(|&byte| byte == b'\n')? + 1;
    let is_last = bytes[..at].iter().filter(|&&byte| byte == b'\n').count() + 1 == line;
    (is_last && at < bytes.len()).then_some(at)
}

/// The last folder and the file's name without its ending: `GL/vehicle_tracks_000`.
fn name(path: &str) -> String {
    let folder = Path::new(path).parent().and_then(Path::file_name).map(|folder| folder.to_string_lossy());
    match folder {
        Some(folder) => format!("{folder}/{}", stem(path)),
        None => stem(path),
    }
}

/// The file of standard input.
pub const STANDARD_INPUT: &str = "/dev/stdin";

/// Whether a path is `-`, which means standard input.
#[must_use]
pub fn is_standard_input(path: &Path) -> bool {
    path.as_os_str() == "-"
}

pub(crate) fn read(path: &Path, role: Role) -> Result<Input, ReadError> {
    let failed = |source| ReadError::Io { path: path.to_owned(), source };
    let file = File::open(if is_standard_input(path) { Path::new(STANDARD_INPUT) } else { path });
    let file = file.map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() && !metadata.file_type().is_fifo() {
        return Err(failed(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file")));
    }
    let mut bytes = Vec::new();
    // A file in use may grow.
    if metadata.len() <= FILE_BYTES_MAX {
        file.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(failed)?;
    }
    let path = path.to_string_lossy().into_owned();
    let len = metadata.len().max(bytes.len() as u64);
    if len > FILE_BYTES_MAX {
        return Err(ReadError::too_large(path, len, FILE_BYTES_MAX));
    }
    if let Cow::Owned(unpacked) =
        unpacked_file(&bytes, FILE_BYTES_MAX).map_err(|why| ReadError::file(&path, why))?
    {
        bytes = unpacked;
    }
    Ok(Input::new(role, path, bytes))
}

/// The file at `path` if it exists.
pub(crate) fn read_if_there(path: &Path, role: Role) -> Result<Option<Input>, ReadError> {
    if path.exists() { read(path, role).map(Some) } else { Ok(None) }
}

/// The file at `path`; an error about the file at `opened` if it is missing.
pub(crate) fn read_needed(path: &Path, role: Role, opened: &str) -> Result<Input, ReadError> {
    read_if_there(path, role)?
        .ok_or_else(|| ReadError::missing(opened, role.name(), &format!(" at {}", path.display())))
}

/// The opened file with its role, and the files that belong to it.
fn with_companions(path: &Path, mut opened: Input, format: Format) -> Result<Vec<Input>, ReadError> {
    let up = |depth: usize| path.ancestors().nth(depth).unwrap_or(Path::new(""));
    match format {
        Format::EthUcy | Format::Obsmat | Format::CommonRoad | Format::Rosbag | Format::Csv => {
            Ok(vec![opened])
        }
        Format::LevelX | Format::HighD => levelx_files(path, opened),
        Format::SddTrajnet => {
            let table = read_if_there(&up(2).join("H_SDD.txt"), Role::Scales)?;
            Ok(std::iter::once(opened).chain(table).collect())
        }
        Format::SddRaw => {
            let scales = read_needed(&up(3).join("estimated_scales.yaml"), Role::Scales, &opened.path)?;
            Ok(vec![opened, scales])
        }
        Format::Interaction => {
            opened.role = role(&opened, interaction::role_of)?;
            let other = (opened.role == Role::Vehicles).then(|| pedestrian_tracks(path)).flatten();
            let other = other.map(|other| read(&other, Role::Pedestrians)).transpose()?;
            Ok(std::iter::once(opened).chain(other).collect())
        }
        Format::VciDut => {
            opened.role = role(&opened, vci_dut::role_of)?;
            let (from, to, other_role) = match opened.role {
                Role::Vehicles => (VCI_DUT[0], VCI_DUT[1], Role::Pedestrians),
                _ => (VCI_DUT[1], VCI_DUT[0], Role::Vehicles),
            };
            let other = renamed(path, from, to);
            let other = other.map(|other| read_if_there(&other, other_role)).transpose()?.flatten();
            Ok(in_order(std::iter::once(opened).chain(other).collect()))
        }
        Format::KittiDetections => Ok(in_order(kitti::files::detections(path, opened)?)),
        Format::KittiLabels => {
            let [calibration, ego_motion] = kitti::files::sensors(path)?;
            Ok(vec![opened, calibration, ego_motion])
        }
    }
}

/// The rows of a levelX recording, with the attributes of its tracks and of the recording: `07_tracks.csv`,
/// `07_tracksMeta.csv`, `07_recordingMeta.csv`.
fn levelx_files(path: &Path, opened: Input) -> Result<Vec<Input>, ReadError> {
    let name =
        path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_suffix("_tracks.csv"));
    let searched = ": the file's name does not end in _tracks.csv";
    let name = name.ok_or_else(|| ReadError::missing(&opened.path, Role::TracksMeta.name(), searched))?;
    let attributes_of = |what: &str, role| {
        read_needed(&path.with_file_name(format!("{name}_{what}.csv")), role, &opened.path)
    };
    let attributes = [
        attributes_of("tracksMeta", Role::TracksMeta)?,
        attributes_of("recordingMeta", Role::RecordingMeta)?,
    ];
    Ok(std::iter::once(opened).chain(attributes).collect())
}

/// The role of one file of a pair. A file that has neither role is read as vehicles, so that the error names
/// its first line.
fn role(input: &Input, role_of: fn(&text::Line<'_>) -> Option<Role>) -> Result<Role, ReadError> {
    let first = text::lines(input).next().transpose()?;
    Ok(first.as_ref().and_then(role_of).unwrap_or(Role::Vehicles))
}

/// Parts of the names of VCI-DUT's vehicle and pedestrian files.
const VCI_DUT: [&str; 2] = ["_veh_", "_ped_"];

/// The file of the pedestrians beside VCI-DUT's vehicles.
pub(crate) fn vci_dut_pair(vehicles: &Path) -> Option<PathBuf> {
    renamed(vehicles, VCI_DUT[0], VCI_DUT[1])
}

/// The file beside `path` with one part of its name replaced; `None` if the name does not contain the part.
fn renamed(path: &Path, from: &str, to: &str) -> Option<PathBuf> {
    let file = path.file_name()?.to_string_lossy();
    file.contains(from).then(|| path.with_file_name(file.replace(from, to)))
}

/// `pedestrian_tracks_000*.csv` beside `vehicle_tracks_000.csv`, the first by name.
pub(crate) fn pedestrian_tracks(vehicles: &Path) -> Option<PathBuf> {
    let file = vehicles.file_name()?.to_str()?;
    let number = file.strip_prefix("vehicle_tracks_")?.strip_suffix(".csv")?;
    let wanted = format!("pedestrian_tracks_{number}");
    let folder = vehicles.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).ok()?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let belongs = |name: &String| {
        let rest = name.strip_prefix(&wanted).and_then(|rest| rest.strip_suffix(".csv"));
        rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('_'))
    };
    names.filter(belongs).min().map(|name| folder.join(name))
}

/// Sorts the files by role, so that the result does not depend on which of them was opened.
fn in_order(mut inputs: Vec<Input>) -> Vec<Input> {
    inputs.sort_by_key(|input| input.role);
    inputs
}
