//! Compute per stage, with all stages in one process on generated scenes.

use std::path::Path;
use std::time::Instant;

use configuration::options::{Setting, StageOptions};
use console::failure::Failure;
use console::tables;
use data::{GeneratedScene, SceneOptions};
use nn::{ContextCnn, Weights};
use onboard::Chain;
use run::Run;
use source::{Playback, PlaybackOptions};
use wire::StageId;

use super::arguments::Arguments;
use super::percentile::percentile;
use super::work::Work;
use crate::prediction::SHARED;

/// Numbers of agents if none are given.
const AGENTS: [u16; 4] = [1, 16, 64, 128];
/// Ticks before the measurement. They exceed the history, so caches are as in a steady run.
const WARM_UP: u64 = 60;
/// The compute stages.
const STAGES: [StageId; 6] = [
    StageId::Tracker,
    StageId::Localiser,
    StageId::Extractor,
    StageId::Encoder,
    StageId::Decoder,
    StageId::Sampler,
];

/// Times and work of the measured ticks of a scene.
pub(super) struct Measured {
    /// Mean number of forecast agents.
    pub agents: f64,
    /// Milliseconds per tick, for each of [`STAGES`].
    times_ms: [Vec<f64>; 6],
    /// Multiply-adds of all ticks, for each of [`STAGES`] whose model reports them.
    multiply_adds: [Option<f64>; 6],
}

impl Measured {
    /// Returns the milliseconds of each tick, summed over the stages.
    pub(super) fn ticks_ms(&self) -> Vec<f64> {
        let len = self.times_ms.iter().map(Vec::len).min().unwrap_or(0);
        (0..len).map(|tick| self.times_ms.iter().map(|times| times[tick]).sum()).collect()
    }
}

/// Formats one row per number of agents and stage.
pub(super) fn table(arguments: &Arguments, peak_gflops: f64) -> Result<String, Failure> {
    let columns = ["agents:", "stage", "compute p50 ms:", "p99 ms:", "GFLOP/s:", "of the matrix product:"];
    let mut text = tables::head(&columns);
    for &agents in arguments.agents.as_deref().unwrap_or(&AGENTS) {
        let mut measured = measure(arguments, usize::from(agents), None)?;
        let mut total_ms = 0.0;
        for (stage, id) in STAGES.iter().enumerate() {
            let seconds: f64 = measured.times_ms[stage].iter().sum::<f64>() * 1e-3;
            let rate = measured.multiply_adds[stage].map(|madds| 2.0 * madds / seconds * 1e-9);
            let rate = rate.map_or(" | ".to_owned(), |r| format!("{r:.1} | {:.2}", r / peak_gflops));
            let times_ms = &mut measured.times_ms[stage];
            let (p50, p99) = (percentile(times_ms, 0.5), percentile(times_ms, 0.99));
            total_ms += p50;
            text += &format!("| {:.1} | {} | {p50:.3} | {p99:.3} | {rate} |\n", measured.agents, id.name());
        }
        text += &format!("| {:.1} | **all** | **{total_ms:.3}** | | | |\n", measured.agents);
    }
    text += &cnn(arguments, peak_gflops)?;
    Ok(text + "\n")
}

/// Measures the context CNN alone, with 64 patches.
fn cnn(arguments: &Arguments, peak_gflops: f64) -> Result<String, Failure> {
    const PATCHES: usize = 64;
    let (_, weights) = arguments.model.open_weights(None)?;
    let cnn = ContextCnn::new(&weights).map_err(Failure::data)?;
    let patches: Vec<f32> = (0..PATCHES * cnn.patch_len()).map(|i| ((i * 37) % 101) as f32 * 0.01).collect();
    let mut out = vec![[0.0; wire::CONTEXT_EMBEDDING]; PATCHES];
    let mut memory = nn::ContextMemory::default();
    let mut times_ms = Vec::new();
    for _ in 0..arguments.ticks {
        let start = Instant::now();
        cnn.embed(&patches, &mut memory, &mut out);
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    let (p50, p99) = (percentile(&mut times_ms, 0.5), percentile(&mut times_ms, 0.99));
    let rate = 2.0 * (PATCHES * cnn.multiply_adds()) as f64 / p50 * 1e-6;
    let share = rate / peak_gflops;
    Ok(format!("| | CNN, {PATCHES} patches | {p50:.3} | {p99:.3} | {rate:.1} | {share:.2} |\n"))
}

/// Measures all stages on a generated scene, with `weights` or else the weights of the arguments.
pub(super) fn measure(
    arguments: &Arguments,
    agents: usize,
    file: Option<&Path>,
) -> Result<Measured, Failure> {
    let scene = GeneratedScene::new(SceneOptions::complete(agents)).map_err(Failure::data)?;
    let ticks = WARM_UP + arguments.ticks;
    let recording = scene.recording(usize::try_from(ticks).map_err(Failure::data)?);
    let mut playback = Playback::new(recording, PlaybackOptions { lockstep: true, ..Default::default() });
    let (weights, opened) = match file {
        Some(path) => {
            (Some(path.to_owned()), Weights::open(path).map_err(|error| Failure::weights(path, error))?)
        }
        None => arguments.model.open_weights(None)?,
    };
    let mut options = StageOptions::defaults(&STAGES);
    let workers = |stage| Setting::of_flag("bench", stage, "workers", 1);
    let one_thread = SHARED.map(workers).to_vec();
    options.apply(&[one_thread, arguments.model.settings()?, arguments.set.set.clone()].concat())?;
    let run = Run {
        interval_ns: playback.interval_ns(),
        lockstep: true,
        weights,
        stages: options.stage_runs(),
        ..Run::default()
    };
    let work = Work::of(&opened)?;
    let mut chain = Chain::new(&run, opened.config())?;
    drop(opened);
    let mut measured = Measured {
        agents: 0.0,
        times_ms: std::array::from_fn(|_| Vec::with_capacity(ticks as usize)),
        multiply_adds: [None; 6],
    };
    while let Some(tick) = playback.next_tick() {
        let counted = tick.header.seq >= WARM_UP;
        let mut last = Instant::now();
        let passed = |id: StageId| {
            let now = Instant::now();
            let stage = STAGES.iter().position(|stage| *stage == id);
            if let Some(stage) = stage.filter(|_| counted) {
                measured.times_ms[stage].push((now - last).as_secs_f64() * 1e3);
            }
            last = now;
        };
        let agents_len = chain.tick(&tick.header, tick.detections, passed).1.len();
        if counted {
            measured.agents += agents_len as f64 / arguments.ticks as f64;
            for (sum, done) in measured.multiply_adds.iter_mut().zip(work.tick(&chain.load())) {
                *sum = done.map(|done| sum.unwrap_or(0.0) + done);
            }
        }
    }
    Ok(measured)
}
