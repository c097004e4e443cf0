use crate::Candidate;

/// The connected components of tracks and detections that candidates connect. Holds only scratch memory.
///
/// The structure is a union-find over the tracks, followed by the detections. The root of a component is its
/// first track.
#[derive(Clone, Debug, Default)]
pub(crate) struct Components {
    parent: Vec<u32>,
    /// Numbers of tracks and detections in the component of each root.
    sides: Vec<[u32; 2]>,
    track_count: u32,
}

impl Components {
    pub(crate) fn with_capacity(track_count: usize, detection_count: usize) -> Self {
        let len = track_count + detection_count;
        Self { parent: Vec::with_capacity(len), sides: Vec::with_capacity(len), track_count: 0 }
    }

    /// Makes every track and detection a separate component.
    pub(crate) fn clear(&mut self, track_count: usize, detection_count: usize) {
        self.track_count = track_count as u32;
        self.parent.clear();
        self.parent.extend(0..(track_count + detection_count) as u32);
        self.sides.clear();
        self.sides.resize(track_count, [1, 0]);
        self.sides.resize(track_count + detection_count, [0, 1]);
    }

    /// Joins the components that a candidate connects, unless the result would have more than `side_max`
    /// tracks or detections. Returns whether they are one component.
    pub(crate) fn join(&mut self, candidate: &Candidate, side_max: usize) -> bool {
        assert!(candidate.track < self.track_count, "track {} of {}", candidate.track, self.track_count);
        let (a, b) = (self.root(candidate.track), self.root(self.track_count + candidate.detection));
        if a == b {
            return true;
        }
        let (above, below) = (a.min(b), a.max(b));
        let [more, fewer] = [above, below].map(|root| self.sides[root as usize]);
        let sides = [more[0] + fewer[0], more[1] + fewer[1]];
        if sides.iter().any(|&len| len as usize > side_max) {
            return false;
        }
        self.parent[below as usize] = above;
        self.sides[above as usize] = sides;
        true
    }

    /// Whether a component has more than `side_max` tracks or detections.
    pub(crate) fn exceed(&self, side_max: usize) -> bool {
        // A root that was joined to another root keeps its smaller, earlier numbers.
        self.sides.iter().flatten().any(|&len| len as usize > side_max)
    }

    /// Sorts candidates by component, then track, then detection, and iterates over the components.
    pub(crate) fn split<'a>(
        &'a mut self,
        candidates: &'a mut [Candidate],
    ) -> impl Iterator<Item = &'a [Candidate]> {
        for node in 0..self.parent.len() as u32 {
            self.parent[node as usize] = self.root(node);
        }
        let parent = &self.parent;
        candidates.sort_unstable_by_key(|c| (parent[c.track as usize], c.track, c.detection));
        candidates.chunk_by(|a, b| parent[a.track as usize] == parent[b.track as usize])
    }

    fn root(&mut self, mut node: u32) -> u32 {
        while self.parent[node as usize] != node {
            let above = self.parent[self.parent[node as usize] as usize];
            self.parent[node as usize] = above;
            node = above;
        }
        node
    }
}
