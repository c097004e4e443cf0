//! Results of an ablation: variants of a model on the same agents, each compared with the first.

use metrics::Interval;

use crate::group::{Contrast, Group, RESAMPLES};
use crate::report::{Table, digits, percent};
use crate::{Errors, Measure, Method};

/// The measures that variants are compared by.
const COMPARED: [Measure; 2] = [Measure::BestOf, Measure::Single];

/// Variants of a model, evaluated on the same agents. The others are compared with the first.
#[derive(Clone, Debug)]
pub struct Ablation {
    /// Which agents, of which recordings.
    pub about: String,
    /// The variants.
    pub rows: Vec<AblationRow>,
}

/// A variant with its errors.
#[derive(Clone, Debug)]
pub struct AblationRow {
    /// What it is called.
    pub name: String,
    /// Fingerprint of its weights.
    pub sha256: String,
    /// Its errors.
    pub errors: Group,
}

/// What a comparison of two variants shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Larger errors than the first variant's.
    Worse,
    /// Smaller errors.
    Better,
    /// ADE is worse and FDE better, or the reverse.
    Mixed,
    /// Neither interval excludes 0.
    NoDifference,
}

impl Verdict {
    /// By the 95 % intervals of ADE and FDE: an interval that excludes 0 decides, unless the other
    /// excludes it on the other side.
    #[must_use]
    pub fn of(contrasts: &[Contrast; 2]) -> Self {
        let worse = contrasts.iter().any(|contrast| contrast.difference.low > 0.0);
        let better = contrasts.iter().any(|contrast| contrast.difference.high < 0.0);
        match (worse, better) {
            (true, false) => Self::Worse,
            (false, true) => Self::Better,
            (true, true) => Self::Mixed,
            (false, false) => Self::NoDifference,
        }
    }

    /// The verdict in words.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Worse => "worse",
            Self::Better => "better",
            Self::Mixed => "mixed",
            Self::NoDifference => "no difference seen",
        }
    }
}

impl Ablation {
    /// The table as Markdown that also reads well in a terminal, below a caption.
    #[must_use]
    pub fn markdown(&self) -> String {
        let columns = COMPARED.iter().flat_map(|measure| {
            [measure.name().to_owned(), "difference, %".to_owned(), "verdict".to_owned()]
        });
        let columns = columns.chain([Measure::Joint.name().to_owned()]);
        let mut table = Table::new("", "", &["variant"], columns);
        for row in &self.rows {
            let mut cells = vec![row.name.clone()];
            for measure in COMPARED {
                cells.push(row.text(measure));
                cells.extend(self.beside_the_first(row, measure));
            }
            cells.push(row.text(Measure::Joint));
            table.push_row(cells);
        }
        let (unit, agents_len, blocks_len) = self.rows.first().map_or(("m", 0, 0), |row| {
            (row.errors.unit, row.errors.total.agents_len, row.errors.blocks_len())
        });
        format!(
            "{}: ADE / FDE, {unit}, of the same {agents_len} forecasts for every variant. Differences are to the first row, in % of \
             its errors: above 0 the variant is worse, so that what it lacks helps. In brackets the paired bootstrap's 95 % \
             interval, {RESAMPLES} resamples of {blocks_len} blocks as long as one window. It covers the \
             difference between these two trainings, not between seeds; one of twenty such intervals misses by chance. The \
             verdict says which side of 0 the intervals of ADE and FDE lie on.\n\n{}",
            self.about,
            table.grid()
        )
    }

    /// Difference to the first variant and the verdict.
    fn beside_the_first(&self, row: &AblationRow, measure: Measure) -> [String; 2] {
        self.contrasts(row, measure).map_or_else(
            || ["", ""].map(str::to_owned),
            |contrasts| {
                let differences = contrasts.map(|contrast| percent(&contrast.ratio)).join(" / ");
                [differences, Verdict::of(&contrasts).name().to_owned()]
            },
        )
    }

    /// How a later variant's ADE and FDE compare with the first's.
    #[must_use]
    pub fn contrasts(&self, row: &AblationRow, measure: Measure) -> Option<[Contrast; 2]> {
        let first = self.rows.first().filter(|first| first.name != row.name)?;
        row.errors.beside(&first.errors, measure, 0)
    }

    /// Every figure, a line each: errors, and their differences to the first variant with intervals.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut text = "variant,measure,quantity,value,low,high,verdict,agents,weights_sha256\n".to_owned();
        for row in &self.rows {
            let AblationRow { name, sha256, errors } = row;
            for measure in Measure::ALL {
                let Some(Errors { ade_m, fde_m }) = row.figures(measure) else { continue };
                let agents = errors.total.len(Method::Network, measure);
                let mut line = |quantity: &str, figures: String| {
                    let unit = errors.unit;
                    text += &format!(
                        "\"{name}\",\"{}\",\"{quantity}, {unit}\",{figures},{agents},{sha256}\n",
                        measure.name()
                    );
                };
                line("ADE", format!("{ade_m:.6},,,"));
                line("FDE", format!("{fde_m:.6},,,"));
                let Some(contrasts) = self.contrasts(row, measure) else { continue };
                let verdict = Verdict::of(&contrasts).name();
                for (quantity, contrast) in
                    ["less the first's ADE", "less the first's FDE"].iter().zip(contrasts)
                {
                    let Interval { low, mean, high } = contrast.difference;
                    line(quantity, format!("{mean:.6},{low:.6},{high:.6},{verdict}"));
                }
            }
        }
        text
    }
}

impl AblationRow {
    fn figures(&self, measure: Measure) -> Option<Errors> {
        self.errors.total.errors(Method::Network, measure, 0)
    }

    fn text(&self, measure: Measure) -> String {
        self.figures(measure).map_or_else(
            || "-".to_owned(),
            |errors| format!("{} / {}", digits(errors.ade_m), digits(errors.fde_m)),
        )
    }
}

#[cfg(test)]
mod tests {
    use scene::{AgentType, State};

    use super::*;
    use crate::baselines::Candidate;
    use crate::{Agent, Block, Subset, Tally};

    /// Blocks of one pedestrian who walks 1 m; the single forecast of the n-th is off by `off_m(n)`, its one
    /// mode by half of that.
    fn group(off_m: impl Fn(usize) -> f32) -> Group {
        let block = |number: usize| {
            let agent = Agent {
                id: number as u64,
                agent_type: AgentType::Pedestrian,
                length_m: None,
                history: vec![Some(State::default())],
                future: vec![Some([1.0, 0.0])],
            };
            let mut candidates: [Candidate; Method::ALL.len()] = Default::default();
            candidates[Method::Network.index()] = Candidate {
                modes: vec![vec![[1.0, off_m(number) / 2.0]]],
                probability: None,
                single: Some(vec![[1.0, off_m(number)]]),
            };
            let mut tally = Tally::new(1);
            tally.add_agent(&agent, &candidates, &[1]);
            Block { tallies: vec![tally] }
        };
        Group::new("all", Subset::All, 0, &(0..=40).map(block).collect::<Vec<_>>())
    }

    fn ablation(variants: Vec<(&str, Group)>) -> Ablation {
        let row = |(name, errors): (&str, Group)| AblationRow {
            name: name.to_owned(),
            sha256: format!("hash of {name}"),
            errors,
        };
        Ablation { about: "walks".to_owned(), rows: variants.into_iter().map(row).collect() }
    }

    #[test]
    fn verdicts_follow_from_the_errors() {
        let first = |number: usize| 1.0 + 0.01 * number as f32;
        let ablation = ablation(vec![
            ("as recommended", group(first)),
            ("no attention", group(|number| 1.1 * first(number))),
            ("literal", group(|number| 0.8 * first(number))),
            ("same-node", group(|number| first(number) + if number % 2 == 0 { 0.3 } else { -0.3 })),
        ]);
        let text = ablation.markdown();
        let row = |name: &str| {
            let line = text.lines().find(|line| line.contains(name)).unwrap();
            line.split('|').map(str::trim).map(str::to_owned).collect::<Vec<_>>()
        };
        let (first, attention) = (row("| as recommended"), row("| no attention"));
        assert_eq!(first[2..8], ["0.600 / 0.600", "", "", "1.200 / 1.200", "", ""]);
        assert_eq!(attention[3], "+10.0 [+10.0, +10.0] / +10.0 [+10.0, +10.0]");
        assert_eq!([&attention[4], &attention[7]], ["worse", "worse"]);
        assert_eq!(row("| literal")[4], "better");
        assert_eq!(row("| same-node")[7], "no difference seen");
        assert!(text.starts_with("walks: ADE / FDE, m, of the same 41 forecasts"), "{text}");
        assert!(ablation.csv().contains("\"no attention\",\"K = 1\",\"less the first's FDE, m\",0.120000,"));
    }

    #[test]
    fn other_agents_are_not_compared() {
        let few = Group::pooled("few", &[&group(|_| 1.0), &group(|_| 1.0)]);
        let ablation = ablation(vec![("as recommended", group(|_| 1.0)), ("other", few)]);
        assert_eq!(ablation.contrasts(&ablation.rows[1], Measure::Single), None);
        assert_eq!(ablation.contrasts(&ablation.rows[0], Measure::Single), None, "the first beside itself");
    }

    #[test]
    fn ade_and_fde_may_disagree() {
        let contrast = |low: f64, high: f64| {
            let difference = Interval { low, mean: f64::midpoint(low, high), high };
            Contrast { difference, ratio: difference }
        };
        let of =
            |ade: (f64, f64), fde: (f64, f64)| Verdict::of(&[contrast(ade.0, ade.1), contrast(fde.0, fde.1)]);
        assert_eq!(of((0.1, 0.2), (-0.1, 0.2)), Verdict::Worse);
        assert_eq!(of((-0.2, 0.1), (-0.2, -0.1)), Verdict::Better);
        assert_eq!(of((0.1, 0.2), (-0.2, -0.1)), Verdict::Mixed);
        assert_eq!(of((-0.1, 0.2), (-0.1, 0.2)), Verdict::NoDifference);
    }
}
