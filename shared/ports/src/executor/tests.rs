use proptest::prelude::*;
use wire::{ForecastsTopic, TracksTopic};

use super::*;

fn headers() -> impl Strategy<Value = Header> {
    (0..u64::MAX / 2, 0..u64::MAX, 0_u32..128).prop_map(|(seq, released_ns, flags)| Header {
        flags,
        released_ns,
        ..Header::new(1, seq, 0)
    })
}

/// What can have arrived of a second input, as the number of a frame.
fn arrivals() -> impl Strategy<Value = Awaited<u32>> {
    let lost = Just(Header::default());
    prop_oneof![
        any::<u32>().prop_map(Awaited::Frame),
        any::<u32>().prop_map(Awaited::Void),
        Just(()).prop_map(|()| Awaited::Late),
        lost.prop_map(Awaited::Lost),
    ]
}

proptest! {
    #[test]
    fn only_ticks_that_nobody_has_refused_have_work(header in headers()) {
        let others = flags::WARM_UP | flags::END | flags::VOID;
        prop_assert_eq!(has_work(&header), header.flags & others == 0);
    }

    #[test]
    fn in_lockstep_a_tick_waits_without_a_deadline(header in headers(), deadline_ns: u64) {
        let until = |seq, until_ns| Some(Wanted::OfTick { seq, until_ns });
        let is_lockstep = header.has(flags::LOCKSTEP);
        let due_ns = (!is_lockstep).then(|| header.released_ns.saturating_add(deadline_ns));
        prop_assert_eq!(wanted(SecondInput::None, &header, deadline_ns), None);
        prop_assert_eq!(wanted(SecondInput::SameTick, &header, deadline_ns), until(header.seq, due_ns));
        let newest = match header.seq.checked_sub(1).filter(|_| is_lockstep) {
            Some(previous) => until(previous, None),
            None => Some(Wanted::Newest),
        };
        prop_assert_eq!(wanted(SecondInput::Newest, &header, deadline_ns), newest);
    }

    #[test]
    fn a_later_stage_s_frame_stays_until_the_next_one(arrived in prop::collection::vec(arrivals(), 1..40)) {
        let (mut newest, mut last) = (None, None);
        for awaited in arrived {
            if let Awaited::Frame(number) = awaited {
                last = Some(number);
            }
            let of_tick = keep(SecondInput::Newest, Some(awaited), &mut newest);
            prop_assert!(matches!(of_tick, Some(Awaited::Late)));
            prop_assert_eq!(newest, last);
        }
    }

    #[test]
    fn a_frame_of_the_same_tick_is_not_kept(awaited in arrivals()) {
        let (mut newest, before) = (None, format!("{awaited:?}"));
        let of_tick = keep(SecondInput::SameTick, Some(awaited), &mut newest);
        prop_assert_eq!(format!("{:?}", of_tick.unwrap()), before);
        prop_assert_eq!(newest, None);
    }
}

/// Copies a tick's stamp; the place of its frames is the test.
struct Echo {
    refuses: Option<u64>,
    calls: Vec<String>,
}

impl Step for Echo {
    type Input = TracksTopic;
    type Second = ForecastsTopic;
    type Output = TracksTopic;

    const SECOND: SecondInput = SecondInput::SameTick;

    fn answer(
        &mut self,
        tick: &Tick<'_, TracksTopic, ForecastsTopic>,
        out: &mut Answer<'_, TracksTopic>,
    ) -> Result<(), Rejected> {
        let second = match tick.second {
            Second::Frame(header, _) => format!("frame {}", header.seq),
            Second::Refused => "refused".to_owned(),
            Second::None => "none".to_owned(),
        };
        self.calls.push(format!("answer {} with {second}", tick.header.seq));
        out.header.counts.agents_len = 7;
        match self.refuses == Some(tick.header.seq) {
            true => Err(Rejected::Impossible { field: "seq", value: tick.header.seq as f64 }),
            false => Ok(()),
        }
    }

    fn after(&mut self, tick: &Tick<'_, TracksTopic, ForecastsTopic>) {
        self.calls.push(format!("after {}", tick.header.seq));
    }

    fn log(&mut self) {
        self.calls.push("log".to_owned());
    }
}

struct Empty(Header);

impl<T: Topic> Readable<T> for Empty {
    fn header(&self) -> &Header {
        &self.0
    }

    fn elements(&self) -> &[T::Element] {
        &[]
    }
}

/// Frames of a test: what has arrived of the second input, and what was sent.
#[derive(Default)]
struct Here {
    second: Option<Awaited<Empty>>,
    sent: Vec<String>,
}

impl Room<TracksTopic> for Here {
    fn elements(&mut self, _: usize) -> Result<&mut [wire::Track], Rejected> {
        Ok(&mut [])
    }
}

impl Frames<'static, Echo> for Here {
    type Input = Empty;
    type Second = Empty;
    type Fault = std::convert::Infallible;

    const LOGS: bool = true;

    fn pass(&mut self, header: Header, _: Option<&Empty>) -> Result<(), Self::Fault> {
        self.sent.push(format!("pass {} {}", header.seq, header.counts.agents_len));
        Ok(())
    }

    fn second(&mut self, _: Wanted) -> Result<Awaited<Empty>, Self::Fault> {
        Ok(self.second.take().unwrap_or(Awaited::Late))
    }

    fn begin(&mut self, header: Header, _: Option<&Empty>, _: Option<&Empty>) -> Header {
        header
    }

    fn allowance(&mut self, _: &Header) -> Allowance<'static> {
        Allowance::All
    }

    fn refuse(&mut self, _: &Header, _: &'static str, _: &Rejected) {}

    fn send(&mut self, header: Header, outcome: Outcome, _: Option<usize>) -> Result<(), Self::Fault> {
        let is_refused = matches!(outcome, Outcome::Refused(_));
        assert_eq!(is_refused, header.has(flags::VOID));
        self.sent.push(format!("send {} {}", header.seq, header.counts.agents_len));
        Ok(())
    }
}

#[test]
fn a_tick_is_answered_then_the_rest_is_done_and_void_frames_are_passed_on() {
    const STAGE: Declaration<()> = crate::declare::<Echo, ()>(StageId::Sampler);
    let mut executor = Executor::new(&STAGE, Echo { refuses: Some(2), calls: Vec::new() });
    let mut tick = |seq: u64, flags: u32, second: Option<Awaited<Empty>>| {
        let mut header = Header { flags, ..Header::new(1, seq, 0) };
        header.counts.agents_len = 3;
        let mut here = Here { second, sent: Vec::new() };
        let goes_on = executor.tick(&header, Some(&Empty(header)), &mut here).unwrap();
        (goes_on, here.sent.join(", "), std::mem::take(&mut executor.step.calls).join(", "))
    };
    let of = |seq: u64| Empty(Header::new(1, seq, 0));
    let answered = |sent: &str, calls: &str| (true, sent.to_owned(), calls.to_owned());
    assert_eq!(
        tick(1, 0, Some(Awaited::Frame(of(1)))),
        answered("send 1 7", "answer 1 with frame 1, after 1, log")
    );
    assert_eq!(
        tick(2, 0, Some(Awaited::Void(of(2)))),
        answered("send 2 0", "answer 2 with refused, after 2, log")
    );
    let lost = Awaited::Lost(Header::default());
    assert_eq!(tick(3, 0, Some(lost)), answered("send 3 7", "answer 3 with refused, after 3, log"));
    assert_eq!(tick(4, 0, None), answered("send 4 7", "answer 4 with none, after 4, log"));
    for flags in [flags::VOID, flags::WARM_UP, flags::END] {
        assert_eq!(tick(5, flags, None), answered("pass 5 0", ""));
    }
    assert_eq!(tick(6, 0, Some(Awaited::Stopped)), (false, String::new(), String::new()));
}
