//! Commands that take the place of a stage and die.

use ports::{POINTS_VARIABLE, Point};
use wire::StageId;

use crate::program::stgdat_path;

/// Returns a command whose first process is the stage and whose later processes end immediately.
pub fn crashing(stage: StageId, exit_code: u8) -> Vec<String> {
    let words =
        format!("test $STGDAT_INCARNATION = 0 || exit {exit_code}; exec \"$0\" stage {}", stage.name());
    vec!["sh".to_owned(), "-c".to_owned(), words, stgdat_path().display().to_string()]
}

/// Returns the built-in stage as a command that kills itself at a point of its first step, in any
/// incarnation.
pub fn dying(stage: StageId, point: Point) -> Vec<String> {
    let (stage, point) = (stage.name(), point.name());
    let words = format!(
        "for i in $(seq 0 $STGDAT_INCARNATION); do p=${{p}}{stage}:{point}@0,; done; export {POINTS_VARIABLE}=$p; \
         exec \"$0\" stage {stage}"
    );
    vec!["sh".to_owned(), "-c".to_owned(), words, stgdat_path().display().to_string()]
}
