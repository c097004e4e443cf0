//! The recordings in a folder.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use crate::open::{pedestrian_tracks, vci_dut_pair};
use crate::{Format, Input, ReadError, Role};

/// Number of a file's first bytes that are read to detect its format.
const HEAD_BYTES: u64 = 1 << 16;

/// The recordings directly in a folder, by name. A file that belongs to another recording is not listed.
///
/// # Errors
/// [`ReadError::Io`] if the folder can't be read.
pub fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let failed = |source| ReadError::Io { path: folder.to_owned(), source };
    let entries = fs::read_dir(folder).map_err(failed)?.map(|entry| entry.map(|entry| entry.path()));
    let mut files = entries.collect::<io::Result<Vec<_>>>().map_err(failed)?;
    files.sort();
    files.retain(|path| path.is_file() && is_recording(path));
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
