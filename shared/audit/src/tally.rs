/// Where a detection stands: a line of a file, or a tick of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Number of the file; 0 in a run.
    pub file: u32,
    /// Line, from 1, or the number of the tick.
    pub line: u64,
}

/// Rows that a finding concerns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub rows: u64,
    /// The first of them by time.
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
