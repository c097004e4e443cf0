use scene::{Choice, LIKES_MAX, Moment, PlaceMemory, Recall};
use wire::{HORIZON_MAX, MODES_MAX, Track};

use crate::learned::LearnedControls;
use crate::mover::Mover;

/// What those who came by earlier tell of where agents will go.
pub(crate) struct Recalling {
    memory: PlaceMemory,
    horizon_len: usize,
    // Kept from one agent to the next for their memory's sake.
    recall: Recall,
    choice: Choice,
    paths: Vec<[[f32; 2]; HORIZON_MAX]>,
}

impl Recalling {
    pub(crate) fn new(memory: PlaceMemory, horizon_len: usize) -> Self {
        let (recall, choice) = (Recall::with_room(), Choice::default());
        Self { memory, horizon_len, recall, choice, paths: Vec::with_capacity(MODES_MAX + LIKES_MAX) }
    }

    pub(crate) const fn memory(&self) -> &PlaceMemory {
        &self.memory
    }

    /// Shows the memory where everybody is at a time, unless it is an older one.
    pub(crate) fn observe(&mut self, stamp_ns: i64, tracks: &[Track]) {
        if self.memory.advance(stamp_ns) {
            let seen = tracks.iter().filter(|track| track.unseen_ns == 0);
            seen.for_each(|track| self.memory.observe(track.id, [track.x_m, track.y_m]));
        }
    }

    /// Tells the controls of an agent at a moment what others did at its like, and remembers the moment.
    pub(crate) fn tell(
        &mut self,
        (stamp_ns, agent): (i64, u64),
        moment: &Moment,
        mover: &Mover,
        controls: &mut LearnedControls<'_>,
    ) {
        self.memory.recall(agent, moment, &mut self.recall);
        // Controls that come after a newer tick are used, but not remembered.
        if self.memory.is_at(stamp_ns) {
            let path = controls.best_path(mover);
            self.memory.remember(agent, moment, &path[..self.horizon_len], &self.recall);
        }
        if self.recall.is_empty() {
            return;
        }
        controls
            .change(mover.changes(&self.recall.expected), mover.changes(&self.recall.expected_of_modes()));
        if self.recall.likes.is_empty() {
            return;
        }
        let changes = |place: usize| mover.changes(&self.recall.likes[place].departures);
        self.paths.clear();
        controls.mode_paths(mover, &mut self.paths);
        let likes = 0..self.recall.likes.len();
        self.paths.extend(likes.map(|place| controls.path_beside_best(mover, &changes(place))));
        let weights = self.recall.likes.iter().map(|like| like.weight);
        self.choice.choose(moment.gait(), &self.paths, self.horizon_len, controls.probability(), weights);
        let modes_len = controls.probability().len();
        for (mode, (chosen, probability)) in self.choice.chosen().enumerate() {
            controls.replace(mode, chosen.checked_sub(modes_len).map(changes), probability);
        }
    }
}
