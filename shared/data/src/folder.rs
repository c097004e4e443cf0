//! The recordings in a folder, and the parts of a bag.

use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use recording::unpacked_file;

use crate::open::{pedestrian_tracks, vci_dut_pair};
use crate::{Format, Input, ReadError, Role};

/// Number of a file's first bytes that are read to detect its format.
const HEAD_BYTES: u64 = 1 << 16;
/// Largest content of these bytes, if they are compressed.
const HEAD_UNPACKED_BYTES: u64 = 1 << 24;

/// The list of a bag's parts, which rosbag2 writes when it ends.
const METADATA: &str = "metadata.yaml";

/// The parts of the bag in a folder of rosbag2, in order; empty if `folder` is not such a folder. Without
/// `metadata.yaml`, because the recorder was killed, the parts are the files that have the folder's name.
///
/// # Errors
/// [`ReadError`] if the list can't be read or has no parts.
pub(crate) fn bag_parts(folder: &Path) -> Result<Vec<PathBuf>, ReadError> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let metadata = folder.join(METADATA);
    if !metadata.is_file() {
        let stem = folder.canonicalize().ok();
        let stem = stem.as_deref().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned());
        let number = |path: &Path| -> Option<u32> {
            let name = path.file_name()?.to_str()?;
            let (number, ending) = name.strip_prefix(&stem.clone()?)?.strip_prefix('_')?.split_once('.')?;
            ["mcap", "mcap.zstd", "db3", "db3.zstd"].contains(&ending).then_some(())?;
            number.parse().ok()
        };
        let mut parts: Vec<(u32, PathBuf)> = files(folder)?
            .into_iter()
            .filter_map(|path| number(&path).map(|number| (number, path)))
            .collect();
        parts.sort();
        return Ok(parts.into_iter().map(|(_, path)| path).collect());
    }
    let failed = |problem: &str| ReadError::file(metadata.to_string_lossy(), problem);
    let text =
        fs::read_to_string(&metadata).map_err(|source| ReadError::Io { path: metadata.clone(), source })?;
    let mut lines = text.lines().map(str::trim);
    lines.find(|line| *line == "relative_file_paths:").ok_or_else(|| failed("has no relative_file_paths"))?;
    let names = lines.map_while(|line| line.strip_prefix("- "));
    // rosbag2 once wrote the folder's name, too.
    let names = names.filter_map(|name| Path::new(name.trim_matches(['"', '\'', ' '])).file_name());
    let parts: Vec<PathBuf> = names.map(|name| folder.join(name)).collect();
    match parts.iter().find(|part| !part.is_file()) {
        Some(missing) => Err(failed(&format!("its part {} is missing", missing.display()))),
        None if parts.is_empty() => Err(failed("lists no file")),
        None => Ok(parts),
    }
}

/// The entries of a folder, by name.
fn files(folder: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let failed = |source| ReadError::Io { path: folder.to_owned(), source };
    let entries = fs::read_dir(folder).map_err(failed)?.map(|entry| entry.map(|entry| entry.path()));
    let mut files = entries.collect::<io::Result<Vec<_>>>().map_err(failed)?;
    files.sort();
    Ok(files)
}

/// The recordings directly in a folder, by name: files, and folders of rosbag2. A folder of rosbag2 is itself its only
/// recording. A file that belongs to another recording is not listed.
///
/// # Errors
/// [`ReadError::Io`] if the folder can't be read.
pub fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, ReadError> {
    if !bag_parts(folder)?.is_empty() {
        return Ok(vec![folder.to_owned()]);
    }
    let mut files = files(folder)?;
    files.retain(|path| path.join(METADATA).is_file() || path.is_file() && is_recording(path));
    let pairs = |path: &PathBuf| [pedestrian_tracks(path), vci_dut_pair(path)];
    let companions: Vec<PathBuf> = files.iter().flat_map(pairs).flatten().collect();
    files.retain(|path| !companions.contains(path));
    Ok(files)
}

/// Whether the first lines of a file have one of the formats.
fn is_recording(path: &Path) -> bool {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut bytes));
    // The last line may be incomplete.
    if let Some(end) = bytes.iter().rposition(|&byte| byte == b'\n') {
        bytes.truncate(end);
    }
    if let Ok(Cow::Owned(unpacked)) = unpacked_file(&bytes, HEAD_UNPACKED_BYTES) {
        bytes = unpacked;
    }
    let input = Input::new(Role::Rows, path.to_string_lossy(), bytes);
    read.is_ok() && Format::detect(&input).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_holds_its_recordings_without_their_companions() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        write("b.csv", "stamp_s,type,x_m,y_m\n0,vehicle,0,0\n");
        write("notes.txt", "some words about it\n");
        write(
            "vehicle_tracks_000.csv",
            "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n",
        );
        write("pedestrian_tracks_000.csv", "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy\n");
        let found = recordings_in(folder.path()).unwrap();
        assert_eq!(found, ["b.csv", "vehicle_tracks_000.csv"].map(|name| folder.path().join(name)));
        assert!(recordings_in(&folder.path().join("missing")).is_err());
    }
}
