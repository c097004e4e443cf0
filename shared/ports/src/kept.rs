//! Memory that outlives its process: a mapped file of the run in shared memory.
//!
//! The content stays when the process is killed, and its successor finds it. The end of the run removes the
//! file, and so does `stgdat clean`. Every page is allocated before it is mapped. Full shared memory is
//! therefore an error here and not a signal in the middle of a tick.
#![expect(unsafe_code, reason = "maps a file, and lends what is mapped as bytes")]

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;

use run::Run;
use rustix::fs::{FallocateFlags, FlockOperation, Mode, OFlags, fallocate, flock, fstat, open};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

use crate::places::SHARED_MEMORY;

/// A file of the run in shared memory, for one process at a time.
#[derive(Debug)]
pub struct KeptMemory {
    path: PathBuf,
    /// Locked while this process lives.
    file: File,
    /// `None` if the file is empty.
    mapped: Option<(NonNull<u8>, usize)>,
}

// SAFETY: the mapping belongs to this value alone, and is not tied to a thread.
unsafe impl Send for KeptMemory {}

impl KeptMemory {
    /// The path of the run's file with this name.
    #[must_use]
    pub fn path_of(run: &Run, name: &str) -> PathBuf {
        // The upper half of the run's number is secret: nobody can take the name in advance.
        Path::new(SHARED_MEMORY).join(format!("{}{:08x}_{name}", run.prefix, run.id >> 32))
    }

    /// Opens the run's file with this name. The file has the content that an earlier process left, or is
    /// empty.
    ///
    /// # Errors
    /// If the file can't be made or mapped, or another process has it open.
    pub fn open(run: &Run, name: &str) -> io::Result<Self> {
        let path = Self::path_of(run, name);
        let flags = OFlags::RDWR | OFlags::CREATE | OFlags::CLOEXEC | OFlags::NOFOLLOW;
        let file = open(&path, flags, Mode::RUSR | Mode::WUSR)?;
        flock(&file, FlockOperation::NonBlockingLockExclusive)?;
        let len = usize::try_from(fstat(&file)?.st_size).unwrap_or(0);
        let mut kept = Self { path, file: file.into(), mapped: None };
        kept.map(len)?;
        Ok(kept)
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The content of the file.
    pub fn bytes(&mut self) -> &mut [u8] {
        let Some((start, len)) = self.mapped else { return &mut [] };
        // SAFETY: the mapping has that length and lives until `self` is dropped or mapped again. The lock
        // keeps other processes from writing, and every byte is a valid u8.
        unsafe { std::slice::from_raw_parts_mut(start.as_ptr(), len) }
    }

    /// Extends the file with zeros to `len` bytes. A longer file is unchanged.
    ///
    /// # Errors
    /// If shared memory is full; the file is then unchanged.
    pub fn grow_to(&mut self, len: usize) -> io::Result<()> {
        let before = self.mapped.map_or(0, |(_, len)| len);
        if len <= before {
            return Ok(());
        }
        fallocate(&self.file, FallocateFlags::empty(), before as u64, (len - before) as u64)?;
        self.map(len)
    }

    fn map(&mut self, len: usize) -> io::Result<()> {
        if len == 0 {
            return Ok(());
        }
        let (access, how) = (ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED | MapFlags::POPULATE);
        // SAFETY: the kernel chooses a free address.
        let start = unsafe { mmap(std::ptr::null_mut(), len, access, how, &self.file, 0)? };
        self.unmap();
        self.mapped = NonNull::new(start.cast()).map(|start| (start, len));
        Ok(())
    }

    fn unmap(&mut self) {
        if let Some((start, len)) = self.mapped.take() {
            // SAFETY: it is a mapping of that length, and a slice that `bytes` returned has ended when `self`
            // changes.
            let _ = unsafe { munmap(start.as_ptr().cast(), len) };
        }
    }
}

impl Drop for KeptMemory {
    fn drop(&mut self) {
        self.unmap();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Space;

    #[test]
    fn what_was_written_is_there_for_the_next_and_for_one_at_a_time() {
        let space = Space::create(None, 0).unwrap();
        let run = Run { prefix: space.prefix().into(), ..Run::default() };
        let mut first = KeptMemory::open(&run, "kept").unwrap();
        assert!(first.bytes().is_empty());
        first.grow_to(5_000).unwrap();
        first.bytes()[4_999] = 7;
        first.grow_to(100_000).unwrap();
        assert_eq!((first.bytes().len(), first.bytes()[4_999], first.bytes()[99_999]), (100_000, 7, 0));
        let taken = KeptMemory::open(&run, "kept").unwrap_err();
        assert_eq!(taken.kind(), io::ErrorKind::WouldBlock);
        let path = first.path().to_owned();
        drop(first);
        let mut second = KeptMemory::open(&run, "kept").unwrap();
        assert_eq!((second.bytes().len(), second.bytes()[4_999]), (100_000, 7));
        drop(space);
        assert!(!path.exists(), "it goes with the run");
    }
}
