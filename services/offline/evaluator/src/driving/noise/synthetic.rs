//! Forecasts and tracks of generated agents under noise.
//!
//! The true motion is a formula, so a forecast's error comes from the noise alone. The best possible forecast
//! of a straight motion is known, too: a line through the last positions.

use std::collections::BTreeMap;

use nn::ModelConfig;
use onboard::Chain;
use scene::AgentType;

use super::motion::{AGENTS, Motion, Scene};
use crate::driving::source::run;
use crate::error::EvaluateError;
use crate::footage::Options;
use crate::noise::Noise;
use crate::page::Page;
use crate::playback::Playing;
use crate::table::{Entry, Table};
use crate::threads;

/// Played time of a scene.
const PLAYED_S: f64 = 12.0;
/// Forecasts before this time do not count, because the tracks are young.
const FROM_S: f64 = 4.0;
/// Time over which the reference fits a line.
const LINE_S: f64 = 2.0;
/// Time constant of noise that lasts.
const LAG_S: f64 = 0.3;
/// Published speed from which a parked vehicle counts as moving.
const PARKED_MPS: f32 = 0.3;
/// Time for which a manoeuvre must be published without a break.
const STAYS_S: f64 = 0.5;
/// The delay of a manoeuvre that is not published.
const DELAY_MAX_S: f64 = 4.0;
/// Types and their speeds, m/s, and the number of [`SENSORS`] that see them.
const STRAIGHT: [(AgentType, f64, usize); 3] =
    [(AgentType::Vehicle, 9.0, 9), (AgentType::Cyclist, 4.5, 5), (AgentType::Pedestrian, 1.3, 5)];
/// Rate of the measurements, noise and its time constant.
const SENSORS: [(u32, f64, f64); 9] = [
    (10, 0.0, 0.0),
    (10, 0.12, 0.0),
    (10, 0.3, 0.0),
    (10, 0.12, LAG_S),
    (10, 0.3, LAG_S),
    (2, 0.12, 0.0),
    (2, 0.3, 0.0),
    (5, 0.3, 0.0),
    (20, 0.3, 0.0),
];
/// Noise of the parked vehicle, and its time constant.
const PARKED: [(f64, f64); 4] = [(0.12, 0.0), (0.3, 0.0), (0.12, LAG_S), (0.3, LAG_S)];
/// Manoeuvres with their names and speeds before, m/s.
const MANOEUVRES: [(Motion, &str, f64); 3] =
    [(Motion::Turn, "turn", 8.0), (Motion::Braking, "braking", 8.0), (Motion::Starting, "start", 0.0)];
/// Noise of the manoeuvres.
const MANOEUVRES_M: [f64; 3] = [0.0, 0.12, 0.3];
/// What the detections report besides positions.
const REPORTS: [&str; 3] = ["ids", "ids, sigma", "no ids"];

/// One scene with its noise.
#[derive(Clone, Copy, Debug)]
struct Job {
    scene: Scene,
    noise: Noise,
}

/// What a played scene shows.
#[derive(Clone, Debug, Default)]
struct Played {
    /// Errors of the single best forecasts at the horizon, m.
    fde_m: Vec<f64>,
    /// Published velocities by agent, from the start of its track on, by time in s.
    velocities_mps: BTreeMap<u64, Vec<(f64, [f32; 2])>>,
}

/// Plays all generated scenes. Takes about 80 s of computing.
///
/// # Errors
/// [`EvaluateError`] if the weights can't be used.
pub fn synthetic(options: &Options) -> Result<Page, EvaluateError> {
    let weights = options.weights.load()?;
    let model = weights.config();
    let horizon_s = model.horizon_len as f64 * model.dt_s;
    let straight = STRAIGHT.into_iter().flat_map(|(agent_type, speed_mps, sensors)| {
        SENSORS[..sensors].iter().map(move |&(rate_hz, sigma_m, lag_s)| {
            let scene = Scene { agent_type, motion: Motion::Straight, speed_mps, rate_hz };
            (scene, sigma_m, lag_s)
        })
    });
    let vehicle =
        |motion, speed_mps| Scene { agent_type: AgentType::Vehicle, motion, speed_mps, rate_hz: 10 };
    let parked = PARKED.map(|(sigma_m, lag_s)| (vehicle(Motion::Straight, 0.0), sigma_m, lag_s));
    let manoeuvres = MANOEUVRES.into_iter().flat_map(|(motion, _, speed_mps)| {
        MANOEUVRES_M.into_iter().map(move |sigma_m| (vehicle(motion, speed_mps), sigma_m, 0.0))
    });
    let rows: Vec<(Scene, f64, f64)> = straight.chain(parked).chain(manoeuvres).collect();
    let jobs: Vec<Job> =
        rows.iter().flat_map(|&(scene, sigma_m, lag_s)| reports(scene, sigma_m, lag_s)).collect();
    let played = threads::each(&jobs, options.threads, |job, _: &mut ()| job.play(options, model));
    let played = played.into_iter().collect::<Result<Vec<_>, _>>()?;

    let mut tables = [straight_table(horizon_s), parked_table(), manoeuvre_table()];
    for (&(scene, sigma_m, lag_s), played) in rows.iter().zip(played.chunks(REPORTS.len())) {
        let noise = if lag_s > 0.0 { format!("{sigma_m} m, lag {lag_s} s") } else { format!("{sigma_m} m") };
        let manoeuvre = MANOEUVRES.iter().find(|(motion, ..)| *motion == scene.motion);
        let (table, names, values): (usize, Vec<String>, Vec<Option<f64>>) =
            if let Some((_, name, _)) = manoeuvre {
                let delays = played.iter().map(|played| Some(mean_delay_s(&scene, played)));
                (2, vec![(*name).to_owned(), noise], delays.collect())
            } else if scene.speed_mps == 0.0 {
                (1, vec![noise], played.iter().map(share_moving).collect())
            } else {
                let errors = played.iter().map(|played| mean(&played.fde_m));
                let line = mean(&line_errors_m(&scene, sigma_m, lag_s, horizon_s));
                let names = vec![scene.agent_type.name().to_owned(), format!("{} Hz", scene.rate_hz), noise];
                (0, names, errors.chain([line]).collect())
            };
        tables[table].push(&names, values.into_iter().map(|value| value.map(Entry::digits)));
    }
    Ok(Page::of("synthetic", "evaluate noise --parts synthetic", &tables))
}

/// The same scene with each kind of report.
fn reports(scene: Scene, sigma_m: f64, lag_s: f64) -> [Job; REPORTS.len()] {
    let ids = Noise { sigma_m, lag_s, positions_only: true, seed: 1, ..Noise::default() };
    [ids, Noise { reports_sigma: true, ..ids }, Noise { without_ids: true, ..ids }]
        .map(|noise| Job { scene, noise })
}

fn straight_table(horizon_s: f64) -> Table {
    let note = format!(
        "FDE in m after {horizon_s:.1} s of the published single best forecast. {AGENTS} agents per row drive straight on \
         for {PLAYED_S} s (vehicles 9 m/s, cyclists 4.5 m/s, pedestrians 1.3 m/s). Forecasts count from {FROM_S} s on. \
         Detections contain positions and sizes. *Line* is a least-squares line through the last {LINE_S} s of the \
         noisy positions. At 20 Hz a frame of 10 Hz contains two measurements of each agent."
    );
    Table::new(
        "Generated agents, straight on",
        &note,
        &["type", "rate", "noise"],
        REPORTS.into_iter().chain(["line"]),
    )
}

fn parked_table() -> Table {
    let note = format!(
        "Share of ticks, from {FROM_S} s on, in which the published speed of a parked vehicle is above {PARKED_MPS} m/s. \
         Detections contain positions and sizes at 10 Hz."
    );
    Table::new("Parked vehicles", &note, &["noise"], REPORTS)
}

fn manoeuvre_table() -> Table {
    let note = format!(
        "Time in s from the middle of a manoeuvre until the published velocity is past this middle for {STAYS_S} s, mean \
         of {AGENTS} vehicles at 8 m/s (before the start: 0) and 10 Hz. The turn takes 3 s for 90 degrees. The braking \
         takes 1 s for 3 m/s, the start 1.5 s for 3 m/s. A manoeuvre that is not published counts as {DELAY_MAX_S} s. A negative delay means that noise crossed the \
         middle before the vehicle did."
    );
    Table::new("Delay of manoeuvres", &note, &["manoeuvre", "noise"], REPORTS)
}

impl Job {
    /// Plays the scene through the pipeline.
    fn play(&self, options: &Options, model: &ModelConfig) -> Result<Played, EvaluateError> {
        let horizon_s = model.horizon_len as f64 * model.dt_s;
        let chain =
            |interval_ns| Ok::<_, EvaluateError>(Chain::new(&run(interval_ns, options, None)?, model)?);
        let mut playing = Playing::new(&self.scene.recording("generated", PLAYED_S), &self.noise, chain)?;
        let mut played = Played::default();
        while let Some(tick) = playing.next() {
            let time_s = tick.header.stamp_ns as f64 * 1e-9;
            for (forecast, track) in tick.followed() {
                let velocity_mps = [forecast.vx_mps, forecast.vy_mps];
                played.velocities_mps.entry(track.id).or_default().push((time_s, velocity_mps));
                if time_s >= FROM_S {
                    let end = self.scene.state(track.id, time_s + horizon_s).position_m;
                    played.fde_m.push(apart_m(forecast.best[model.horizon_len - 1].map(f64::from), end));
                }
            }
        }
        Ok(played)
    }
}

fn apart_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Share of the ticks of parked agents with a published speed.
fn share_moving(played: &Played) -> Option<f64> {
    let counting = played.velocities_mps.values().flatten().filter(|(time_s, _)| *time_s >= FROM_S);
    let moving = counting.map(|(_, [vx, vy])| f64::from(u8::from(vx.hypot(*vy) > PARKED_MPS)));
    mean(&moving.collect::<Vec<_>>())
}

/// Mean delay of the manoeuvre over all agents.
fn mean_delay_s(scene: &Scene, played: &Played) -> f64 {
    let none = Vec::new();
    let delays = (1..=AGENTS).map(|agent| {
        delay_s(scene, agent, played.velocities_mps.get(&agent).unwrap_or(&none)).min(DELAY_MAX_S)
    });
    delays.sum::<f64>() / AGENTS as f64
}

/// Time from the middle of the agent's manoeuvre to the first tick from which on its published velocity is past
/// the middle for [`STAYS_S`]; infinite if there is none. Ticks before the first settled second do not count.
fn delay_s(scene: &Scene, agent: u64, velocities_mps: &[(f64, [f32; 2])]) -> f64 {
    let half_s = scene.half_s(agent);
    let is_past = |velocity_mps: [f32; 2]| scene.is_past_half(agent, velocity_mps);
    let counting = velocities_mps.iter().filter(|(time_s, _)| *time_s >= FROM_S);
    let mut since_s: Option<f64> = None;
    for &(time_s, velocity_mps) in counting {
        match (is_past(velocity_mps), since_s) {
            (false, _) => since_s = None,
            (true, None) => since_s = Some(time_s),
            (true, Some(from_s)) if time_s - from_s >= STAYS_S => return from_s - half_s,
            (true, Some(_)) => {}
        }
    }
    f64::INFINITY
}

/// Errors of lines through the last positions of each agent, for the same agents, times and noise.
fn line_errors_m(scene: &Scene, sigma_m: f64, lag_s: f64, horizon_s: f64) -> Vec<f64> {
    let [Job { noise, .. }, ..] = reports(*scene, sigma_m, lag_s);
    let noisy = noise.applied_to(&scene.recording("generated", PLAYED_S));
    let mut errors_m = Vec::new();
    let mut positions: BTreeMap<u64, Vec<(f64, [f64; 2])>> = BTreeMap::new();
    for frame in &noisy.frames {
        let now_s = frame.stamp_ns as f64 * 1e-9;
        for detection in &frame.detections {
            let measured_s = (frame.stamp_ns + detection.offset_ns) as f64 * 1e-9;
            let position_m = [detection.x_m, detection.y_m].map(f64::from);
            positions.entry(detection.id).or_default().push((measured_s, position_m));
        }
        for (&agent, positions) in &mut positions {
            positions.retain(|(time_s, _)| *time_s > now_s - LINE_S - 1e-6);
            if now_s >= FROM_S {
                let end_s = now_s + horizon_s;
                errors_m.push(apart_m(line_at(positions, end_s), scene.state(agent, end_s).position_m));
            }
        }
    }
    errors_m
}

/// The least-squares line through positions, at a time.
fn line_at(positions: &[(f64, [f64; 2])], time_s: f64) -> [f64; 2] {
    let len = positions.len() as f64;
    let middle_s = positions.iter().map(|(at_s, _)| at_s).sum::<f64>() / len;
    let spread = positions.iter().map(|(at_s, _)| (at_s - middle_s).powi(2)).sum::<f64>();
    [0, 1].map(|axis| {
        let mean_m = positions.iter().map(|(_, position_m)| position_m[axis]).sum::<f64>() / len;
        let slope =
            positions.iter().map(|(at_s, position_m)| (at_s - middle_s) * position_m[axis]).sum::<f64>();
        mean_m + (time_s - middle_s) * slope / spread.max(1e-9)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN: Scene =
        Scene { agent_type: AgentType::Vehicle, motion: Motion::Turn, speed_mps: 8.0, rate_hz: 10 };

    #[test]
    fn a_line_continues_a_straight_motion_and_averages_noise() {
        let straight = [(0.0, [1.0, 2.0]), (1.0, [3.0, 1.0]), (2.0, [5.0, 0.0])];
        assert!(apart_m(line_at(&straight, 4.0), [9.0, -2.0]) < 1e-9);
        let scene = Scene { motion: Motion::Straight, ..TURN };
        let errors = |sigma_m: f64| mean(&line_errors_m(&scene, sigma_m, 0.0, 4.8)).unwrap();
        assert!(errors(0.0) < 0.01, "{}", errors(0.0));
        // Twenty-one positions with 0.1 m each: σ_end = 0.1 m √(1/21 + 5.8² / 7.7), and the mean of a Rayleigh
        // distribution.
        let expected = 0.1 * (1.0_f64 / 21.0 + 5.8 * 5.8 / 7.7).sqrt() * (std::f64::consts::FRAC_PI_2).sqrt();
        assert!((errors(0.1) / expected - 1.0).abs() < 0.15, "{} for {expected}", errors(0.1));
    }

    #[test]
    fn a_delay_is_counted_from_the_middle_and_needs_to_last() {
        let half_s = TURN.half_s(1);
        let published = |delay_s: f64, blip_s: f64| -> Vec<(f64, [f32; 2])> {
            (0..150)
                .map(|tick| {
                    let time_s = f64::from(tick) * 0.1;
                    let is_blip = (time_s - blip_s).abs() < 0.15;
                    let seen_s = if is_blip { 11.0 } else { time_s - delay_s };
                    let heading_rad = TURN.state(1, seen_s).heading_rad;
                    (time_s, [8.0 * heading_rad.cos() as f32, 8.0 * heading_rad.sin() as f32])
                })
                .collect()
        };
        for expected_s in [0.0, 0.4, 1.1] {
            for blip_s in [-1.0, 4.5] {
                let found_s = delay_s(&TURN, 1, &published(expected_s, blip_s));
                assert!((0.0..0.1).contains(&(found_s - expected_s)), "{found_s} s for {expected_s} s");
            }
        }
        assert!(delay_s(&TURN, 1, &published(0.0, -1.0)[..=(half_s * 10.0) as usize]).is_infinite());
    }

    #[test]
    fn reports_differ_in_what_detections_contain_and_share_their_noise() {
        let [ids, sigma, no_ids] = reports(TURN, 0.3, 0.0).map(|job| job.noise);
        assert!(!ids.reports_sigma && sigma.reports_sigma && no_ids.without_ids && !ids.without_ids);
        let positions = |noise: Noise| -> Vec<f32> {
            let seen = noise.applied_to(&TURN.recording("generated", 1.0));
            seen.frames.iter().flat_map(|frame| frame.detections.iter().map(|of| of.x_m)).collect()
        };
        assert_eq!(positions(ids), positions(sigma));
        assert_eq!(positions(ids), positions(no_ids));
    }
}
