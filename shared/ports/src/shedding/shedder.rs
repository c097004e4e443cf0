use run::Run;
use wire::{Header, StageId, flags};

use crate::shedding::capacity::Capacity;
use crate::shedding::cutoff::Cutoff;

/// The agents that a step may serve in a tick.
#[derive(Clone, Copy, Debug, Default)]
pub enum Allowance<'a> {
    /// All agents. Nothing is left out, and no turns are given.
    #[default]
    All,
    /// At most this many, in the order of their turns.
    AtMost(usize),
    /// Agents whose work begins before `until_ns`, in the order of their turns.
    Until {
        /// A time on `clock`.
        until_ns: u64,
        /// A monotonic clock.
        clock: fn() -> u64,
    },
    /// Agents that this header does not mark as shed. A replay of a recorded tick uses this.
    AsRecorded(&'a Header),
}

/// Decides for one stage how many agents each tick may serve.
///
/// Three stages shed load:
///
/// * The extractor chooses for itself, the encoder and the decoder. All three must end by the decoder's
///   cutoff. The headers contain their total time.
/// * The encoder uses its own cutoff and the time that its agents took.
/// * The decoder reads the clock between blocks of agents.
#[derive(Debug)]
pub struct Shedder(Option<Policy>);

#[derive(Debug)]
struct Policy {
    stage: StageId,
    cutoff: Cutoff,
    capacity: Capacity,
}

impl Shedder {
    /// The shedder of a stage in a run. It allows everything if the run or the stage sheds no load.
    #[must_use]
    pub fn new(run: &Run, stage: StageId) -> Self {
        let deadline_ns = match stage {
            StageId::Extractor => {
                run.deadline_ns(StageId::Decoder).filter(|_| run.deadline_ns(stage).is_some())
            }
            StageId::Encoder | StageId::Decoder => run.deadline_ns(stage),
            _ => None,
        };
        Self(deadline_ns.map(|deadline_ns| Policy {
            stage,
            cutoff: Cutoff::new(deadline_ns, run.left_for_sampler_ns()),
            capacity: Capacity::default(),
        }))
    }

    /// The allowance of a tick whose step begins at `now_ns` on `clock`.
    pub fn allow(&mut self, header: &Header, now_ns: u64, clock: fn() -> u64) -> Allowance<'static> {
        let Some(Policy { stage, cutoff, capacity }) = &mut self.0 else { return Allowance::All };
        if header.has(flags::LOCKSTEP) {
            return Allowance::All;
        }
        let until_ns = cutoff.until_ns(header);
        if *stage == StageId::Decoder {
            return Allowance::Until { until_ns, clock };
        }
        if *stage == StageId::Extractor {
            capacity.took(header.chain_ns, header.chain_len as usize);
        }
        Allowance::AtMost(capacity.fit(until_ns.saturating_sub(now_ns)))
    }

    /// Adds the time of a step. `served` is the number of agents that it served, if the step reports it.
    pub fn took(&mut self, time_ns: u64, served: Option<usize>) {
        let Some(Policy { stage, capacity, .. }) = &mut self.0 else { return };
        match (*stage, served) {
            (StageId::Extractor, _) => capacity.took_fixed(time_ns),
            (_, Some(served)) => capacity.took(time_ns, served),
            (_, None) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use run::StageRun;

    use super::*;
    use crate::shedding::SERVED_MIN;

    const MS: u64 = 1_000_000;

    /// A run with 60 ms for the stages up to the decoder: 20 for the extractor, 10 for the encoder and 30 for
    /// the decoder.
    fn run() -> Run {
        let budgets_ms = [(StageId::Extractor, 20.0), (StageId::Encoder, 10.0), (StageId::Decoder, 30.0)];
        let stage = |(stage, budget_ms): (StageId, f64)| StageRun {
            stage: stage.number(),
            budget_ms: Some(budget_ms),
            built_in: true,
            options: String::new(),
            name: String::new(),
            program: String::new(),
            places: [].into(),
            reads: Vec::new(),
            writes: Vec::new(),
        };
        Run { stages: budgets_ms.map(stage).to_vec(), ..Run::default() }
    }

    fn allowed(shedder: &mut Shedder, header: &Header, now_ms: u64) -> Option<usize> {
        match shedder.allow(header, now_ms * MS, || 0) {
            Allowance::AtMost(agents) => Some(agents),
            _ => None,
        }
    }

    #[test]
    fn an_encoder_serves_what_fits_until_its_own_cutoff() {
        let mut encoder = Shedder::new(&run(), StageId::Encoder);
        let header = Header::default();
        assert_eq!(allowed(&mut encoder, &header, 0), Some(usize::MAX), "no cost is known");
        encoder.took(20 * MS, Some(20));
        encoder.took(500 * MS, None);
        assert_eq!(allowed(&mut encoder, &header, 5), Some(25), "1 ms an agent until 30 ms");
        assert_eq!(allowed(&mut encoder, &header, 60), Some(SERVED_MIN));
    }

    #[test]
    fn an_extractor_counts_the_stages_up_to_the_decoder() {
        let mut extractor = Shedder::new(&run(), StageId::Extractor);
        let header = Header { chain_ns: 20 * MS, chain_len: 10, ..Header::default() };
        extractor.took(4 * MS, Some(7));
        assert_eq!(allowed(&mut extractor, &header, 0), Some(28), "2 ms an agent of 60 ms less 4 ms");
    }

    #[test]
    fn a_decoder_looks_at_the_clock() {
        let mut decoder = Shedder::new(&run(), StageId::Decoder);
        let header = Header { released_ns: MS, ..Header::default() };
        let allowance = decoder.allow(&header, 5 * MS, || 7);
        let Allowance::Until { until_ns, clock } = allowance else { panic!("{allowance:?}") };
        assert_eq!((until_ns, clock()), (61 * MS, 7));
    }

    #[test]
    fn nothing_is_left_out_in_lockstep_or_by_other_stages() {
        let lockstep = Header { flags: flags::LOCKSTEP, ..Header::default() };
        let mut decoder = Shedder::new(&run(), StageId::Decoder);
        assert!(matches!(decoder.allow(&lockstep, 900 * MS, || 0), Allowance::All));
        for mut shedder in [
            Shedder::new(&run(), StageId::Localiser),
            Shedder::new(&Run { shed: false, ..run() }, StageId::Encoder),
            Shedder::new(&Run { lockstep: true, ..run() }, StageId::Encoder),
        ] {
            assert!(matches!(shedder.allow(&Header::default(), 900 * MS, || 0), Allowance::All));
        }
    }
}
