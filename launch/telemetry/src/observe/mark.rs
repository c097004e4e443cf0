//! The marks of a run's events in its trace.

use recorder::trace::Tracer;
use recording::{Event, Happened};
use wire::StageId;

/// Marks an event in a trace.
pub fn mark(tracer: &mut Tracer, Event { at_ns, what }: &Event) {
    let mut of_stage = |stage: &str, name: &str, why: &str| match StageId::from_name(stage) {
        Some(stage) => tracer.event(stage, *at_ns, name, why),
        None => tracer.note(*at_ns, name, why),
    };
    match what {
        Happened::Died { stage, how, .. } => of_stage(stage, "died", how),
        Happened::GivenUp { stage, how, why } => of_stage(stage, "given up", &format!("{how}: {why}")),
        Happened::Starved { stage } => of_stage(stage, "starved", "got no CPU"),
        Happened::Replaced { stage, outcome, program, .. } => of_stage(stage, outcome, program),
        Happened::Refused { stage, sender, cause, frames, .. } => {
            of_stage(stage, "refused", &format!("{frames} frames of the {sender}: {cause}"));
        }
        Happened::Linked => tracer.note(*at_ns, "linked", ""),
        Happened::Lost { at, topic, frames } => {
            tracer.note(*at_ns, "not recorded", &format!("{frames} frames of {topic}, at the {at}"));
        }
        Happened::Mark { text } => tracer.note(*at_ns, "mark", text),
        Happened::Kept { why } => tracer.note(*at_ns, "kept", why),
        Happened::Ended { how } => tracer.note(*at_ns, "ended", how),
    }
}
