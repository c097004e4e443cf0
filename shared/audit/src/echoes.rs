//! Paths that appear twice, because two sensors see the same agents and their clocks differ.
//!
//! Each chord of an agent's path is compared with earlier chords of other agents. If it begins on such a chord
//! and has the same velocity, it is an *echo*, and the time between the two is its lag. Agents that follow each
//! other also make echoes, with another lag for each pair. A second clock gives one lag to all of them.

use crate::agent::Way;
use crate::tally::Tally;

/// Number of chords that are kept, and longest and shortest lag.
const WAYS_MAX: usize = 2_048;
const LAG_MAX_S: f64 = 60.0;
const LAG_MIN_S: f64 = 0.3;
/// Width of a bin of lags. Five neighbouring bins count as one lag, because positions have noise.
const BIN_S: f64 = 0.1;
const BINS: usize = (LAG_MAX_S / BIN_S) as usize;
const WINDOW: usize = 5;
/// Largest distance across an earlier chord, and largest difference of two velocities: a part and a share.
const ACROSS_M: f64 = 0.8;
const VELOCITY_MPS: f64 = 0.6;
const VELOCITY_SHARE: f64 = 0.05;
/// Number of agents with echoes of one lag that are kept.
const PAIRS: usize = 8;
/// Smallest number of agents that follow others and lead none, and the smallest share of their echoes among the
/// chords. Half of all chords are the second ones. The inner agents of a convoy follow and lead.
const FOLLOWERS_MIN: [(usize, f64); 2] = [(3, 0.25), (2, 0.4)];
/// Smallest ratio between the speeds of these agents.
const SPEEDS_RATIO: f32 = 1.15;
/// Smallest number of echoes with one lag.
const ECHOES_MIN: u64 = 12;
/// Smallest ratio to the echoes of a usual lag. In dense traffic every lag has some.
const CONTRAST: f64 = 5.0;
/// Smallest ratio to the echoes of the windows on both sides together. People in a crowd follow others after any time.
const PEAK: f64 = 1.5;

/// The agents of an echo: who leads and who follows.
type Pair = [u32; 2];

/// The echoes of one lag.
#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    chords: u64,
    rows: Tally,
    /// The first pairs of agents that have echoes, and the speed of their first one.
    pairs: [Option<(Pair, f32)>; PAIRS],
}

/// The newest chords, and the echoes by lag.
#[derive(Clone, Debug)]
pub(crate) struct Echoes {
    ways: Vec<(usize, Way)>,
    next: usize,
    bins: Box<[Bin]>,
    chords: u64,
    /// First and newest start of a chord.
    span_ns: Option<[i64; 2]>,
}

impl Echoes {
    pub fn new() -> Self {
        Self {
            ways: Vec::with_capacity(WAYS_MAX),
            next: 0,
            bins: vec![Bin::default(); BINS].into(),
            chords: 0,
            span_ns: None,
        }
    }

    /// Discards the echoes and the chords.
    pub fn clear(&mut self) {
        self.ways.clear();
        self.bins.fill(Bin::default());
        (self.next, self.chords, self.span_ns) = (0, 0, None);
    }

    /// Adds a chord of an agent of this type.
    pub fn add(&mut self, of_type: usize, way: &Way) {
        let Self { ways, bins, .. } = self;
        for (_, earlier) in
            ways.iter().filter(|(other, earlier)| *other == of_type && earlier.agent != way.agent)
        {
            let Some(lag_s) = way.lag_s(earlier) else { continue };
            let bin = &mut bins[((lag_s / BIN_S) as usize).min(BINS - 1)];
            bin.chords += 1;
            bin.rows.add(way.rows, way.place);
            let pair = [earlier.agent, way.agent];
            let mut pairs = bin.pairs.iter_mut();
            if let Some(free) = pairs.find(|known| known.is_none_or(|(known, _)| known == pair)) {
                free.get_or_insert((pair, way.speed_mps() as f32));
            }
        }
        self.chords += 1;
        let [first_ns, newest_ns] = self.span_ns.unwrap_or([way.from_ns; 2]);
        self.span_ns = Some([first_ns.min(way.from_ns), newest_ns.max(way.from_ns)]);
        if self.ways.len() < WAYS_MAX {
            self.ways.push((of_type, *way));
        } else {
            self.ways[self.next] = (of_type, *way);
            self.next = (self.next + 1) % WAYS_MAX;
        }
    }

    /// The lag of a second clock and the rows of its echoes.
    pub fn doubt(&self) -> Option<(f64, Tally)> {
        let [first_ns, newest_ns] = self.span_ns?;
        let span_s = newest_ns.saturating_sub(first_ns) as f64 * 1e-9;
        let chords = |at: usize| self.bins[at..at + WINDOW].iter().map(|bin| bin.chords).sum::<u64>();
        let best = (0..=BINS - WINDOW).max_by_key(|&at| chords(at))?;
        let window = &self.bins[best..best + WINDOW];
        let echoes = chords(best);
        let mean =
            window.iter().zip(best..).map(|(bin, at)| bin.chords as f64 * (at as f64 + 0.5)).sum::<f64>();
        let lag_s = mean / echoes.max(1) as f64 * BIN_S;
        // Chords of the first seconds have no earlier ones.
        let possible = self.chords as f64 * (1.0 - lag_s / span_s).max(0.0);
        // The other lags of a window.
        let all: u64 = self.bins.iter().map(|bin| bin.chords).sum();
        let usual = (all - echoes) as f64 * WINDOW as f64 / (BINS - WINDOW) as f64;
        let beside = [best.checked_sub(WINDOW), Some(best + WINDOW).filter(|at| at + WINDOW <= BINS)];
        let beside: u64 = beside.into_iter().flatten().map(chords).sum();
        let followers = followers(window);
        let is_found = echoes >= ECHOES_MIN
            && echoes as f64 >= CONTRAST * usual
            && echoes as f64 >= PEAK * beside as f64
            && FOLLOWERS_MIN
                .iter()
                .any(|(least, share)| followers >= *least && echoes as f64 >= share * possible);
        let mut rows = Tally::default();
        for bin in window {
            bin.rows.first.into_iter().for_each(|place| rows.add(bin.rows.rows, place));
        }
        is_found.then_some((lag_s, rows))
    }
}

/// Number of agents that follow others and lead none, or lead others and follow none: the smaller one. Agents at
/// one speed are not counted: their lag may be a distance, as that of a trailer.
fn followers(window: &[Bin]) -> usize {
    let pairs = || window.iter().flat_map(|bin| bin.pairs).flatten();
    let count = |role: usize| {
        let is_pure = |pair: &Pair| pairs().all(|(other, _)| other[1 - role] != pair[role]);
        let mut range_mps = [f32::INFINITY, 0.0_f32];
        let mut count = 0;
        for (at, (pair, speed_mps)) in pairs().enumerate().filter(|(_, (pair, _))| is_pure(pair)) {
            range_mps = [range_mps[0].min(speed_mps), range_mps[1].max(speed_mps)];
            count += usize::from(pairs().take(at).all(|(earlier, _)| earlier[role] != pair[role]));
        }
        if range_mps[1] >= SPEEDS_RATIO * range_mps[0] { count } else { 0 }
    };
    count(0).min(count(1))
}

impl Way {
    /// The time since another agent was where this chord begins, if it moved as this agent does.
    fn lag_s(&self, earlier: &Self) -> Option<f64> {
        let off_m = [0, 1].map(|axis| f64::from(self.from_m[axis]) - f64::from(earlier.from_m[axis]));
        let [x_mps, y_mps] = earlier.velocity_mps;
        let speed_mps = x_mps.hypot(y_mps);
        let along_s = (off_m[0] * x_mps + off_m[1] * y_mps) / (speed_mps * speed_mps);
        let across_m = (off_m[1] * x_mps - off_m[0] * y_mps) / speed_mps;
        let change_mps = (self.velocity_mps[0] - x_mps).hypot(self.velocity_mps[1] - y_mps);
        let lag_s = self.from_ns.saturating_sub(earlier.from_ns) as f64 * 1e-9 - along_s;
        let is_echo = (0.0..earlier.elapsed_s).contains(&along_s)
            && across_m.abs() <= ACROSS_M
            && change_mps <= VELOCITY_MPS + VELOCITY_SHARE * speed_mps;
        (is_echo && (LAG_MIN_S..LAG_MAX_S).contains(&lag_s)).then_some(lag_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Place;

    /// Agents on lines 6 m apart, seen for 40 s, and again `lag_s` later if `twice`. Each has its own speed.
    fn echoes(twice: bool, lag_s: f64, agents: u32) -> Echoes {
        let mut echoes = Echoes::new();
        for second in 0..80_u32 {
            for (clock, seen_s) in [(0, 0.0), (1, lag_s)] {
                let at_s = f64::from(second) - seen_s;
                if (clock == 1 && !twice) || !(0.0..40.0).contains(&at_s) {
                    continue;
                }
                for agent in 0..agents {
                    let speed_mps = 4.0 + f64::from(agent);
                    let way = Way {
                        agent: 1 + agent + 100 * clock,
                        from_m: [(speed_mps * at_s) as f32, 6.0 * agent as f32],
                        from_ns: i64::from(second) * 1_000_000_000,
                        velocity_mps: [speed_mps, 0.0],
                        elapsed_s: 1.0,
                        rows: 10,
                        place: Place::default(),
                    };
                    echoes.add(0, &way);
                }
            }
        }
        echoes
    }

    #[test]
    fn a_second_clock_gives_one_lag_to_all_agents() {
        for lag_s in [0.7, 2.0, 5.0, 18.0] {
            let (found_s, rows) = echoes(true, lag_s, 5).doubt().expect("a second clock");
            assert!((found_s - lag_s).abs() < 0.2, "{lag_s}: {found_s}");
            assert!(rows.rows > 1_000, "{lag_s}: {rows:?}");
        }
        assert!(echoes(true, 5.0, 2).doubt().is_some());
        assert_eq!(echoes(false, 5.0, 5).doubt(), None);
        // One agent that follows another.
        assert_eq!(echoes(true, 5.0, 1).doubt(), None);
    }

    #[test]
    fn a_convoy_with_equal_gaps_has_one_clock() {
        let mut echoes = Echoes::new();
        for second in 0..60 {
            for agent in 0..8 {
                // The gaps differ by less than the width of a lag.
                let gap_m = 20.0 + (agent % 3) as f32;
                let way = Way {
                    agent: 1 + agent,
                    from_m: [10.0 * second as f32 - gap_m * agent as f32, 0.0],
                    from_ns: i64::from(second) * 1_000_000_000,
                    velocity_mps: [10.0, 0.0],
                    elapsed_s: 1.0,
                    rows: 10,
                    place: Place::default(),
                };
                echoes.add(0, &way);
            }
        }
        assert_eq!(echoes.doubt(), None);
    }

    /// Like people of a campus who cross a street behind each other, at all distances.
    #[test]
    fn a_crowd_has_no_clock() {
        let mut echoes = Echoes::new();
        for second in 0..60 {
            for agent in 0..40_u32 {
                let speed_mps = 1.2 + 0.1 * f64::from(agent % 4);
                let behind_m = f64::from(agent * agent * 29 % 101) / 8.0;
                let way = Way {
                    agent: 1 + agent,
                    from_m: [(speed_mps * f64::from(second) - behind_m) as f32, 3.0 * (agent % 4) as f32],
                    from_ns: i64::from(second) * 1_000_000_000,
                    velocity_mps: [speed_mps, 0.0],
                    elapsed_s: 1.0,
                    rows: 10,
                    place: Place::default(),
                };
                echoes.add(0, &way);
            }
        }
        assert_eq!(echoes.doubt(), None);
    }

    #[test]
    fn trailers_follow_at_one_distance() {
        let mut echoes = Echoes::new();
        for second in 0..60 {
            for (agent, [behind_m, y_m]) in (1..).zip([[0.0, 0.0], [10.0, 0.0], [0.0, 8.0], [10.0, 8.0]]) {
                let way = Way {
                    agent,
                    from_m: [8.0 * second as f32 - behind_m, y_m],
                    from_ns: i64::from(second) * 1_000_000_000,
                    velocity_mps: [8.0, 0.0],
                    elapsed_s: 1.0,
                    rows: 10,
                    place: Place::default(),
                };
                echoes.add(0, &way);
            }
        }
        assert_eq!(echoes.doubt(), None);
    }
}
