use std::sync::Arc;

use crate::row::Row;

/// The lines in the files from which a frame's detections come, in the order of the detections.
///
/// They are not part of a frame's content: all `Lines` are equal.
#[derive(Clone, Debug, Default)]
pub struct Lines(Vec<RowLine>);

/// The line of a row, and data that its detection does not contain.
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
    /// The line of a detection, by the detection's index in the frame; `None` if it does not come from a
    /// file.
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
