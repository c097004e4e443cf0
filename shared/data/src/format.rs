use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::formats::{commonroad, csv, highd, interaction, levelx, obsmat, positions, sdd_raw, vci_dut};
use crate::text::{self, Line, Separator};
use crate::{FrameRate, Input, ReadError};

wire::named! {
    /// The file format of a recording.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Format {
        /// [`crate::formats::positions`], ETH/UCY.
        EthUcy => "eth-ucy",
        /// [`crate::formats::obsmat`].
        Obsmat => "obsmat",
        /// [`crate::formats::positions`], Stanford Drone.
        SddTrajnet => "sdd-trajnet",
        /// [`crate::formats::sdd_raw`].
        SddRaw => "sdd-raw",
        /// [`crate::formats::interaction`].
        Interaction => "interaction",
        /// [`crate::formats::vci_dut`].
        VciDut => "vci-dut",
        /// [`crate::formats::kitti`], a detector's output.
        KittiDetections => "kitti-detections",
        /// [`crate::formats::kitti`], true tracks.
        KittiLabels => "kitti-labels",
        /// [`crate::formats::levelx`]: inD, rounD, exiD, uniD.
        LevelX => "levelx",
        /// [`crate::formats::highd`].
        HighD => "highd",
        /// [`crate::formats::commonroad`].
        CommonRoad => "commonroad",
        /// [`crate::formats::rosbag`], rosbag2 as MCAP.
        Rosbag => "rosbag",
        /// [`crate::formats::csv`], the project's own.
        Csv => "csv",
    }
}

/// A name that is not a format's.
#[derive(Debug, Error, PartialEq, Eq)]
#[error("unknown format \"{0}\": expected one of {known}", known = Format::names())]
pub struct UnknownFormat(pub String);

/// Maximum number of lines that the detection of the format reads.
const LINES_MAX: usize = 2_000;

/// The first bytes of a bag in sqlite3.
const SQLITE: &[u8] = b"SQLite format 3\0";
/// How such a bag can be read.
const SQLITE_REMEDY: &str = "a bag in sqlite3: convert its folder to MCAP, with `ros2 bag convert`, or without ROS by \
                             `python3 tests/interop/bag_to_mcap.py FOLDER OUT.mcap` of stgdat's sources";

impl Format {
    /// The default rate of frame numbers; `None` if the files contain their times or the rate is fixed.
    pub const fn frame_rate(self) -> Option<FrameRate> {
        match self {
            Self::EthUcy => Some(positions::ETH_UCY_RATE),
            Self::Obsmat => Some(obsmat::RATE),
            Self::SddTrajnet => Some(positions::TRAJNET_RATE),
            Self::SddRaw => Some(sdd_raw::RATE),
            Self::VciDut => Some(vci_dut::RATE),
            Self::Interaction
            | Self::KittiDetections
            | Self::KittiLabels
            | Self::LevelX
            | Self::HighD
            | Self::CommonRoad
            | Self::Rosbag
            | Self::Csv => None,
        }
    }

    /// Whether positions are in the files' own world frame. Positions of the other formats are pixels, or
    /// relative to the scene.
    pub(crate) const fn has_world_frame(self) -> bool {
        match self {
            Self::EthUcy
            | Self::Obsmat
            | Self::Interaction
            | Self::VciDut
            | Self::LevelX
            | Self::CommonRoad
            | Self::Rosbag
            | Self::Csv => true,
            Self::SddTrajnet | Self::SddRaw | Self::KittiDetections | Self::KittiLabels | Self::HighD => {
                false
            }
        }
    }

    /// All names, with commas between them.
    #[must_use]
    pub fn names() -> String {
        Self::ALL.map(Self::name).join(", ")
    }

    /// The format of a file, detected from its content alone; the file's name has no influence.
    ///
    /// # Errors
    /// [`ReadError::File`] if the content fits none, [`ReadError::Line`] if it is not text,
    /// [`ReadError::Empty`].
    pub fn detect(input: &Input) -> Result<Self, ReadError> {
        if recording::is_bag(&input.bytes) {
            return Ok(Self::Rosbag);
        }
        if input.bytes.starts_with(SQLITE) {
            return Err(ReadError::file(&input.path, SQLITE_REMEDY));
        }
        if recording::is_end_of_bag(&input.bytes) {
            return Err(ReadError::file(&input.path, HEADLESS));
        }
        let mut lines =
            text::lines(input).filter(|line| !matches!(line, Ok(line) if line.text.starts_with('#')));
        let first = lines.next().ok_or_else(|| ReadError::Empty { path: input.path.clone() })??;
        if interaction::role_of(&first).is_some() {
            return Ok(Self::Interaction);
        }
        if vci_dut::role_of(&first).is_some() {
            return Ok(Self::VciDut);
        }
        if csv::is_header(&first) {
            return Ok(Self::Csv);
        }
        if levelx::is_header(&first) {
            return Ok(Self::LevelX);
        }
        if highd::is_header(&first) {
            return Ok(Self::HighD);
        }
        if csv::is_meant_as_header(&first) {
            return Ok(Self::Csv);
        }
        if first.text.trim_start().starts_with('<') {
            return match commonroad::is_root_among(std::iter::once(Ok(first)).chain(lines)) {
                true => Ok(Self::CommonRoad),
                false => Err(unknown(&first, "XML without an element commonRoad")),
            };
        }
        let commas = first.pieces(Separator::Comma).count();
        let spaces = first.pieces(Separator::Space).count();
        match (commas, spaces) {
            (15, _) => Ok(Self::KittiDetections),
            (1, 17 | 18) => Ok(Self::KittiLabels),
            (1, 10) => Ok(Self::SddRaw),
            (1, 8) => Ok(Self::Obsmat),
            (1, 4) => by_frames(&first, lines),
            _ => Err(unknown(&first, &no_header(commas.max(spaces)))),
        }
    }
}

/// The problem of a file that ends as a bag and begins as something else.
const HEADLESS: &str =
    "a bag (MCAP) whose beginning is missing or damaged: it ends as a bag, and does not begin as one";

/// The error of a first row that does not belong to any format.
fn no_header(columns: usize) -> String {
    let columns = if columns == 1 { "1 column".to_owned() } else { format!("{columns} columns") };
    format!(
        "the first row has {columns} and is no header, such as stamp_s,id,type,x_m,y_m with commas, semicolons or \
         tabs"
    )
}

/// Distinguishes the formats of four columns by the spacing of their frames: multiples of ten or twelve.
fn by_frames<'a>(
    first: &Line<'a>,
    rest: impl Iterator<Item = Result<Line<'a>, ReadError>>,
) -> Result<Format, ReadError> {
    let (mut tens, mut dozens, mut all_zero) = (true, true, true);
    for line in std::iter::once(Ok(*first)).chain(rest).take(LINES_MAX) {
        let line = line?;
        let Some((column, text)) = line.pieces(Separator::Space).next() else { continue };
        let frame = line.field("frame", column, text).frame()?;
        tens &= frame % 10 == 0;
        dozens &= frame % 12 == 0;
        all_zero &= frame == 0;
    }
    match (tens, dozens) {
        (true, false) => Ok(Format::EthUcy),
        (false, true) => Ok(Format::SddTrajnet),
        // Both readers give the same recording except for the axes. An all-zero file fits both formats.
        (true, true) if all_zero => {
            Ok(if first.text.contains('\t') { Format::EthUcy } else { Format::SddTrajnet })
        }
        (true, true) => Err(unknown(first, "all frames are multiples of 60")),
        (false, false) => Err(unknown(first, "frames are neither tens nor dozens")),
    }
}

fn unknown(line: &Line<'_>, problem: &str) -> ReadError {
    ReadError::file(line.path, format!("{problem}; name the format (one of {})", Format::names()))
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Format {
    type Err = UnknownFormat;

    fn from_str(name: &str) -> Result<Self, UnknownFormat> {
        let format = Self::ALL.into_iter().find(|format| format.name() == name);
        format.ok_or_else(|| UnknownFormat(name.to_owned()))
    }
}
