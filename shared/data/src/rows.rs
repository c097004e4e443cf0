//! The rows of files, in any order, and their content. [`crate::sweeps`] turns them into frames.

use wire::{AgentType, Detection, Truth, detection_flags};

use crate::lines::{Lines, RowLine};
use crate::row::Row;
use crate::text::{Field, Line, Separator};
use crate::{Input, ReadError, order};

/// Maximum number of rows of a recording.
pub(crate) const ROWS_MAX: usize = 8_000_000;
/// The first identity of a pedestrian, in formats that count the identities of vehicles and pedestrians
/// separately.
pub(crate) const PEDESTRIAN_IDS: u64 = 1_000_000_000;
/// Speed from which a direction of motion is a heading.
pub(crate) const HEADING_SPEED_MPS: f32 = 0.1;
/// Bits of all agent types.
pub(crate) const ALL_TYPES: u32 =
    AgentType::Vehicle.bit() | AgentType::Cyclist.bit() | AgentType::Pedestrian.bit();

/// The rows read so far.
#[derive(Debug, Default)]
pub(crate) struct Rows<'a> {
    rows: Vec<Row<'a>>,
}

impl<'a> Rows<'a> {
    /// Adds the rows of lines with these columns. `row` makes the stamp and the content from the values.
    pub fn read<const N: usize>(
        &mut self,
        lines: impl Iterator<Item = Result<Line<'a>, ReadError>>,
        separator: Separator,
        names: &[&'static str; N],
        row: impl Fn([Field<'a>; N]) -> Result<(i64, Detection), ReadError>,
    ) -> Result<(), ReadError> {
        for line in lines {
            let line = line?;
            let (stamp_ns, detection) = row(line.split(separator, names)?)?;
            self.push(&line, stamp_ns, detection)?;
        }
        Ok(())
    }

    /// Adds a row.
    pub fn push(&mut self, line: &Line<'a>, stamp_ns: i64, detection: Detection) -> Result<(), ReadError> {
        self.push_written(line, stamp_ns, detection, detection.heading_rad)
    }

    /// Adds a row, with the heading as it was written.
    pub fn push_written(
        &mut self,
        line: &Line<'a>,
        stamp_ns: i64,
        detection: Detection,
        heading_written: f32,
    ) -> Result<(), ReadError> {
        limit(self.rows.len() + 1, line)?;
        let (path, line) = (line.path, line.number);
        self.rows.push(Row { stamp_ns, detection, heading_written, path, line });
        Ok(())
    }

    /// The times of the rows in file order.
    pub fn stamps(&self) -> impl Iterator<Item = i64> {
        self.rows.iter().map(|row| row.stamp_ns)
    }

    /// Whether no row was read.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The rows by time and identity, in whatever order the files had.
    ///
    /// # Errors
    /// * [`ReadError::Duplicate`] if an identity has two rows at one time;
    /// * [`ReadError::TimeGoesBack`] if an identity's time goes back in a file that is otherwise in order;
    /// * [`ReadError::Empty`] if there are no rows.
    pub fn sorted(self, input: &Input) -> Result<Vec<Row<'a>>, ReadError> {
        match self.is_empty() {
            true => Err(ReadError::Empty { path: input.path.clone() }),
            false => self.sorted_or_none(),
        }
    }

    /// As [`Rows::sorted`], but having no rows is not an error. All rows of all formats pass here before they
    /// become frames, still in the files' order.
    pub fn sorted_or_none(mut self) -> Result<Vec<Row<'a>>, ReadError> {
        order::check(&self.rows)?;
        let has_id = |row: &Row<'_>| row.detection.has(detection_flags::HAS_ID);
        self.rows.sort_by_key(|row| (row.stamp_ns, has_id(row), row.detection.id, row.line));
        let twice = self.rows.windows(2).find(|pair| {
            let same =
                |a: &Row<'_>, b: &Row<'_>| (a.stamp_ns, a.detection.id) == (b.stamp_ns, b.detection.id);
            has_id(&pair[0]) && has_id(&pair[1]) && same(&pair[0], &pair[1])
        });
        match twice {
            None => Ok(self.rows),
            Some(pair) => Err(ReadError::Duplicate {
                path: pair[1].path.to_owned(),
                line: pair[1].line,
                id: pair[1].detection.id,
                first_path: pair[0].path.to_owned(),
                first_line: pair[0].line,
            }),
        }
    }
}

/// Refuses the line of a row beyond the limit.
pub(crate) fn limit(row_count: usize, line: &Line<'_>) -> Result<(), ReadError> {
    if row_count <= ROWS_MAX {
        return Ok(());
    }
    let problem = format!("more than {ROWS_MAX} rows");
    Err(ReadError::Line { path: line.path.to_owned(), line: line.number, problem })
}

/// A detection at a position, with no other attribute.
pub(crate) fn detection(agent_type: AgentType, position_m: [f32; 2]) -> Detection {
    Detection {
        x_m: position_m[0],
        y_m: position_m[1],
        score: 1.0,
        agent_type: agent_type as u32,
        ..Detection::default()
    }
}

/// A detection with an identity.
pub(crate) fn identified(agent_type: AgentType, position_m: [f32; 2], id: u64) -> Detection {
    Detection { id, flags: detection_flags::HAS_ID, ..detection(agent_type, position_m) }
}

/// The detection with a velocity in the world frame: its speed, and from [`HEADING_SPEED_MPS`] on its
/// heading.
pub(crate) fn with_velocity(
    detection: Detection,
    vx: Field<'_>,
    vy: Field<'_>,
) -> Result<Detection, ReadError> {
    let [vx_mps, vy_mps] = [vx.speed_mps()?, vy.speed_mps()?];
    let speed_mps = vx.speed_of(vx_mps.hypot(vy_mps))?;
    let moves = speed_mps >= HEADING_SPEED_MPS;
    Ok(Detection {
        speed_mps,
        heading_rad: if moves { vy_mps.atan2(vx_mps) } else { 0.0 },
        flags: detection.flags
            | detection_flags::HAS_SPEED
            | if moves { detection_flags::HAS_HEADING } else { 0 },
        ..detection
    })
}

/// Sorts by type and identity, and without identity by score and position, so that the order of rows never
/// matters. The lines, one per detection, are sorted with them.
pub(crate) fn sort(detections: &mut Vec<Detection>, lines: &mut Lines) {
    let mut rows: Vec<(Detection, RowLine)> = detections.drain(..).zip(lines.take()).collect();
    rows.sort_by(|(a, _), (b, _)| {
        let numbers = |d: &Detection| [-d.score, d.x_m, d.y_m, d.heading_rad, d.length_m];
        (a.agent_type, a.id).cmp(&(b.agent_type, b.id)).then_with(|| {
            let by_number = numbers(a).into_iter().zip(numbers(b)).map(|(a, b)| a.total_cmp(&b));
            by_number.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
        })
    });
    for (detection, line) in rows {
        detections.push(detection);
        lines.push(line);
    }
}

/// The truth of a row, for files whose rows are the truth.
pub(crate) fn truth_of(detection: &Detection) -> Truth {
    Truth {
        id: detection.id,
        agent_type: detection.agent_type,
        x_m: detection.x_m,
        y_m: detection.y_m,
        offset_ns: detection.offset_ns,
        ..Truth::default()
    }
}
