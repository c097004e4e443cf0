use wire::AgentType;

/// Speeds at which evidence is kept, by type, with interpolation between them. Some pedestrians stand, most
/// walk and few run.
pub const SPEEDS_MPS: [[f32; BANDS]; 3] =
    [[0.5, 2.5, 6.0, 11.0, 18.0, 28.0], [0.5, 2.5, 6.0, 11.0, 18.0, 28.0], [0.15, 0.8, 1.4, 2.2, 4.0, 8.0]];
/// Number of speeds per type.
pub const BANDS: usize = 6;

/// Position of a speed in [`SPEEDS_MPS`]: the band below, and the share of the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Context {
    /// Type of the agent.
    pub agent_type: AgentType,
    /// Index into the type's [`SPEEDS_MPS`], at most `BANDS - 2`.
    pub below: usize,
    /// Share of the band above, 0 to 1.
    pub share: f32,
}

/// Copies the value of the nearest known speed to each unknown one. If none is known, nothing changes.
pub fn fill_unknown<T: Copy>(bands: &mut [T; BANDS], known: &[bool; BANDS]) {
    for band in 0..BANDS {
        let nearest = (0..BANDS).filter(|&other| known[other]).min_by_key(|other| other.abs_diff(band));
        bands[band] = nearest.map_or(bands[band], |nearest| bands[nearest]);
    }
}

impl Context {
    /// The context of an agent.
    #[must_use]
    pub fn new(agent_type: AgentType, speed_mps: f32) -> Self {
        let speeds = &SPEEDS_MPS[agent_type.index()];
        let below = speeds[1..BANDS - 1].iter().filter(|&&speed| speed_mps >= speed).count();
        let [from, to] = [speeds[below], speeds[below + 1]];
        Self { agent_type, below, share: ((speed_mps - from) / (to - from)).clamp(0.0, 1.0) }
    }

    /// The two bands and their shares.
    pub const fn bands(&self) -> [(usize, f32); 2] {
        [(self.below, 1.0 - self.share), (self.below + 1, self.share)]
    }

    /// The band with the nearest speed.
    pub const fn nearest(&self) -> usize {
        if self.share < 0.5 { self.below } else { self.below + 1 }
    }

    /// Interpolates a quantity that is known at the bands.
    pub(crate) fn between<const N: usize>(&self, at: impl Fn(usize) -> [f32; N]) -> [f32; N] {
        let [below, above] = [at(self.below), at(self.below + 1)];
        std::array::from_fn(|i| below[i] + self.share * (above[i] - below[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_lie_between_their_bands() {
        let at = |speed_mps| Context::new(AgentType::Vehicle, speed_mps);
        assert_eq!((at(0.0).below, at(0.0).share), (0, 0.0));
        assert_eq!((at(2.5).below, at(2.5).share), (1, 0.0));
        assert_eq!((at(8.5).below, at(8.5).share), (2, 0.5));
        assert_eq!((at(60.0).below, at(60.0).share), (BANDS - 2, 1.0));
        assert_eq!(at(8.5).between(|band| [band as f32]), [2.5]);
        // A standing agent shares no evidence with a walking one.
        let [standing, walking] = [0.0, 1.4].map(|speed_mps| Context::new(AgentType::Pedestrian, speed_mps));
        assert_eq!([standing, walking].map(|of| (of.below, of.share)), [(0, 0.0), (2, 0.0)]);
    }
}
