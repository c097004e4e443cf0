//! What is told of the trackers.

use metrics::{Interval, cluster_bootstrap};

use super::{ByClass, CLASSES, Counts, KittiMeasure, class_name};
use evaluator::{Provenance, RESAMPLES, Table};

/// Of the bootstrap.
const SEED: u64 = 1;
/// Fewer sequences say nothing of what others would give.
const SEQUENCES_MIN: usize = 3;

/// What a judgement of trackers found.
#[derive(Clone, Debug)]
pub struct KittiReport {
    /// Of the weights behind the forecasts, part by part.
    provenance: Vec<Provenance>,
    parts: Vec<KittiPart>,
}

/// Sequences whose figures are told together.
#[derive(Clone, Debug)]
pub(crate) struct KittiPart {
    /// Which they are.
    pub(crate) name: String,
    /// One per contender.
    pub(crate) rows: Vec<KittiRow>,
}

/// What one contender made of a part.
#[derive(Clone, Debug)]
pub(crate) struct KittiRow {
    /// The contender.
    pub(crate) name: &'static str,
    /// Chosen elsewhere; several where parts are told together.
    pub(crate) least_scores: ByClass<Vec<f32>>,
    /// Sequence by sequence.
    pub(crate) counts: Vec<ByClass<Counts>>,
    /// What the last contender makes of the very same detections.
    pub(crate) last_on_same: Vec<ByClass<Counts>>,
}

impl KittiPart {
    /// The sequences of both, contender by contender.
    fn joined(mut self, other: Self) -> Self {
        for (row, more) in self.rows.iter_mut().zip(other.rows) {
            row.counts.extend(more.counts);
            row.last_on_same.extend(more.last_on_same);
            for (scores, more) in row.least_scores.iter_mut().zip(more.least_scores) {
                scores.extend(more);
            }
        }
        self
    }
}

/// Of the sequences with these numbers, as often as they stand there.
fn drawn(counts: &[ByClass<Counts>], class: usize, drawn: &[usize]) -> Counts {
    Counts::sum(drawn.iter().map(|&sequence| &counts[sequence][class]))
}

impl KittiRow {
    fn total(&self, class: usize) -> Counts {
        Counts::sum(self.counts.iter().map(|counts| &counts[class]))
    }

    /// What the last contender has more than this one, with its interval where enough sequences have objects of the class.
    fn lead_of_last(&self, class: usize, measure: KittiMeasure) -> Option<String> {
        let lead = |sequences: &[usize]| {
            let of = |counts| drawn(counts, class, sequences).figure(measure);
            Some(of(&self.last_on_same)? - of(&self.counts)?)
        };
        let len = self.counts.len();
        let told_len = self.counts.iter().filter(|counts| counts[class].truths_len() > 0).count();
        if told_len < SEQUENCES_MIN {
            return lead(&(0..len).collect::<Vec<_>>()).map(|figure| format!("{figure:+.3}"));
        }
        let Interval { low, mean, high } = cluster_bootstrap(len, RESAMPLES, SEED, lead)?;
        Some(format!("{mean:+.3} [{low:+.3}, {high:+.3}]"))
    }
}

impl KittiReport {
    /// Tells the parts one by one and all together.
    pub(crate) fn new(mut parts: Vec<KittiPart>, provenance: Vec<Provenance>) -> Self {
        let all = parts.iter().cloned().reduce(KittiPart::joined);
        parts.extend(all.map(|all| KittiPart { name: "all".to_owned(), ..all }));
        Self { provenance, parts }
    }

    /// The report as Markdown that also reads well in a terminal.
    #[must_use]
    pub fn markdown(&self) -> String {
        self.written("##")
    }

    /// The same, one heading lower.
    #[must_use]
    pub fn summary(&self) -> String {
        self.written("###")
    }

    fn written(&self, heading: &str) -> String {
        let mut text = format!("{heading} Tracking: KITTI's sequences from a detector's output\n\n");
        for table in [self.figures(), self.comparisons()] {
            text += &format!("{heading}{}\n", table.markdown(""));
        }
        text += "Forecasts of the learned prior:\n\n";
        self.provenance.iter().fold(text, |text, provenance| text + &format!("* {}\n", provenance.line()))
    }

    fn figures(&self) -> Table {
        let note = "Detections of PointRCNN, labels as the truth, both in the world frame; matched within 2 m on the ground, which is also \
                    where HOTA's similarity ends and GOSPA and OSPA (p = 2, mean of the frames) cut off. Objects that are truncated, occluded to an \
                    unknown degree or of a neighbouring class (vans, trucks, people who sit) may be found or missed; a track with no object is \
                    false unless its place is out of the image, under 25 px high or in a region without labels. The least score of the \
                    detections is each contender's own choice per class, by MOTA on the other sequences, of the same eight from -1 to 6. Of ours those tracks \
                    count which the tracker takes for more probable than not.";
        let columns = KittiMeasure::ALL.map(KittiMeasure::name).into_iter().chain(["least score"]);
        let mut table =
            Table::new("Trackers", note, &["class", "sequences", "tracker"], columns.map(str::to_owned));
        for (class, agent_type) in CLASSES.into_iter().enumerate() {
            for (part, row) in self.rows() {
                let total = row.total(class);
                let names = [class_name(agent_type), &part.name, row.name].map(str::to_owned);
                let figure = |measure: KittiMeasure| total.figure(measure).map(|figure| measure.text(figure));
                let cells =
                    KittiMeasure::ALL.map(|measure| figure(measure).unwrap_or_else(|| "-".to_owned()));
                let chosen = [scores(row, class, ", ")];
                table.push_row(names.into_iter().chain(cells).chain(chosen).collect());
            }
        }
        table
    }

    fn rows(&self) -> impl Iterator<Item = (&KittiPart, &KittiRow)> {
        self.parts.iter().flat_map(|part| part.rows.iter().map(move |row| (part, row)))
    }

    fn comparisons(&self) -> Table {
        let note = format!(
            "What the tracker with the learned prior has more than the other on the very same detections, those of the other's least \
             score; in brackets the paired bootstrap's 95 % interval, \
             {RESAMPLES} resamples of whole sequences; none where fewer than {SEQUENCES_MIN} have objects of the class."
        );
        let columns = KittiMeasure::COMPARED.map(|measure| measure.name().to_owned()).into_iter();
        let mut table = Table::new(
            "Learned prior beside the others",
            &note,
            &["class", "sequences", "less that of"],
            columns,
        );
        for (class, agent_type) in CLASSES.into_iter().enumerate() {
            for part in &self.parts {
                for other in part.rows.iter().take(part.rows.len().saturating_sub(1)) {
                    let names = [class_name(agent_type), &part.name, other.name].map(str::to_owned);
                    let cell = |measure| other.lead_of_last(class, measure);
                    let cells =
                        KittiMeasure::COMPARED.map(|measure| cell(measure).unwrap_or_else(|| "-".to_owned()));
                    table.push_row(names.into_iter().chain(cells).collect());
                }
            }
        }
        table
    }

    /// Every figure, a line each, in the columns of [`crate::COLUMNS`].
    #[must_use]
    pub fn csv(&self) -> String {
        let sha256 = self.provenance.first().map_or("", |provenance| &provenance.sha256);
        let line = |told: KittiValue<'_>| {
            let KittiValue { sequences, class, tracker, least_scores, truths_len, measure, value } = told;
            format!(
                "kitti,,,{sequences},{least_scores},{class},\"{tracker}\",tracks,\"{measure}\",{value:.6},{truths_len},{sha256}\n"
            )
        };
        self.values().map(line).collect()
    }

    /// Every figure: sequences, class, contender, measure, value.
    fn values(&self) -> impl Iterator<Item = KittiValue<'_>> {
        self.rows().flat_map(|(part, row)| {
            CLASSES.into_iter().enumerate().flat_map(move |(class, agent_type)| {
                let total = row.total(class);
                KittiMeasure::ALL.into_iter().filter_map(move |measure| {
                    Some(KittiValue {
                        sequences: &part.name,
                        class: class_name(agent_type),
                        tracker: row.name,
                        least_scores: scores(row, class, ";"),
                        truths_len: total.truths_len(),
                        measure: measure.name(),
                        value: total.figure(measure)?,
                    })
                })
            })
        })
    }

    /// Everything as JSON.
    #[must_use]
    pub fn json(&self) -> serde_json::Value {
        serde_json::json!({ "provenance": self.provenance, "figures": self.values().collect::<Vec<_>>() })
    }
}

/// A figure with what it is of.
#[derive(Clone, Debug, serde::Serialize)]
struct KittiValue<'a> {
    sequences: &'a str,
    class: &'static str,
    tracker: &'static str,
    least_scores: String,
    truths_len: u64,
    measure: &'static str,
    value: f64,
}

/// The scores that were chosen for a class, part by part.
fn scores(row: &KittiRow, class: usize, separator: &str) -> String {
    let scores: Vec<String> = row.least_scores[class].iter().map(|score| format!("{score:.0}")).collect();
    scores.join(separator)
}
