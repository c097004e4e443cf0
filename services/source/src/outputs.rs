use ports::{Awaiting, Peers, PortError, Publisher, Stage, StageError, monotonic_ns};
use run::Run;
use wire::{Detection, DetectionsTopic, Header, StageId, Topic, Truth, TruthTopic};

use crate::Tick;

/// Interval of the frames that link the pipeline and of the frames that end it.
pub(crate) const REPEAT_NS: u64 = 25_000_000;

/// Number of empty frames that a restarted source sends before its first tick. Each stage sends a heartbeat
/// every 80 ms, so the heartbeats of all stages arrive within four frames.
const TAKE_OVER_LEN: usize = 4;

/// The source's publishers, and the heartbeats of the later stages.
#[derive(Debug)]
pub struct Outputs {
    detections: Publisher<DetectionsTopic>,
    truth: Publisher<TruthTopic>,
    peers: Peers,
}

impl Outputs {
    /// Opens the topics.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn open(stage: &mut Stage, run: &Run) -> Result<Self, PortError> {
        Ok(Self { detections: stage.publish()?, truth: stage.publish()?, peers: stage.peers(run)? })
    }

    /// Does the work between two ticks that is due. It does not wait.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn tend(&mut self, stage: &mut Stage) -> Result<(), PortError> {
        self.peers.listen()?;
        stage.sleep_on(self.peers.heartbeats(), 0).map(drop)
    }

    /// Releases a tick. The truth goes first, so that it is available when the forecasts arrive.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, stage: &mut Stage, tick: &Tick<'_>) -> Result<(), PortError> {
        self.release(stage, tick.header, tick.detections, tick.truth_header(), tick.truth)
    }

    fn release(
        &self,
        stage: &mut Stage,
        header: Header,
        detections: &[Detection],
        truth_header: Header,
        truth: &[Truth],
    ) -> Result<(), PortError> {
        self.truth.send_copy(truth, truth_header)?;
        let passage = stage.release(header);
        let loan = self.detections.copy(detections)?;
        stage.finish(passage, &self.detections, Ok(loan))
    }

    /// Sends a frame without elements, which is not a tick.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send_empty(&self, stage: &mut Stage, header: Header) -> Result<(), PortError> {
        self.truth.send_copy(&[], header)?;
        let passage = stage.release(header);
        stage.pass_empty(passage, &self.detections)
    }

    /// Sends an empty frame repeatedly until the peers have answered it.
    ///
    /// # Errors
    /// [`StageError::NoAnswer`] if the peers do not answer within `limit_ns`. A signal that asks the process
    /// to end is not an error.
    pub fn repeat(
        &mut self,
        stage: &mut Stage,
        header: Header,
        limit_ns: u64,
        answered: impl Fn(&Peers) -> bool,
    ) -> Result<(), StageError> {
        let end_ns = monotonic_ns() + limit_ns;
        while monotonic_ns() < end_ns && !stage.stop().requested() {
            self.send_empty(stage, header)?;
            if self.wait_until(stage, monotonic_ns() + REPEAT_NS, &answered)? {
                return Ok(());
            }
        }
        if stage.stop().requested() { Ok(()) } else { Err(self.unanswered(Awaiting::StartOrEnd, limit_ns)) }
    }

    /// Takes over from a source that died or was replaced. Empty frames wake the readers, which then connect
    /// to this process. Returns the number of the newest tick that the tracker has answered.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn take_over(&mut self, stage: &mut Stage, header: Header) -> Result<Option<u64>, PortError> {
        for _ in 0..TAKE_OVER_LEN {
            self.send_empty(stage, header)?;
            // After a live replacement, the newest tick is known without waiting for heartbeats.
            if let Some(seq) = stage.taken_over() {
                return Ok(Some(seq));
            }
            self.wait_until(stage, monotonic_ns() + REPEAT_NS, |_| false)?;
        }
        let tracker = self.peers.newest(StageId::Tracker).filter(|heartbeat| heartbeat.frames_len > 0);
        Ok(tracker.map(|heartbeat| heartbeat.seq))
    }

    /// Waits until the recorder has the forecasts of a tick. Also waits for the tap and for added stages
    /// outside the tick's path, if they follow the run. In lockstep, no tick is therefore lost, neither in the
    /// run nor in a recording.
    ///
    /// # Errors
    /// As [`Outputs::repeat`].
    pub fn wait_for_forecasts(
        &mut self,
        stage: &mut Stage,
        seq: u64,
        limit_ns: u64,
    ) -> Result<(), StageError> {
        let reached = |peers: &Peers| {
            peers.reached(StageId::Recorder, seq) && peers.others_reached(seq, monotonic_ns())
        };
        if self.wait_until(stage, monotonic_ns() + limit_ns, reached)? || stage.stop().requested() {
            return Ok(());
        }
        Err(self.unanswered(Awaiting::Tick(seq), limit_ns))
    }

    fn wait_until(
        &mut self,
        stage: &mut Stage,
        until_ns: u64,
        answered: impl Fn(&Peers) -> bool,
    ) -> Result<bool, PortError> {
        loop {
            self.peers.listen()?;
            if answered(&self.peers) {
                return Ok(true);
            }
            if monotonic_ns() >= until_ns || !stage.sleep_on(self.peers.heartbeats(), until_ns)? {
                return Ok(false);
            }
        }
    }

    fn unanswered(&self, awaited: Awaiting, limit_ns: u64) -> StageError {
        let (topic, limit_ms) = (DetectionsTopic::NAME, limit_ns / 1_000_000);
        StageError::NoAnswer { awaited, topic, limit_ms, unlinked: self.peers.unlinked() }
    }
}
