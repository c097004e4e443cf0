//! A scratch file for values that a run reads repeatedly and that do not fit into memory.
//!
//! A spool is written once, front to back. Then any thread can read it at any offset. Its file has no name,
//! so it is removed when the process ends, for whatever reason. Frequently read parts stay in the system's
//! page cache. A data set that fits into memory is read from there; a larger one costs time, not memory.

use std::fs::File;
use std::io::{BufWriter, Error, ErrorKind, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use bytemuck::{AnyBitPattern, NoUninit};

use crate::TrainError;

/// Size of the write buffer.
const BUFFER_BYTES: usize = 1 << 20;

/// A spool that is being written.
#[derive(Debug)]
pub(crate) struct Spooling {
    file: BufWriter<File>,
    folder: PathBuf,
    len: u64,
}

/// A complete spool.
#[derive(Debug)]
pub(crate) struct Spool {
    file: File,
    folder: PathBuf,
}

impl Spooling {
    /// An empty spool on the disk of `folder`, which is created if it is missing.
    pub(crate) fn create(folder: &Path) -> Result<Self, TrainError> {
        let file = std::fs::create_dir_all(folder).and_then(|()| tempfile::tempfile_in(folder));
        let file = file.map_err(|source| failed(folder, source))?;
        Ok(Self::over(file, folder))
    }

    fn over(file: File, folder: &Path) -> Self {
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        Self { file, folder: folder.to_owned(), len: 0 }
    }

    /// Bytes so far: the offset of the next values.
    pub(crate) const fn len(&self) -> u64 {
        self.len
    }

    /// Appends values. Returns their offset.
    pub(crate) fn append<T: NoUninit>(&mut self, values: &[T]) -> Result<u64, TrainError> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        self.file.write_all(bytes).map_err(|source| failed(&self.folder, source))?;
        let offset = self.len;
        self.len += bytes.len() as u64;
        Ok(offset)
    }

    /// Ends the writing.
    pub(crate) fn finish(self) -> Result<Spool, TrainError> {
        let Self { file, folder, .. } = self;
        match file.into_inner() {
            Ok(file) => Ok(Spool { file, folder }),
            Err(error) => Err(failed(&folder, error.into_error())),
        }
    }
}

impl Spool {
    /// Reads the `len` values that were written at `offset`.
    pub(crate) fn read<T: NoUninit + AnyBitPattern>(
        &self,
        offset: u64,
        len: usize,
    ) -> Result<Vec<T>, TrainError> {
        let mut values = vec![T::zeroed(); len];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
        self.file.read_exact_at(bytes, offset).map_err(|source| failed(&self.folder, source))?;
        Ok(values)
    }

    /// The error for content that differs from the written content.
    pub(crate) fn damaged(&self, reason: impl std::error::Error + Send + Sync + 'static) -> TrainError {
        failed(&self.folder, Error::new(ErrorKind::InvalidData, reason))
    }

    /// Truncates the file.
    #[cfg(test)]
    pub(crate) fn truncate(&self, len: u64) {
        self.file.set_len(len).unwrap();
    }
}

fn failed(folder: &Path, source: Error) -> TrainError {
    TrainError::Scratch { folder: folder.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn values_read_back_in_any_order_and_leave_no_file(
            records in proptest::collection::vec(proptest::collection::vec(any::<u32>(), 0..300), 1..40),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let mut spooling = Spooling::create(&folder.path().join("made/here")).unwrap();
            let offsets: Vec<u64> = records.iter().map(|record| spooling.append(record).unwrap()).collect();
            let spool = spooling.finish().unwrap();
            for (record, offset) in records.iter().zip(&offsets).rev() {
                prop_assert_eq!(record, &spool.read::<u32>(*offset, record.len()).unwrap());
            }
            prop_assert_eq!(std::fs::read_dir(folder.path().join("made/here")).unwrap().count(), 0);
        }
    }

    #[test]
    fn full_disks_and_short_files_are_errors_naming_the_folder() {
        let folder = Path::new("scratch/folder");
        let full = File::options().write(true).open("/dev/full").unwrap();
        let mut spooling = Spooling::over(full, folder);
        spooling.append(&[1_u8]).unwrap();
        let refused = spooling.finish().unwrap_err().to_string();
        assert!(refused.contains("scratch/folder") && refused.contains("No space left"), "{refused}");

        let folder = tempfile::tempdir().unwrap();
        let mut spooling = Spooling::create(folder.path()).unwrap();
        let offset = spooling.append(&[1.5_f32; 100]).unwrap();
        let spool = spooling.finish().unwrap();
        spool.truncate(399);
        assert_eq!(spool.read::<f32>(offset, 99).unwrap(), [1.5; 99]);
        let refused = spool.read::<f32>(offset, 100).unwrap_err().to_string();
        assert!(refused.contains(&*folder.path().to_string_lossy()), "{refused}");
    }

    #[test]
    fn a_folder_that_cannot_be_created_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(matches!(Spooling::create(&file.path().join("below")), Err(TrainError::Scratch { .. })));
    }
}
