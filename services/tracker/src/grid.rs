use wire::{AgentType, POSITION_MAX_M};

/// Side of a cell: about the gate of a track that was just detected.
const CELL_M: f64 = 2.0;
/// Minimum number of cells per detection.
const CELLS_RATIO: usize = 2;

/// The data of a detection that gating needs.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    /// Position in the world frame.
    pub position_m: [f64; 2],
    /// Variance of the position per axis.
    pub variance: f64,
    /// Number of the detection.
    pub detection: u32,
    /// Type of the detection.
    pub agent_type: AgentType,
}

/// A spatial hash of the detections of a frame, used as a pre-gate of the association. Holds only scratch
/// memory.
///
/// The plane is divided into cells of one size. Cells whose distance is a multiple of `side` share a list. A
/// frame of any extent therefore needs few cells, and a distant stray detection does not affect the others.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Cells along each axis, a power of two.
    side: u32,
    /// Start of each cell's spots. The spots of the last cell end at the end of the list.
    first: Vec<u32>,
    /// Spots cell by cell, and within a cell in the order of the detections.
    spots: Vec<Spot>,
}

impl Grid {
    /// A grid for this number of detections.
    #[must_use]
    pub fn with_capacity(detection_count: usize) -> Self {
        let cell_count = (side(detection_count) as usize).pow(2);
        Self {
            side: 1,
            first: Vec::with_capacity(cell_count + 1),
            spots: Vec::with_capacity(detection_count),
        }
    }

    /// Replaces the detections by the detections of a frame.
    pub fn fill(&mut self, spots: impl DoubleEndedIterator<Item = Spot> + Clone) {
        let spot_count = spots.clone().count();
        self.side = side(spot_count);
        self.first.clear();
        self.first.resize((self.side as usize).pow(2) + 1, 0);
        for spot in spots.clone() {
            let cell = self.cell(spot.position_m.map(line));
            self.first[cell] += 1;
        }
        // Turns the counts into the end of each cell. Placing a cell's spots from the back moves this to the
        // start of the cell.
        let mut end = 0;
        for count in &mut self.first {
            end += *count;
            *count = end;
        }
        let unplaced =
            Spot { position_m: [0.0; 2], variance: 0.0, detection: 0, agent_type: AgentType::Vehicle };
        self.spots.clear();
        self.spots.resize(spot_count, unplaced);
        for spot in spots.rev() {
            let cell = self.cell(spot.position_m.map(line));
            self.first[cell] -= 1;
            self.spots[self.first[cell] as usize] = spot;
        }
    }

    /// All spots within `reach_m` of a point along each axis, and some others.
    pub fn near(&self, centre_m: [f64; 2], reach_m: [f64; 2]) -> impl Iterator<Item = &Spot> {
        let lines = |axis: usize| {
            let [from, to] = [-reach_m[axis], reach_m[axis]].map(|off_m| line(centre_m[axis] + off_m));
            // Beyond this the cells repeat.
            from..=to.min(from + self.side - 1)
        };
        let columns = lines(0);
        lines(1).flat_map(move |y| columns.clone().flat_map(move |x| self.spots_of(self.cell([x, y]))))
    }

    /// All spots.
    pub fn spots(&self) -> &[Spot] {
        &self.spots
    }

    fn spots_of(&self, cell: usize) -> &[Spot] {
        &self.spots[self.first[cell] as usize..self.first[cell + 1] as usize]
    }

    fn cell(&self, [x, y]: [u32; 2]) -> usize {
        let around = self.side - 1;
        ((y & around) * self.side + (x & around)) as usize
    }
}

/// Number of the line of cells that contains a coordinate. It increases with the coordinate.
fn line(coordinate_m: f64) -> u32 {
    ((coordinate_m + f64::from(POSITION_MAX_M)) / CELL_M) as u32
}

fn side(spot_count: usize) -> u32 {
    (CELLS_RATIO * spot_count).isqrt().next_power_of_two() as u32
}
