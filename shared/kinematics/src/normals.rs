/// Counter-based standard normal numbers. The same key gives the same numbers, independent of draws for other
/// keys.
///
/// SplitMix64 hashes (key, counter) to bits. Box and Muller's transform turns each hash into a pair of
/// normals.
#[derive(Clone, Debug)]
pub struct Normals {
    key: u64,
    counter: u64,
    spare: Option<f32>,
}

impl Normals {
    /// The stream of a run's `seed`, an agent's `id` and a tick's `seq`.
    #[must_use]
    pub const fn new(seed: u64, id: u64, seq: u64) -> Self {
        Self { key: hash(hash(hash(seed) ^ id) ^ seq), counter: 0, spare: None }
    }

    /// The next number. Its magnitude is below 6.
    pub fn draw(&mut self) -> f32 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        self.counter += 1;
        let bits = hash(self.key ^ self.counter);
        // 24 bits each: the first number in (0, 1], so that its logarithm is finite, and the second in [0,
        // 1).
        let unit = |bits: u64| (bits & 0xff_ffff) as f32 / 16_777_216.0;
        let radius = (-2.0 * (1.0 - unit(bits)).ln()).sqrt();
        let (sin, cos) = (std::f32::consts::TAU * unit(bits >> 24)).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

const fn hash(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
