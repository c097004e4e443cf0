use model::ModelConfig;
use ports::{Answer, SecondInput, StageError, Step, Tick, drive};
use run::Run;
use wire::{DetectionsTopic, ForecastsTopic, Header, Rejected, Topic, Track, TracksTopic, flags};

use crate::settings::settings;
use crate::{STAGE, Tracker, feedback};

/// Runs the tracker as a process: `detections` and earlier `forecasts` in, `tracks` out.
///
/// # Errors
/// [`StageError`] if the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    drive(run, &STAGE, |run| {
        let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
        Ok(Tracker::new(settings(run, &model)?).with_ids_of(ports::incarnation()))
    })
}

impl Step for Tracker {
    type Input = DetectionsTopic;
    type Second = ForecastsTopic;
    type Output = TracksTopic;

    const SECOND: SecondInput = SecondInput::Newest;
    const ANSWERS_MISSING: bool = true;

    fn answer(
        &mut self,
        tick: &Tick<'_, DetectionsTopic, ForecastsTopic>,
        out: &mut Answer<'_, TracksTopic>,
    ) -> Result<(), Rejected> {
        let prior = tick.second.frame();
        // The number of tracks is known only at the end, so they are copied.
        let mut tracks = self.take_room();
        let tracked = self.step(tick.header, tick.input, prior, &mut tracks);
        out.header = self.header(&out.header);
        let answered = tracked.and_then(|tracked| {
            // An out-of-sequence frame gets no answer, because newer tracks have already been published. The
            // next frame's tracks include its effect.
            if tracked.replayed_count > 0 {
                out.leave_empty();
                return Ok(());
            }
            if tracked.frozen_count > 0 {
                let (field, frames) = ("detections", tracked.frozen_count);
                out.refuse(DetectionsTopic::NAME, Rejected::Frozen { field, frames });
            }
            let tracks = &mut tracks[..tracked.track_count];
            if !tick.header.has(flags::LOCKSTEP) {
                let prior = prior.filter(|(of, _)| of.seq >= self.session_seq());
                feedback::write(&mut out.header, tracks, prior);
            }
            out.elements(tracks.len())?.copy_from_slice(tracks);
            Ok(())
        });
        self.return_room(tracks);
        answered
    }

    fn after(&mut self, tick: &Tick<'_, DetectionsTopic, ForecastsTopic>) {
        self.audit(tick.header, tick.input);
    }

    fn log(&mut self) {
        self.warn();
        if let Some(set) = self.session_begun() {
            tracing::warn!("input: {set}: a new session begins, and the tracks end");
        }
        for finding in self.new_doubts() {
            let found = finding.found(|place| format!("tick {}", place.line));
            tracing::warn!("input: {found}");
        }
        self.new_noise_changes().for_each(|change| tracing::warn!("input: {change}"));
    }

    fn follow(&mut self, header: &Header, sent: &[Track]) {
        self.predecessor.follow(header, sent);
    }

    fn begin(&mut self, _: &Run, _: u32) {
        let predecessor = std::mem::take(&mut self.predecessor);
        self.begin_with(&predecessor);
    }
}
