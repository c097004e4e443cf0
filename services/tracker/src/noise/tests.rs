//! The noise that is learned from generated positions of known noise.

use bytemuck::Zeroable;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use wire::AgentType;

use super::*;

const AGENTS: usize = 12;
const SIGMA_M: f64 = 0.12;
const NOMINAL_M: f64 = 0.25;

/// What is learned in 20 s from agents at 9 m/s. The noise is a first-order process with this correlation time.
fn learned(rate_hz: f64, correlation_s: f64, sigma_m: impl Fn(f64) -> f64) -> PositionNoise {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
    let mut agents = [([0.0_f64; 2], Measurements::default()); AGENTS];
    agents.iter_mut().for_each(|(off, _)| *off = [draw(), draw()]);
    let mut noise = PositionNoise::new(PRIOR_COUNT, NOMINAL_M);
    let correlation = (-1.0 / (rate_hz * correlation_s)).exp();
    for frame in 0..(20.0 * rate_hz) as u32 {
        let time_s = f64::from(frame) / rate_hz;
        for (off, measurements) in &mut agents {
            *off = off.map(|off| correlation * off + (1.0 - correlation * correlation).sqrt() * draw());
            let [x_m, y_m] = off.map(|off| sigma_m(time_s) * off);
            let x_m = (9.0 * time_s + x_m) as f32;
            let detection = Detection { x_m, y_m: y_m as f32, ..Detection::zeroed() };
            let stamp_ns = (time_s * 1e9) as i64;
            measurements.add(&Found::new(stamp_ns, &detection, AgentType::Vehicle), NOMINAL_M, None);
            noise.add(&measurements.take());
        }
    }
    noise
}

/// The learned variances of noise of [`SIGMA_M`], in units of the true variance.
fn learned_ratios(rate_hz: f64, correlation_s: f64) -> [f64; 2] {
    let Learned { own, as_independent } = learned(rate_hz, correlation_s, |_| SIGMA_M).learned();
    [own, as_independent].map(|variance| variance * (NOMINAL_M / SIGMA_M).powi(2))
}

/// The variance of a contrast with the weights (−1, 3, −3, 1) / √20, from its definition.
#[test]
fn the_variance_of_a_contrast_follows_from_its_weights() {
    let weights = [-1.0, 3.0, -3.0, 1.0];
    for correlation in [0.0, 0.2, 0.5, 0.9, 1.0] {
        let mut expected = 0.0;
        for (i, first) in weights.iter().enumerate() {
            for (j, second) in weights.iter().enumerate() {
                expected += first * second * f64::powi(correlation, i.abs_diff(j) as i32) / 20.0;
            }
        }
        let found = contrast_variance(correlation);
        assert!((found - expected).abs() < 1e-12, "{correlation}: {found}, {expected}");
    }
}

#[test]
fn correlated_noise_counts_as_independent_noise_that_averages_as_slowly() {
    // At 5 Hz, little distinguishes correlated noise from independent noise.
    for (rate_hz, least) in [(5.0, 0.1), (10.0, 0.5), (12.5, 0.5), (20.0, 0.5)] {
        let [_, independent] = learned_ratios(rate_hz, 1e-3);
        assert!((0.85..1.15).contains(&independent), "{rate_hz} Hz, independent: {independent}");
        let [own, as_independent] = learned_ratios(rate_hz, 0.3);
        let correlation = (-1.0 / (rate_hz * 0.3)).exp();
        let ratio = as_independent * (1.0 - correlation) / (1.0 + correlation);
        assert!((least..1.3).contains(&ratio), "{rate_hz} Hz: {ratio} of r²");
        assert!((0.3..1.3).contains(&own), "{rate_hz} Hz: {own} of σ²");
    }
}

/// The contrasts 0.4 s apart are few, and contain old noise for longer.
#[test]
fn noise_that_falls_is_not_taken_as_correlated() {
    let noise = learned(12.5, 1e-3, |time_s| if time_s < 16.0 { 3.0 * SIGMA_M } else { SIGMA_M });
    assert!(noise.apart.variance() > 2.0 * noise.next.variance());
    assert!(noise.learned().as_independent < 1.05 * noise.next.variance());
}

#[test]
fn the_learned_noise_equals_the_reference() {
    let mut agents = [Measurements::default(); 3];
    let mut positions = PositionNoise::new(PRIOR_COUNT, NOMINAL_M);
    let mut heading = Scale::new(0.12, PRIOR_COUNT, COUNT_MAX);
    let mut correlated_count = 0;
    for (number, line) in include_str!("../../tests/reference/noise.csv").lines().skip(1).enumerate() {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let [agent, time_ms, x, y, heading_rad, ref expected @ ..] = cells[..] else { panic!("{line}") };
        let detection = Detection {
            x_m: x as f32,
            y_m: y as f32,
            heading_rad: heading_rad as f32,
            flags: detection_flags::HAS_HEADING,
            ..Detection::zeroed()
        };
        let found = Found::new(1_000_000 * time_ms as i64, &detection, AgentType::Vehicle);
        let measurements = &mut agents[agent as usize];
        measurements.add(&found, NOMINAL_M, None);
        let contrasts = measurements.take();
        positions.add(&contrasts);
        contrasts.heading_rad.into_iter().for_each(|contrast| heading.add(contrast));
        let Learned { own, as_independent } = positions.learned();
        let scales = [positions.next, positions.apart, positions.next_paired, heading].map(|s| s.variance());
        for (found, expected) in scales.into_iter().chain([own, as_independent]).zip(expected) {
            let off = (found / expected - 1.0).abs();
            assert!(off < 1e-6, "measurement {number}: {found}, expected {expected}");
        }
        correlated_count += usize::from(as_independent > 2.0 * positions.next.variance());
    }
    assert!(correlated_count > 50, "{correlated_count} with correlated noise");
}
