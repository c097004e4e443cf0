use wire::WorldOrigin;

use crate::ReadError;

/// Size of the largest file that is read.
pub const FILE_BYTES_MAX: u64 = 1 << 30;

wire::named! {
    /// The content of a file of a recording.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Role {
        /// The rows of a format that has one file.
        Rows => "rows",
        /// The vehicles of a pair of files.
        Vehicles => "vehicles",
        /// The pedestrians (and cyclists) of a pair of files.
        Pedestrians => "pedestrians",
        /// The output of the detector for cyclists.
        Cyclists => "cyclists",
        /// True positions in addition to a detector's output.
        Labels => "labels",
        /// Position and attitude of the ego vehicle.
        EgoMotion => "ego motion",
        /// Mounting poses of the sensors on the ego vehicle.
        Calibration => "calibration",
        /// Metres per pixel.
        Scales => "scales",
        /// Classes and other attributes of the tracks.
        TracksMeta => "attributes of the tracks",
        /// Frame rate and other attributes of the recording.
        RecordingMeta => "attributes of the recording",
    }
}

/// The content of a file of a recording, in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Input {
    /// The kind of content.
    pub role: Role,
    /// The path, for the recording's name and for errors.
    pub path: String,
    /// The content.
    pub bytes: Vec<u8>,
    /// The world frame's origin in the file's own frame.
    pub origin: WorldOrigin,
    /// The topics of a bag whose objects are read; the usual ones if it is empty.
    pub topics: Vec<String>,
}

impl Input {
    /// Creates a file whose own frame is the world frame.
    pub fn new(role: Role, path: impl Into<String>, bytes: impl Into<Vec<u8>>) -> Self {
        Self {
            role,
            path: path.into(),
            bytes: bytes.into(),
            origin: WorldOrigin::default(),
            topics: Vec::new(),
        }
    }
}

/// The file with this role.
pub(crate) fn find(inputs: &[Input], role: Role) -> Option<&Input> {
    inputs.iter().find(|input| input.role == role)
}

/// The file with this role; an error if it is missing.
pub(crate) fn need(inputs: &[Input], role: Role) -> Result<&Input, ReadError> {
    need_any(inputs, &[role])
}

/// The first file with one of these roles; an error if all are missing.
pub(crate) fn need_any<'a>(inputs: &'a [Input], roles: &[Role]) -> Result<&'a Input, ReadError> {
    let found = inputs.iter().find(|input| roles.contains(&input.role));
    found.ok_or_else(|| {
        let path = inputs.first().map_or("recording", |input| &input.path);
        ReadError::missing(path, roles.first().map_or("rows", |role| role.name()), "")
    })
}

/// A file's name without its ending.
pub(crate) fn stem(path: &str) -> String {
    std::path::Path::new(path)
        .file_stem()
        .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}
