//! The report on trackers.

use metrics::cluster_bootstrap;

use super::{ByClass, CLASSES, Counts, KittiMeasure, class_name};
use crate::forecaster::Provenance;
use crate::page::Page;
use crate::table::{Entry, RESAMPLES, SEED, Table};

/// Minimum number of sequences for an interval.
const SEQUENCES_MIN: usize = 3;

/// Sequences whose figures are reported together.
#[derive(Clone, Debug)]
pub(crate) struct KittiPart {
    /// Range of the sequences' numbers.
    pub(crate) name: String,
    /// One row per contender.
    pub(crate) rows: Vec<KittiRow>,
}

/// The results of one contender on a part.
#[derive(Clone, Debug)]
pub(crate) struct KittiRow {
    /// The contender.
    pub(crate) name: &'static str,
    /// Score thresholds, chosen on the other part. Several if parts are reported together.
    pub(crate) least_scores: ByClass<Vec<f32>>,
    /// Counts of each sequence.
    pub(crate) counts: Vec<ByClass<Counts>>,
    /// Counts of the last contender on exactly the same detections.
    pub(crate) last_on_same: Vec<ByClass<Counts>>,
}

impl KittiPart {
    /// The sequences of both parts, for each contender.
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

/// The summed counts of these sequences, which may contain repetitions.
fn drawn(counts: &[ByClass<Counts>], class: usize, drawn: &[usize]) -> Counts {
    Counts::sum(drawn.iter().map(|&sequence| &counts[sequence][class]))
}

impl KittiRow {
    fn total(&self, class: usize) -> Counts {
        Counts::sum(self.counts.iter().map(|counts| &counts[class]))
    }

    /// The last contender's figure minus this one's. It has an interval if enough sequences contain the
    /// class.
    fn lead_of_last(&self, class: usize, measure: KittiMeasure) -> Option<Entry> {
        let lead = |sequences: &[usize]| {
            let of = |counts| drawn(counts, class, sequences).figure(measure);
            Some(of(&self.last_on_same)? - of(&self.counts)?)
        };
        let len = self.counts.len();
        let with_class_count = self.counts.iter().filter(|counts| counts[class].truths_len() > 0).count();
        if with_class_count < SEQUENCES_MIN {
            return lead(&(0..len).collect::<Vec<_>>())
                .map(|lead| Entry::new(format!("{lead:+.3}"), [("", lead)]));
        }
        Some(Entry::difference(cluster_bootstrap(len, RESAMPLES, SEED, lead)?, 3))
    }
}

/// Reports each part and all parts together, and the weights behind the forecasts of each part.
pub(crate) fn page(mut parts: Vec<KittiPart>, provenance: &[Provenance]) -> Page {
    let all = parts.iter().cloned().reduce(KittiPart::joined);
    parts.extend(all.map(|all| KittiPart { name: "all".to_owned(), ..all }));
    let tables = [figures(&parts), comparisons(&parts)];
    let weights: Vec<String> = provenance.iter().map(|of| format!("* {}", of.line())).collect();
    let closing = format!("Forecasts of the learned prior:\n\n{}", weights.join("\n"));
    Page::of("kitti", "evaluate tracking --parts kitti", &tables)
        .titled("Tracking: KITTI's sequences from a detector's output", &tables, &tables, &closing)
        .with("provenance", provenance)
}

fn figures(parts: &[KittiPart]) -> Table {
    let note = "PointRCNN's detections, KITTI's labels as the reference, both in the world frame, matched within 2 m on the \
                ground: there HOTA's similarity reaches 0, and GOSPA and OSPA (p = 2, mean of the frames) are cut off. \
                Objects that are truncated, occluded to an unknown degree or of a neighbouring class (vans, trucks, \
                sitting people) count neither as misses nor as hits. A track without an object is false unless it \
                lies outside the image, is less than 25 px high or lies in an unlabelled region. The score threshold \
                of the detections is chosen per tracker and class, for the highest MOTA on the other sequences, among \
                the same eight from -1 to 6. Our tracks count from an existence probability of 0.5.";
    let columns = KittiMeasure::ALL.map(KittiMeasure::name).into_iter().chain(["score threshold"]);
    let mut table = Table::new("Trackers", note, &["class", "sequences", "tracker"], columns);
    for (class, agent_type) in CLASSES.into_iter().enumerate() {
        let rows = parts.iter().flat_map(|part| part.rows.iter().map(move |row| (part, row)));
        for (part, row) in rows {
            let total = row.total(class);
            let scores: Vec<String> =
                row.least_scores[class].iter().map(|score| format!("{score:.0}")).collect();
            let figures = KittiMeasure::ALL.map(|measure| measure.entry(&total));
            let figures = figures.into_iter().chain([Some(scores.join(", ").into())]);
            table.push(&[class_name(agent_type), &part.name, row.name], figures);
        }
    }
    table
}

fn comparisons(parts: &[KittiPart]) -> Table {
    let note = format!(
        "Learned prior less the tracker of the row on the same detections, those above that tracker's threshold. In \
         brackets the 95 % interval of a paired bootstrap over sequences, {RESAMPLES} resamples; none where fewer \
         than {SEQUENCES_MIN} sequences contain objects of the class."
    );
    let names = ["class", "sequences", "compared with"];
    let columns = KittiMeasure::COMPARED.map(KittiMeasure::name);
    let mut table = Table::new("Learned prior against the other trackers", &note, &names, columns);
    for (class, agent_type) in CLASSES.into_iter().enumerate() {
        for part in parts {
            for other in part.rows.iter().take(part.rows.len().saturating_sub(1)) {
                let leads = KittiMeasure::COMPARED.map(|measure| other.lead_of_last(class, measure));
                table.push(&[class_name(agent_type), &part.name, other.name], leads);
            }
        }
    }
    table
}
