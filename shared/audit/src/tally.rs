/// The location of a detection: a line of a file, or a tick of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Number of the file; 0 in a run.
    pub file: u32,
    /// Line number (from 1), or the number of the tick.
    pub line: u64,
}

/// The rows of a finding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub rows: u64,
    /// The first row by time.
    pub first: Option<Place>,
}

impl Tally {
    pub fn add(&mut self, rows: u64, place: Place) {
        self.rows += rows;
        if rows > 0 {
            self.first.get_or_insert(place);
        }
    }
}
