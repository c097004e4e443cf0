use wire::HistoryState;

use crate::smoothing::{Correction, Link, Spread};

/// States kept per track: 5 s at 80 ms, more than the longest window.
const STATES_MAX: usize = 64;

/// The published states of one track in time order.
///
/// A published state is never rewritten. Of exact detections, the window at a later time therefore has the same
/// bits, and everything computed for (track, stamp) stays valid. Of noisy detections, the older states of each
/// window are [smoothed](crate::smoothing). A time between two states gets their interpolation.
#[derive(Clone, Copy, Debug)]
pub struct History {
    past: [Past; STATES_MAX],
    /// Spread of the newest state.
    spread: Spread,
    /// Number of states pushed so far. The newest state is at (len − 1) modulo the ring's size.
    len: usize,
}

/// A published state.
#[derive(Clone, Copy, Debug)]
struct Past {
    stamp_ns: i64,
    state: HistoryState,
    /// The link to the next state, once there is one.
    link: Link,
}

impl History {
    /// A history without states.
    #[must_use]
    pub const fn new() -> Self {
        const ABSENT: HistoryState =
            HistoryState { x_m: 0.0, y_m: 0.0, vx_mps: 0.0, vy_mps: 0.0, heading_rad: 0.0, present: 0 };
        const NONE: Past = Past { stamp_ns: 0, state: ABSENT, link: Link::NONE };
        Self { past: [NONE; STATES_MAX], spread: Spread::NONE, len: 0 }
    }

    /// Appends the state of `stamp_ns`, which is later than all others. A full ring drops the oldest state.
    pub fn push(&mut self, stamp_ns: i64, state: HistoryState, spread: Spread) {
        let state = HistoryState { present: 1, ..state };
        if self.len > 0 {
            let newest = self.slot(0);
            let Past { stamp_ns: before_ns, state: before, link } = &mut self.past[newest];
            let dt_s = stamp_ns.abs_diff(*before_ns) as f64 / 1e9;
            *link = self.spread.link(before, (&state, &spread), dt_s);
        }
        self.past[self.len % STATES_MAX] = Past { stamp_ns, state, link: Link::NONE };
        self.spread = spread;
        self.len += 1;
    }

    /// Sets the state of `stamp_ns` as it is: appends it if it is later than all others, and replaces it if it
    /// is held. Other states change nothing.
    pub fn set(&mut self, stamp_ns: i64, state: HistoryState) {
        let held = self.len.min(STATES_MAX);
        match (0..held).find(|&back| self.stamp_ns(back) <= stamp_ns) {
            Some(back) if self.stamp_ns(back) == stamp_ns => {
                let slot = self.slot(back);
                self.past[slot].state = state;
            }
            None if held > 0 => (),
            Some(0) | None => self.push(stamp_ns, state, Spread::NONE),
            Some(_) => (),
        }
    }

    /// Sets the velocity and heading of all states to those of `known`, as long as no state is published.
    ///
    /// If a track's first detection is only a position, its first state has no velocity.
    pub fn backfill(&mut self, known: &HistoryState) {
        for Past { state, link, .. } in &mut self.past[..self.len.min(STATES_MAX)] {
            (state.vx_mps, state.vy_mps) = (known.vx_mps, known.vy_mps);
            state.heading_rad = known.heading_rad;
            *link = Link::NONE;
        }
    }

    /// Writes the states at now − (len − 1 − k) Δt, oldest first. Absent states are zero.
    ///
    /// A time between two states gets their interpolation, unless the two states are more than `gap_max_ns`
    /// apart.
    pub fn window(&self, now_ns: i64, step_ns: u64, gap_max_ns: u64, window: &mut [HistoryState]) {
        let mut corrections = [Correction::default(); STATES_MAX];
        let corrected = if self.spread.is_noisy() {
            let oldest_ns = now_ns.saturating_sub_unsigned(step_ns.saturating_mul(window.len() as u64));
            self.correct(oldest_ns, gap_max_ns, &mut corrections)
        } else {
            0
        };
        let state = |back: usize| {
            let Past { state, link, .. } = self.at(back);
            if (1..corrected).contains(&back) { link.corrected(state, corrections[back]) } else { *state }
        };
        let held = self.len.min(STATES_MAX);
        // Steps back from the newest state. The window is filled from its newest end, so this only grows.
        let mut back = 0;
        // At an even frame rate the increment is the same each time.
        let mut stride = 0;
        for (k, entry) in window.iter_mut().rev().enumerate() {
            let wanted_ns = now_ns.saturating_sub_unsigned(step_ns.saturating_mul(k as u64));
            if back + stride < held && self.stamp_ns(back + stride) == wanted_ns {
                back += stride;
            } else {
                let last = back;
                while back < held && self.stamp_ns(back) > wanted_ns {
                    back += 1;
                }
                stride = back - last;
            }
            *entry = if back == held {
                HistoryState::default()
            } else if self.stamp_ns(back) == wanted_ns {
                state(back)
            } else if back == 0 {
                HistoryState::default()
            } else {
                self.between(back, wanted_ns, gap_max_ns, state)
            };
        }
    }

    /// Computes the corrections of the states by their steps back from the newest: from `oldest_ns` on, and after
    /// the last gap of more than `gap_max_ns`. Returns their number.
    fn correct(&self, oldest_ns: i64, gap_max_ns: u64, corrections: &mut [Correction; STATES_MAX]) -> usize {
        let held = self.len.min(STATES_MAX);
        for back in 1..held {
            let Past { stamp_ns, link, .. } = self.at(back);
            if *stamp_ns < oldest_ns || self.stamp_ns(back - 1).abs_diff(*stamp_ns) > gap_max_ns {
                return back;
            }
            corrections[back] = link.correction(corrections[back - 1]);
        }
        held
    }

    /// The state between the one `back` steps ago and its successor.
    fn between(
        &self,
        back: usize,
        wanted_ns: i64,
        gap_max_ns: u64,
        state: impl Fn(usize) -> HistoryState,
    ) -> HistoryState {
        let (before_ns, after_ns) = (self.stamp_ns(back), self.stamp_ns(back - 1));
        let gap_ns = after_ns.abs_diff(before_ns);
        if gap_ns > gap_max_ns {
            return HistoryState::default();
        }
        let share = (wanted_ns.abs_diff(before_ns) as f64 / gap_ns as f64) as f32;
        let (before, after) = (state(back), state(back - 1));
        let mix = |a: f32, b: f32| a + (b - a) * share;
        let turn = filters::wrapped(f64::from(after.heading_rad) - f64::from(before.heading_rad));
        let heading = f64::from(before.heading_rad) + turn * f64::from(share);
        HistoryState {
            x_m: mix(before.x_m, after.x_m),
            y_m: mix(before.y_m, after.y_m),
            vx_mps: mix(before.vx_mps, after.vx_mps),
            vy_mps: mix(before.vy_mps, after.vy_mps),
            heading_rad: filters::wrapped(heading) as f32,
            present: 1,
        }
    }

    fn slot(&self, back: usize) -> usize {
        (self.len - 1 - back) % STATES_MAX
    }

    fn at(&self, back: usize) -> &Past {
        &self.past[self.slot(back)]
    }

    fn stamp_ns(&self, back: usize) -> i64 {
        self.at(back).stamp_ns
    }
}

impl Default for History {
    fn default() -> Self {
        Self::new()
    }
}
