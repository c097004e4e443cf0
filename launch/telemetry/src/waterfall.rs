//! One tick as a waterfall chart, with the outcome of each of its agents.

use std::fmt::{self, Write};

use recorder::passage::{Phases, Timestamps};
use recorder::text::{count, number};
use recorder::{Tick, WorstTick};
use wire::{AgentType, Cause, Forecast, Header, Quality, StageId, flags};

/// Minimum and maximum line width.
const WIDTHS: std::ops::RangeInclusive<usize> = 80..=140;
/// Number of characters before the bars.
const BARS_AT: usize = 45;
/// Fill characters of the phases: waiting, wake-up, compute, publish.
const FILLS: [char; 4] = ['·', '░', '█', '▒'];

/// A recorded frame of the tick.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameOf {
    /// Topic.
    pub topic: &'static str,
    /// Number of its elements.
    pub elements: usize,
    /// Size with the header.
    pub bytes: usize,
}

/// All data of a tick.
#[derive(Clone, Debug)]
pub struct WholeTick {
    /// The header of its forecasts.
    pub header: Header,
    /// Forecasts.
    pub forecasts: Vec<Forecast>,
    /// Figures.
    pub tick: Tick,
    /// Frames, in the order in which they were recorded.
    pub frames: Vec<FrameOf>,
    /// The cause of the tick's latency.
    pub cause: Option<WorstTick>,
    /// Release time of the first tick.
    pub begun_ns: u64,
    /// Events around the time of the tick.
    pub events: Vec<(u64, String)>,
}

impl WholeTick {
    /// Formats the tick as text in lines of `width` characters, clamped to 80..=140.
    pub fn render(&self, width: usize) -> String {
        let width = width.clamp(*WIDTHS.start(), *WIDTHS.end());
        let mut text = String::new();
        let mut write = || -> fmt::Result {
            self.head(&mut text)?;
            self.stages(&mut text, width)?;
            self.nearby(&mut text)?;
            self.agents(&mut text)
        };
        write().expect("writing to a string can't fail");
        text
    }

    /// The stages that the tick passed, with their incarnations and times.
    fn times(&self) -> impl Iterator<Item = (StageId, u32, Timestamps)> {
        self.header.hops().iter().filter_map(|hop| {
            let stage = StageId::from_number(hop.stage)?;
            Some((stage, hop.incarnation, self.tick.passage.times(stage)?))
        })
    }

    fn total_ns(&self) -> u64 {
        let end_ns = self.times().map(|(.., times)| times.sent_ns).max();
        end_ns.unwrap_or(0).saturating_sub(self.header.released_ns)
    }

    fn head(&self, text: &mut String) -> fmt::Result {
        let header = &self.header;
        let at_s = header.released_ns.saturating_sub(self.begun_ns) as f64 / 1e9;
        let agents = match self.forecasts.len() {
            1 => "1 agent".to_owned(),
            len => format!("{len} agents"),
        };
        writeln!(
            text,
            "tick {}   {agents}   stamp {:.3} s   released {at_s:.3} s after the first",
            count(header.seq),
            header.stamp_ns as f64 / 1e9
        )?;
        let (total_ms, limit_ms) = (self.total_ns() as f64 / 1e6, self.tick.limit_ns as f64 / 1e6);
        let verdict = match () {
            () if header.has(flags::LOCKSTEP) => "lockstep: no deadline",
            () if self.tick.is_late() => "late",
            () => "in time",
        };
        writeln!(text, "end to end {} ms of {limit_ms} ms: {verdict}", number(Some(total_ms)))?;
        if let Some(cause) = &self.cause {
            writeln!(text, "longest: {}", cause.cause)?;
        }
        let marks =
            [(flags::PREDICTED, "its tracks are predicted: no detections arrived"), (flags::VOID, "void")];
        for (_, mark) in marks.iter().filter(|(flag, _)| header.has(*flag)) {
            writeln!(text, "{mark}")?;
        }
        if header.left_out_len > 0 || header.silent_len > 0 {
            let (left_out, silent) = (header.left_out_len, header.silent_len);
            writeln!(
                text,
                "agents left out of the full frame: {left_out}, by the policy of degradation: {silent}"
            )?;
        }
        let frames: Vec<String> =
            self.frames.iter().map(|frame| format!("{} {}", frame.elements, frame.topic)).collect();
        writeln!(text, "recorded: {}", frames.join(", "))
    }

    fn stages(&self, text: &mut String, width: usize) -> fmt::Result {
        let cells = width - BARS_AT;
        let total_ns = self.total_ns().max(1);
        let total_ms = number(Some(total_ns as f64 / 1e6));
        let axis = format!("0 {:>1$} ms", total_ms, cells.saturating_sub(5));
        writeln!(
            text,
            "\n{:11}{:>8}{:>8}{:>8}{:>8}  {axis}",
            "ms", "waiting", "wake-up", "compute", "publish"
        )?;
        for (stage, incarnation, times) in self.times() {
            let name = match incarnation {
                0 => stage.name().to_owned(),
                n => format!("{} ↻{n}", stage.name()),
            };
            write!(text, "{name:11}")?;
            for time_ns in Phases::from(times).each_ns() {
                write!(text, "{:>8}", number(Some(time_ns as f64 / 1e6)))?;
            }
            writeln!(text, "  {}", self.bar(&times, cells, total_ns).trim_end())?;
        }
        let [waiting, wake_up, compute, publish] = FILLS;
        writeln!(
            text,
            "{:BARS_AT$}{waiting} waiting  {wake_up} wake-up  {compute} compute  {publish} publish",
            ""
        )
    }

    /// Draws a stage's phases on the tick's time axis.
    fn bar(&self, times: &Timestamps, cells: usize, total_ns: u64) -> String {
        let place = |at_ns: u64| {
            let since_ns = at_ns.saturating_sub(self.header.released_ns).min(total_ns);
            (u128::from(since_ns) * cells as u128 / u128::from(total_ns)) as usize
        };
        let mut bar = vec![' '; cells];
        let Timestamps { ready_ns, free_ns, taken_ns, started_ns, finished_ns, sent_ns } = *times;
        let [waiting, wake_up, compute, publish] = FILLS;
        let parts = [
            (ready_ns, free_ns, waiting),
            (free_ns, taken_ns, wake_up),
            (taken_ns, started_ns, waiting),
            (finished_ns, sent_ns, publish),
            (started_ns, finished_ns, compute),
        ];
        for (from_ns, to_ns, fill) in parts {
            let to = place(to_ns);
            let from = place(from_ns).min(to);
            bar[from..to].fill(fill);
        }
        // The computation is always visible, however short.
        bar[place(started_ns).min(cells - 1)] = compute;
        bar.into_iter().collect()
    }

    fn nearby(&self, text: &mut String) -> fmt::Result {
        if self.events.is_empty() {
            return Ok(());
        }
        writeln!(text)?;
        self.events.iter().try_for_each(|(at_ns, event)| {
            let since_ms = (*at_ns as i128 - i128::from(self.header.released_ns)) as f64 / 1e6;
            writeln!(text, "{since_ms:>+9.1} ms  {event}")
        })
    }

    fn agents(&self, text: &mut String) -> fmt::Result {
        if self.forecasts.is_empty() {
            return writeln!(text, "\nno forecasts");
        }
        writeln!(
            text,
            "\n{:>8} {:12}{:>9}{:>9}{:>7}  {:11}{:>8}  {:10}{:>6}  why held or kinematic",
            "agent", "type", "x m", "y m", "m/s", "quality", "age ms", "prior", "modes"
        )?;
        let mut sorted: Vec<&Forecast> = self.forecasts.iter().collect();
        // Forecasts that are not learned come first, because readers look for them.
        sorted.sort_by_key(|forecast| (forecast.quality == Quality::Learned as u32, forecast.id));
        sorted.into_iter().try_for_each(|forecast| agent(text, forecast))
    }
}

fn agent(text: &mut String, forecast: &Forecast) -> fmt::Result {
    let unknown = "unknown";
    let kind = AgentType::from_number(forecast.agent_type).map_or(unknown, AgentType::name);
    let quality = Quality::from_number(forecast.quality).map_or(unknown, Quality::name);
    let prior = Quality::from_number(forecast.prior).map_or(unknown, Quality::name);
    let speed_mps = forecast.vx_mps.hypot(forecast.vy_mps);
    let age_ms = forecast.age_ns as f64 / 1e6;
    let why = if forecast.quality == Quality::Learned as u32 { String::new() } else { causes(forecast) };
    let line = format!(
        "{:>8} {kind:12}{:>9.2}{:>9.2}{speed_mps:>7.2}  {quality:11}{age_ms:>8.0}  {prior:10}{:>6}  {why}",
        forecast.id, forecast.x_m, forecast.y_m, forecast.modes_len
    );
    writeln!(text, "{}", line.trim_end())
}

/// Lists all applicable causes, primary cause first.
fn causes(forecast: &Forecast) -> String {
    let first = Cause::from_number(forecast.cause);
    let others =
        Cause::ALL.into_iter().filter(|&cause| Some(cause) != first && forecast.causes & cause.bit() != 0);
    let names: Vec<_> = std::iter::once(Cause::name_of(forecast.cause))
        .chain(others.map(|cause| cause.name().into()))
        .collect();
    names.join(", ")
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use wire::Hop;

    use super::*;

    const MS: u64 = 1_000_000;

    fn whole_tick() -> WholeTick {
        let mut header =
            Header { released_ns: 5_000 * MS, interval_ns: 80 * MS, ..Header::new(1, 153, 12_240_000_000) };
        for (stage, incarnation, at_ms, took_ms) in [
            (StageId::Source, 0, 0, 0),
            (StageId::Tracker, 0, 1, 2),
            (StageId::Decoder, 2, 4, 40),
            (StageId::Sampler, 0, 45, 5),
        ] {
            let received_ns = header.released_ns + at_ms * MS + MS / 10;
            let finished_ns = received_ns + took_ms * MS;
            let (started_ns, sent_ns, stage) = (received_ns, finished_ns, stage.number());
            header.push_hop(Hop { stage, incarnation, received_ns, started_ns, finished_ns, sent_ns });
        }
        let learned = Forecast { id: 4, modes_len: 20, x_m: 1.5, vx_mps: 3.0, ..Forecast::zeroed() };
        let held = Forecast {
            id: 9,
            quality: Quality::Held as u32,
            cause: Cause::Late as u32,
            causes: Cause::Late.bit() | Cause::Missing.bit(),
            age_ns: 160 * MS,
            ..learned
        };
        WholeTick {
            frames: vec![FrameOf { topic: "detections", elements: 3, bytes: 900 }],
            cause: Some(WorstTick {
                cause: "the decoder computed 40.0 ms (usually 3.10)".to_owned(),
                ..WorstTick::default()
            }),
            begun_ns: 1_000 * MS,
            events: vec![(4_900 * MS, "the decoder was killed by signal 9, and is started again".to_owned())],
            tick: Tick::alone(&header, &[learned, held]),
            forecasts: vec![learned, held],
            header,
        }
    }

    #[test]
    fn a_tick_is_told_from_its_release_to_its_forecasts() {
        let text = whole_tick().render(100);
        let line =
            |part: &str| text.lines().find(|line| line.contains(part)).unwrap_or_else(|| panic!("{part}"));
        assert!(line("tick 153").contains("2 agents   stamp 12.240 s   released 4.000 s after the first"));
        assert!(line("end to end").contains("50.1 ms of 80 ms: in time"));
        let decoder = line("decoder ↻2");
        assert!(decoder.contains("1.00    40.0   0.000"), "{decoder}");
        // 40 of 50 ms in 55 cells.
        assert!((42..=45).contains(&decoder.matches('█').count()), "{decoder}");
        assert!(line("source").contains('█'), "the shortest computation shows");
        assert!(line("killed by signal 9").contains("-100.0 ms"));
        // Forecasts that are not learned come first.
        let agents: Vec<&str> =
            text.lines().skip_while(|line| !line.contains("why held or kinematic")).collect();
        assert!(agents[1].contains("held") && agents[1].ends_with("late, missing"), "{text}");
        assert!(agents[2].ends_with("20"), "{text}");
    }

    #[test]
    fn any_width_and_an_empty_tick_can_be_told() {
        for width in [0, 80, 1_000] {
            whole_tick().render(width);
        }
        let header = Header::new(1, 153, 0);
        let empty =
            WholeTick { forecasts: Vec::new(), tick: Tick::alone(&header, &[]), header, ..whole_tick() };
        assert!(empty.render(80).contains("no forecasts"));
    }
}
