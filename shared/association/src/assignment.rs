//! Optimal assignment of detections to tracks, with a cost for each track that remains unpaired.
//!
//! Gating leaves few possible pairs, so the problem separates into *connected components* that share no track
//! and no detection:
//!
//! * an uncontested pair is assigned immediately;
//! * a component with a single track or detection takes its cheapest candidate;
//! * any other component is solved by the optimal assignment of the `lsap` crate.
//!
//! Five hundred agents are then hundreds of tiny problems instead of one dense problem.

use crate::Candidate;
use crate::components::Components;

/// Solves assignments. Holds only scratch memory.
#[derive(Clone, Debug, Default)]
pub struct Assigner {
    /// Number of candidates of each track. `of_detection` counts them for each detection.
    of_track: Vec<u32>,
    of_detection: Vec<u32>,
    components: Components,
    scratch: Scratch,
}

/// Scratch memory of one component.
#[derive(Clone, Debug, Default)]
struct Scratch {
    /// Column of each detection of the frame in the current component.
    column: Vec<u32>,
    detections: Vec<u32>,
    costs: Vec<f64>,
}

impl Assigner {
    /// Scratch memory for this number of tracks and detections.
    #[must_use]
    pub fn with_capacity(track_count: usize, detection_count: usize) -> Self {
        Self {
            of_track: Vec::with_capacity(track_count),
            of_detection: Vec::with_capacity(detection_count),
            components: Components::with_capacity(track_count, detection_count),
            scratch: Scratch {
                column: Vec::with_capacity(detection_count),
                detections: Vec::with_capacity(detection_count),
                costs: Vec::new(),
            },
        }
    }

    /// Writes the detection of each track to `paired[track]`. The assignment minimises the sum of the chosen
    /// candidates' costs plus `miss_cost` for each track without a detection.
    ///
    /// `paired` has one entry per track. The candidates are consumed. A candidate is ignored if its cost is
    /// not finite or not below `miss_cost`. Only components with at least two tracks and two detections
    /// allocate (inside `lsap`).
    ///
    /// # Panics
    /// If a candidate names a track or detection beyond the given numbers.
    pub fn solve(
        &mut self,
        candidates: &mut Vec<Candidate>,
        detection_count: usize,
        miss_cost: f64,
        paired: &mut [Option<u32>],
    ) {
        paired.fill(None);
        candidates.retain(|c| c.cost.is_finite() && c.cost < miss_cost);
        self.pair_uncontested(candidates, detection_count, paired);
        if candidates.is_empty() {
            return;
        }
        self.scratch.column.clear();
        self.scratch.column.resize(detection_count, u32::MAX);
        self.components.clear(paired.len(), detection_count);
        for candidate in candidates.iter() {
            self.components.join(candidate, usize::MAX);
        }
        for component in self.components.split(candidates) {
            self.scratch.solve(component, miss_cost, paired);
        }
    }

    /// Pairs each track and detection whose only candidate is each other, and removes these candidates.
    fn pair_uncontested(
        &mut self,
        candidates: &mut Vec<Candidate>,
        detection_count: usize,
        paired: &mut [Option<u32>],
    ) {
        let Self { of_track, of_detection, .. } = self;
        of_track.clear();
        of_track.resize(paired.len(), 0);
        of_detection.clear();
        of_detection.resize(detection_count, 0);
        for c in candidates.iter() {
            of_track[c.track as usize] += 1;
            of_detection[c.detection as usize] += 1;
        }
        candidates.retain(|c| {
            let contested = of_track[c.track as usize] > 1 || of_detection[c.detection as usize] > 1;
            if !contested {
                paired[c.track as usize] = Some(c.detection);
            }
            contested
        });
    }
}

impl Scratch {
    fn solve(&mut self, component: &[Candidate], miss_cost: f64, paired: &mut [Option<u32>]) {
        let (first, last) = (component[0], component[component.len() - 1]);
        let one_detection = component.iter().all(|c| c.detection == first.detection);
        if first.track == last.track || one_detection {
            let cheapest = component.iter().min_by(|a, b| a.cost.total_cmp(&b.cost)).unwrap_or(&first);
            paired[cheapest.track as usize] = Some(cheapest.detection);
            return;
        }
        self.detections.clear();
        for c in component {
            if self.column[c.detection as usize] == u32::MAX {
                self.column[c.detection as usize] = self.detections.len() as u32;
                self.detections.push(c.detection);
            }
        }
        let row_count = 1 + component.windows(2).filter(|pair| pair[0].track != pair[1].track).count();
        // One additional column per track represents a miss. A pair beyond the gate costs as much as a miss
        // and counts as one, so all costs have a similar magnitude.
        let column_count = self.detections.len() + row_count;
        self.costs.clear();
        self.costs.resize(row_count * column_count, miss_cost);
        let by_track = || component.chunk_by(|a, b| a.track == b.track);
        for (row, of_track) in by_track().enumerate() {
            for c in of_track {
                self.costs[row * column_count + self.column[c.detection as usize] as usize] = c.cost;
            }
        }
        // The solver cannot fail: every cost is finite, and there are more columns than rows.
        let Ok((rows, columns)) = lsap::solve(row_count, column_count, &self.costs, false) else { return };
        let mut chosen = rows.into_iter().zip(columns);
        for (row, of_track) in by_track().enumerate() {
            let Some((_, column)) = chosen.next().filter(|&(r, _)| r == row) else { return };
            let detection = self.detections.get(column).copied();
            let gated = of_track.iter().find(|c| Some(c.detection) == detection);
            paired[of_track[0].track as usize] = gated.map(|c| c.detection);
        }
    }
}
