use std::collections::BTreeMap;

use run::Run;
use wire::{Heartbeat, HeartbeatsTopic, StageId};

use crate::{PortError, Subscriber};

/// Number used instead of a stage's number by the tap of a run. The tap sends heartbeats in lockstep, and
/// while a tool is attached. The tap is not a stage: only [`Peers::others_reached`] looks for it.
pub const TAP: u32 = 64;

/// If the newest heartbeat of the tap, or of an added stage, is older than this, it has died or was stopped:
/// nothing waits for it.
const TAP_SILENT_NS: u64 = 2_000_000_000;

/// The newest heartbeat of each stage of a run.
#[derive(Debug)]
pub struct Peers {
    heartbeats: Subscriber<HeartbeatsTopic>,
    newest: BTreeMap<u32, Heartbeat>,
    /// Stages that send heartbeats.
    expected: Vec<StageId>,
    /// Added stages that write a topic and whose output no forecast waits for.
    side_stages: Vec<StageId>,
}

impl Peers {
    /// Expects heartbeats of this project's own programs. A foreign program in a stage's place need not send
    /// heartbeats: it counts as linked when the stages that read from it are linked.
    #[must_use]
    pub fn new(heartbeats: Subscriber<HeartbeatsTopic>, run: &Run) -> Self {
        let built_in = run.stages.iter().filter(|stage| stage.built_in);
        let expected = built_in.filter_map(|stage| StageId::from_number(stage.stage)).collect();
        let writes = |id: &StageId| run.stage(*id).is_some_and(|stage| !stage.writes.is_empty());
        let side_stages = run.side_stages().into_iter().filter(writes).collect();
        Self { heartbeats, newest: BTreeMap::new(), expected, side_stages }
    }

    /// Takes the heartbeats that have arrived, and returns them.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn listen(&mut self) -> Result<Vec<Heartbeat>, PortError> {
        let mut received = Vec::new();
        while let Some(frame) = self.heartbeats.receive()? {
            received.extend_from_slice(&frame);
        }
        // A replaced process may have left a heartbeat in the queue.
        received.retain(|heartbeat: &Heartbeat| {
            let newest = self.newest.get(&heartbeat.stage).map_or(0, |newest| newest.incarnation);
            let is_new = heartbeat.incarnation >= newest;
            if is_new {
                self.newest.insert(heartbeat.stage, *heartbeat);
            }
            is_new
        });
        Ok(received)
    }

    /// The newest received heartbeat of a stage.
    #[must_use]
    pub fn newest(&self, stage: StageId) -> Option<&Heartbeat> {
        self.newest.get(&stage.number())
    }

    /// Whether a stage is a program of this project, which sends heartbeats.
    #[must_use]
    pub fn expects(&self, stage: StageId) -> bool {
        self.expected.contains(&stage)
    }

    /// The heartbeat topic; its events end a wait for heartbeats.
    #[must_use]
    pub const fn heartbeats(&self) -> &Subscriber<HeartbeatsTopic> {
        &self.heartbeats
    }

    /// Stages that are not linked to their neighbours yet.
    #[must_use]
    pub fn unlinked(&self) -> Vec<StageId> {
        let linked = |stage: &StageId| self.newest.get(&stage.number()).is_some_and(|h| h.linked == 1);
        self.expected.iter().copied().filter(|stage| !linked(stage)).collect()
    }

    /// Whether the tap and the added stages of `beside` have seen tick `seq` at `now_ns`, or do not follow
    /// the run.
    #[must_use]
    pub fn others_reached(&self, seq: u64, now_ns: u64) -> bool {
        let reached = |number: u32| {
            self.newest.get(&number).is_none_or(|heartbeat| {
                let is_silent = now_ns.saturating_sub(heartbeat.sent_ns) > TAP_SILENT_NS;
                heartbeat.linked == 0 || heartbeat.seq >= seq || is_silent
            })
        };
        reached(TAP) && self.side_stages.iter().all(|stage| reached(stage.number()))
    }

    /// Whether a stage has finished or refused tick `seq`.
    #[must_use]
    pub fn reached(&self, stage: StageId, seq: u64) -> bool {
        let newest = self.newest.get(&stage.number());
        newest.is_some_and(|h| h.seq >= seq && h.frames_len + h.rejected_len > 0)
    }
}
