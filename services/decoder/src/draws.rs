//! Latent draws from N(0, I). A draw depends only on seed, track, tick and the draw's index.

use wire::LATENT;

/// The increment of SplitMix64: the golden ratio as a 64-bit fraction.
const STEP: u64 = 0x9E37_79B9_7F4A_7C15;

/// The finaliser of SplitMix64: every bit of the input changes every bit of the output.
const fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// A counter-based generator. Number `i` of a stream is a function of the stream's key and `i`.
#[derive(Clone, Copy)]
pub(crate) struct Stream {
    key: u64,
}

impl Stream {
    /// The stream of a track at a tick.
    pub(crate) const fn new(seed: u64, track: u64, seq: u64) -> Self {
        let key = mix(seed.wrapping_add(STEP));
        let key = mix(key ^ track.wrapping_mul(STEP));
        Self { key: mix(key ^ seq.wrapping_add(STEP)) }
    }

    /// A number in (0, 1\].
    fn uniform(self, i: u64) -> f64 {
        let bits = mix(self.key.wrapping_add(i.wrapping_mul(STEP))) >> 11;
        (bits + 1) as f64 / (1_u64 << 53) as f64
    }

    /// The latent draw with index `draw`: independent standard normal numbers (Box-Muller).
    pub(crate) fn latent(self, draw: usize) -> [f32; LATENT] {
        let mut z = [0.0; LATENT];
        for (pair, z) in z.chunks_exact_mut(2).enumerate() {
            let i = (draw * LATENT + 2 * pair) as u64;
            let radius = (-2.0 * self.uniform(i).ln()).sqrt();
            let (sin, cos) = (std::f64::consts::TAU * self.uniform(i + 1)).sin_cos();
            z.copy_from_slice(&[(radius * cos) as f32, (radius * sin) as f32]);
        }
        z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_are_standard_normal() {
        let stream = Stream::new(3, 7, 11);
        let values: Vec<f64> = (0..4000).flat_map(|draw| stream.latent(draw)).map(f64::from).collect();
        let moment = |n: i32| values.iter().map(|x| x.powi(n)).sum::<f64>() / values.len() as f64;
        for (n, expected, within) in [(1, 0.0, 0.01), (2, 1.0, 0.02), (3, 0.0, 0.05), (4, 3.0, 0.1)] {
            assert!((moment(n) - expected).abs() < within, "moment {n} is {}", moment(n));
        }
    }

    #[test]
    fn seed_track_tick_and_draw_each_change_the_draw() {
        let first = Stream::new(1, 2, 3).latent(4);
        assert_eq!(first, Stream::new(1, 2, 3).latent(4));
        for other in [Stream::new(9, 2, 3), Stream::new(1, 9, 3), Stream::new(1, 2, 9)] {
            assert_ne!(first, other.latent(4));
        }
        assert_ne!(first, Stream::new(1, 2, 3).latent(5));
    }
}
