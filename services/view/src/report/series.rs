use recorder::Tick;
use serde::Serialize;
use wire::{Cause, Header, StageId};

/// Maximum number of points: more are joined in pairs, of which the slower one stays.
const POINTS_MAX: usize = 4_000;

/// Times and qualities of the ticks, as columns.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Series {
    /// Number and time of each tick.
    seq: Vec<u64>,
    t: Vec<f64>,
    /// End-to-end latency, ms.
    end_to_end: Vec<Option<f64>>,
    /// Computation of each stage, ms.
    stages: Vec<(String, Vec<Option<f64>>)>,
    /// Number of forecasts by cause; `none` counts the learned ones.
    causes: Vec<Vec<u64>>,
    /// Number of ticks for each point.
    ticks_per_point: usize,
    /// End-to-end latencies of all ticks, by whole milliseconds; the last bin has all longer ones.
    histogram: Vec<u64>,
    /// Number of ticks that the newest point has so far.
    #[serde(skip)]
    open: usize,
}

/// Number of bins of the histogram.
const BINS: usize = 161;

fn rounded_ms(time_ns: u64) -> f64 {
    (time_ns as f64 / 1e4).round() / 1e2
}

impl Series {
    pub fn add(&mut self, header: &Header, tick: &Tick) {
        if self.stages.is_empty() {
            let named = |stage: &StageId| (stage.name().to_owned(), Vec::new());
            self.stages = StageId::ALL.iter().map(named).collect();
            self.causes = vec![Vec::new(); Cause::ALL.len()];
            self.ticks_per_point = 1;
            self.histogram = vec![0; BINS];
        }
        if let Some(time_ns) = tick.passage.end_to_end_ns {
            self.histogram[((time_ns / 1_000_000) as usize).min(BINS - 1)] += 1;
        }
        self.seq.push(tick.seq);
        self.t.push(header.stamp_ns as f64 / 1e9);
        self.end_to_end.push(tick.passage.end_to_end_ns.map(rounded_ms));
        for (stage, (_, times)) in StageId::ALL.iter().zip(&mut self.stages) {
            times.push(tick.passage.phases(*stage).map(|phases| rounded_ms(phases.compute_ns)));
        }
        let learned = tick.agents.saturating_sub(tick.causes.iter().sum());
        for (cause, counts) in self.causes.iter_mut().enumerate() {
            counts.push(tick.causes[cause] + if cause == 0 { learned } else { 0 });
        }
        self.open += 1;
        if self.open > 1 {
            self.join_last();
        }
        if self.open == self.ticks_per_point {
            self.open = 0;
        }
        if self.len() > POINTS_MAX {
            self.halve();
        }
    }

    pub fn len(&self) -> usize {
        self.seq.len()
    }

    /// Removes the faster of two points.
    fn join(&mut self, place: usize) {
        let slower = |a: Option<f64>, b: Option<f64>| a.unwrap_or(f64::MAX) >= b.unwrap_or(f64::MAX);
        let gone = if slower(self.end_to_end[place], self.end_to_end[place + 1]) { place + 1 } else { place };
        self.seq.remove(gone);
        self.t.remove(gone);
        self.end_to_end.remove(gone);
        for (_, times) in &mut self.stages {
            times.remove(gone);
        }
        for counts in &mut self.causes {
            counts.remove(gone);
        }
    }

    fn join_last(&mut self) {
        self.join(self.len() - 2);
    }

    /// Joins the points in pairs.
    pub fn halve(&mut self) {
        for pair in 0..self.len() / 2 {
            self.join(pair);
        }
        self.ticks_per_point *= 2;
    }
}

#[cfg(test)]
mod tests {
    use wire::Hop;

    use super::*;

    #[test]
    fn a_long_run_keeps_its_slowest_ticks() {
        let mut series = Series::default();
        for seq in 0..10_000 {
            let slow = if seq == 7_777 { 150 } else { 5 + seq % 2 };
            let mut header =
                Header { released_ns: 1_000_000_000, ..Header::new(1, seq, seq as i64 * 80_000_000) };
            header.push_hop(Hop {
                stage: StageId::Sampler.number(),
                sent_ns: 1_000_000_000 + slow * 1_000_000,
                ..Hop::default()
            });
            series.add(&header, &Tick::alone(&header, &[]));
        }
        assert!((POINTS_MAX / 2..=POINTS_MAX).contains(&series.len()), "{}", series.len());
        assert_eq!(series.ticks_per_point, 4);
        let place = series.seq.iter().position(|seq| *seq == 7_777).unwrap();
        assert_eq!(series.end_to_end[place], Some(150.0));
        assert_eq!((series.histogram[150], series.histogram[5], series.histogram[6]), (1, 5_000, 4_999));
        assert!(series.seq.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
