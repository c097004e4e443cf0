use wire::Detection;

/// A detection and the line that it was read from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row<'a> {
    pub stamp_ns: i64,
    pub detection: Detection,
    /// The heading as it was written, not wrapped.
    pub heading_written: f32,
    pub path: &'a str,
    pub line: usize,
}
