//! Evaluates trackers on a detector's output from a moving car, against KITTI's labels.
//!
//! 1. A *contender* makes tracks from a recording.
//! 2. It may choose one score threshold per class for its detections. All contenders choose among the same
//!    few thresholds, on sequences outside their evaluation.
//! 3. The tracks of each class are matched with the labels within 2 m on the ground.
//! 4. All measures count the matches ([`Counts`]).

mod counts;
mod nearest;
mod report;
mod sequence;

pub use sequence::{Contender, MakeTracks, Published, PublishedTrack};

use std::path::PathBuf;

use data::Format;
use data::sets::{DataSet, Part};
use metrics::tracking::{Frame, Object};

use crate::error::EvaluateError;
use crate::footage::{Options, SEED};
use crate::forecaster::{EMBEDDED, Model, Provenance};
use crate::lines::{ForecastLines, FrameLine};
use crate::page::Page;
use crate::threads;
use counts::{Counts, GATE_M, KittiMeasure};
use nearest::nearest_neighbours;
use report::{KittiPart, KittiRow, page};
use sequence::{ByClass, CLASSES, LEAST_SCORES, Sequence, class_name};

const SET: DataSet = DataSet::KittiDetections;
/// The parts of the set. Each is evaluated with the thresholds chosen on the other.
const PARTS: [Part; 2] = [Part::Train, Part::Validation];

/// Evaluates trackers on KITTI's sequences, together with a plain nearest-neighbour tracker.
///
/// The last of `contenders` is compared with all others on exactly the same detections. Its forecasts come
/// from the weights of `options`, by default of the recipe `onboard`. The report names these weights.
///
/// # Errors
/// If weights or recordings are missing or of another kind, or if a contender fails.
pub fn kitti(
    options: &Options,
    contenders: Vec<Contender<'_>>,
    mut progress: impl FnMut(&str),
) -> Result<Page, EvaluateError> {
    let plain = Contender {
        name: "nearest neighbours",
        track: Box::new(|recording| Ok(nearest_neighbours(recording))),
    };
    let contenders: Vec<Contender<'_>> = std::iter::once(plain).chain(contenders).collect();
    let mut parts = Vec::new();
    for part in PARTS {
        parts.push(PartEvaluation::open(options, part)?);
    }
    for contender in &contenders {
        progress(&format!("KITTI: {}", contender.name));
        let mut choices = Vec::new();
        for part in &parts {
            choices.push(part.choose(contender, options.threads)?);
        }
        // Each part gets the thresholds chosen on the other part.
        for (part, least_scores) in parts.iter_mut().zip(choices.into_iter().rev()) {
            let counts = part.evaluate(contender, least_scores, options.threads, options.lines.as_deref())?;
            let last = contenders.last().filter(|last| last.name != contender.name);
            let last =
                last.map(|last| part.evaluate(last, least_scores, options.threads, None)).transpose()?;
            let least_scores = least_scores.map(|score| vec![score]);
            let last_on_same = last.unwrap_or_else(|| counts.clone());
            part.part.rows.push(KittiRow { name: contender.name, least_scores, counts, last_on_same });
        }
    }
    let model = options.weights.open(EMBEDDED, SEED)?;
    let mut provenance = Vec::new();
    for part in &parts {
        provenance.push(part.provenance(&model)?);
    }
    Ok(page(parts.into_iter().map(|part| part.part).collect(), &provenance))
}

/// A part of the set and its results so far.
struct PartEvaluation {
    part: KittiPart,
    paths: Vec<PathBuf>,
    sequences: Vec<Sequence>,
}

impl PartEvaluation {
    fn open(options: &Options, part: Part) -> Result<Self, EvaluateError> {
        let paths = SET.files(&options.data, part)?;
        let sequences = paths.iter().map(|path| Sequence::open(path)).collect::<Result<_, _>>()?;
        let number = |path: Option<&PathBuf>| {
            path.and_then(|path| path.file_stem())
                .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
        };
        let name = format!("{} to {}", number(paths.first()), number(paths.last()));
        Ok(Self { part: KittiPart { name, rows: Vec::new() }, paths, sequences })
    }

    /// The score thresholds with a contender's greatest MOTA on this part, by class; on a tie, the lowest.
    fn choose(&self, contender: &Contender<'_>, threads: usize) -> Result<ByClass<f32>, EvaluateError> {
        let mut best = [(f64::NEG_INFINITY, LEAST_SCORES[0]); CLASSES.len()];
        for least_score in LEAST_SCORES {
            let counts = self.evaluate(contender, [least_score; CLASSES.len()], threads, None)?;
            for (class, best) in best.iter_mut().enumerate() {
                let total = Counts::sum(counts.iter().map(|counts| &counts[class]));
                let mota = total.figure(KittiMeasure::Mota).unwrap_or(f64::NEG_INFINITY);
                if mota > best.0 {
                    *best = (mota, least_score);
                }
            }
        }
        Ok(best.map(|(_, least_score)| least_score))
    }

    /// The counts of each sequence. Writes what counts in each frame, if there are lines.
    fn evaluate(
        &self,
        contender: &Contender<'_>,
        least_scores: ByClass<f32>,
        threads: usize,
        lines: Option<&ForecastLines>,
    ) -> Result<Vec<ByClass<Counts>>, EvaluateError> {
        let evaluate = |sequence: &Sequence, (): &mut ()| sequence.evaluate(contender, least_scores);
        let mut counts = Vec::with_capacity(self.sequences.len());
        let evaluated = threads::each(&self.sequences, threads, evaluate);
        for (sequence, evaluated) in self.sequences.iter().zip(evaluated) {
            let evaluated = evaluated?;
            for ((_, frames), class) in evaluated.iter().zip(CLASSES).filter(|_| lines.is_some()) {
                let objects =
                    |of: &[Object]| of.iter().map(|of| (of.id, of.position_m[0], of.position_m[1])).collect();
                let line = |(frame, of): (usize, &Frame)| FrameLine {
                    part: &self.part.name,
                    recording: sequence.name(),
                    frame,
                    class: class_name(class),
                    tracker: contender.name,
                    truths: objects(of.truths()),
                    tracks: objects(of.tracks()),
                };
                frames
                    .iter()
                    .enumerate()
                    .map(line)
                    .for_each(|line| lines.iter().for_each(|to| to.add(&line)));
            }
            counts.push(evaluated.map(|(counts, _)| counts));
        }
        Ok(counts)
    }

    /// Provenance with the number of sequences that the weights' training used. Training reads their labels,
    /// not the detectors' output.
    fn provenance(&self, model: &Model) -> Result<Provenance, EvaluateError> {
        let labels = |path: &PathBuf| {
            let root = path.ancestors().nth(3).unwrap_or(path);
            data::open(
                &root.join("label").join(path.file_name().unwrap_or_default()),
                Some(Format::KittiLabels),
            )
        };
        let labels = self.paths.iter().map(labels).collect::<Result<Vec<_>, _>>()?;
        Ok(model.provenance(&self.part.name, "online", &labels.iter().collect::<Vec<_>>()))
    }
}
