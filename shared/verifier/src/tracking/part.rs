use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::VerifyError;

/// Endings of the names of files that contain numbers.
const NUMBERS: [&str; 2] = [".csv", ".json"];

/// A part of a folder, with a note of which files were requested.
pub(super) struct Part {
    name: &'static str,
    path: PathBuf,
    files: BTreeMap<String, bool>,
}

impl Part {
    /// Opens a part, if it exists.
    pub(super) fn open(folder: &Path, name: &'static str) -> Result<Option<Self>, VerifyError> {
        let path = folder.join(name);
        if !path.is_dir() {
            return Ok(None);
        }
        let unreadable = |source| VerifyError::unreadable(&path, source);
        let mut files = BTreeMap::new();
        for entry in std::fs::read_dir(&path).map_err(unreadable)? {
            let file = entry.map_err(unreadable)?.file_name().to_string_lossy().into_owned();
            if NUMBERS.iter().any(|end| file.ends_with(end)) {
                files.insert(file, false);
            }
        }
        Ok(Some(Self { name, path, files }))
    }

    /// The files with numbers, in the order of their names.
    pub(super) fn file_names(&self) -> impl Iterator<Item = &str> {
        self.files.keys().map(String::as_str)
    }

    /// The path of a file, if it exists.
    pub(super) fn find(&mut self, file: &str) -> Option<PathBuf> {
        *self.files.get_mut(file)? = true;
        Some(self.path.join(file))
    }

    /// The path of a file that another file requires.
    pub(super) fn expect(&mut self, file: &str) -> Result<PathBuf, VerifyError> {
        self.find(file).ok_or_else(|| VerifyError::malformed(&self.path.join(file), "there is no such file"))
    }

    /// The name of a vector in a file: the part, the file without its extension, and `what`.
    pub(super) fn vector(&self, file: &str, what: &str) -> String {
        let stem = NUMBERS.iter().find_map(|end| file.strip_suffix(end)).unwrap_or(file);
        format!("{}/{stem}.{what}", self.name)
    }

    /// The path of the part.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The error of the part as a whole.
    pub(super) fn malformed(&self, reason: &str) -> VerifyError {
        VerifyError::malformed(&self.path, reason)
    }

    /// Refuses a part that is empty or has files that were not requested.
    pub(super) fn finish(&self) -> Result<(), VerifyError> {
        if self.files.is_empty() {
            return Err(self.malformed("there are no numbers"));
        }
        match self.files.iter().find(|(_, asked_for)| !**asked_for) {
            Some((file, _)) => {
                Err(VerifyError::malformed(&self.path.join(file), "nothing computes its numbers"))
            }
            None => Ok(()),
        }
    }
}

/// Parses a JSON file.
pub(super) fn document<T: DeserializeOwned>(path: &Path) -> Result<T, VerifyError> {
    let bytes = std::fs::read(path).map_err(|source| VerifyError::unreadable(path, source))?;
    serde_json::from_slice(&bytes).map_err(|error| VerifyError::caused(path, "", error))
}
