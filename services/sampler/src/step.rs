use model::ModelConfig;
use ports::{Answer, Second, SecondInput, StageError, Step, Tick, drive};
use run::Run;
use wire::{Cause, ControlsTopic, Forecast, ForecastsTopic, Header, Rejected, Topic, TracksTopic};

use crate::memory::{open, resume, save_memory};
use crate::{STAGE, Sampler};

/// Runs the sampler as a process: `tracks` and `controls` in, `forecasts` out. A tick without controls also
/// gets forecasts.
///
/// # Errors
/// [`StageError`] if the run's model, options, shared memory or memory file can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    drive(run, &STAGE, |run| {
        let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
        open(run, &model)
    })
}

impl Step for Sampler {
    type Input = TracksTopic;
    type Second = ControlsTopic;
    type Output = ForecastsTopic;

    const SECOND: SecondInput = SecondInput::SameTick;

    fn answer(
        &mut self,
        tick: &Tick<'_, TracksTopic, ControlsTopic>,
        out: &mut Answer<'_, ForecastsTopic>,
    ) -> Result<(), Rejected> {
        let (horizon_len, modes_len) = (self.options().horizon_len, self.options().modes_len);
        out.header.counts.horizon_len = horizon_len as u32;
        out.header.counts.modes_len = modes_len as u32;
        out.header.resumed_ticks = self.resumed_ticks();
        let controls = match tick.second {
            Second::Frame(of, controls) => {
                out.header.shed = of.shed;
                Ok(controls)
            }
            Second::Refused => Err(Cause::Rejected),
            Second::None => Err(Cause::Late),
        };
        let header = Header { shed: out.header.shed, ..*tick.header };
        let written = match self.sample(&header, tick.input, controls, |count| out.elements(count)) {
            Err(why) if controls.is_ok() => {
                out.refuse(ControlsTopic::NAME, why);
                self.sample(&header, tick.input, Err(Cause::Rejected), |count| out.elements(count))?
            }
            written => written?,
        };
        if written < tick.input.len() {
            out.header.counts.agents_len = written as u32;
            out.header.silent_len = (tick.input.len() - written) as u32;
        }
        Ok(())
    }

    fn after(&mut self, tick: &Tick<'_, TracksTopic, ControlsTopic>) {
        self.commit_own(tick.header.seq + 1);
    }

    fn second_deadline_ns(&self) -> u64 {
        self.options().deadline_ns
    }

    fn follow(&mut self, header: &Header, sent: &[Forecast]) {
        Self::follow(self, header, sent);
    }

    fn begin(&mut self, run: &Run, incarnation: u32) {
        resume(run, self, incarnation);
    }

    fn end(&mut self, run: &Run) -> Result<(), StageError> {
        save_memory(run, self)
    }
}
