use std::sync::Arc;

use crate::rows::Row;

/// Where the rows of a frame's detections stand in the files, in the order of the detections.
///
/// They are no part of a frame's content: all lines are equal.
#[derive(Clone, Debug, Default)]
pub struct Lines(Vec<RowLine>);

/// Where a row stands, and what its detection does not hold.
#[derive(Clone, Debug)]
pub(crate) struct RowLine {
    pub path: Arc<str>,
    pub line: usize,
    /// The heading as it was written, not wrapped.
    pub heading_written: f32,
}

/// Paths that many lines share.
#[derive(Debug, Default)]
pub(crate) struct Paths(Vec<Arc<str>>);

impl PartialEq for Lines {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Lines {
    /// The line of a detection, by its place in the frame; `None` if it comes from no file.
    pub(crate) fn get(&self, place: usize) -> Option<&RowLine> {
        self.0.get(place)
    }

    pub(crate) fn push(&mut self, line: RowLine) {
        self.0.push(line);
    }

    pub(crate) fn take(&mut self) -> Vec<RowLine> {
        std::mem::take(&mut self.0)
    }
}

impl Paths {
    /// The line of a row.
    pub fn line(&mut self, row: &Row<'_>) -> RowLine {
        let path = self.path(row.path);
        RowLine { path, line: row.line, heading_written: row.heading_written }
    }

    pub fn path(&mut self, path: &str) -> Arc<str> {
        if let Some(known) = self.0.iter().find(|known| known[..] == *path) {
            return Arc::clone(known);
        }
        let path: Arc<str> = path.into();
        self.0.push(Arc::clone(&path));
        path
    }
}
