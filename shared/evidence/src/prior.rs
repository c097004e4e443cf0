use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::{fmt, io};

use crate::{BANDS, KNOTS, Pattern, Statistics, fill_unknown};

/// Deviations for contexts without a source, m.
const DEVIATIONS_M: [[f32; 2]; KNOTS] = [[0.1, 0.05], [0.5, 0.25], [1.8, 0.8], [6.0, 3.0]];
/// Logarithms of the width factors for contexts without a source. Most types and speeds have similar factors.
const LOG_WIDTHS: [f32; KNOTS] = [0.3, 0.0, -0.25, -0.35];
/// Minimum number of sources in the average of a context's prior. The default replaces missing sources, so
/// that a single source with poor positions does not dominate.
const SOURCES_MIN: usize = 3;
/// Significant digits of the numbers in a file.
const DIGITS: i32 = 4;

/// The expectation before any forecast has matured, by agent type and speed.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(transparent)]
pub struct Prior(pub [[ContextPrior; BANDS]; 3]);

/// The expectation of one type at one speed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContextPrior {
    /// Mean statistics of a forecast at each knot. Without a source, constant velocity was right.
    pub blend: [Statistics; KNOTS],
    /// Logarithm of the factor of the widths, at each knot.
    pub log_width: [f32; KNOTS],
    /// Deviations from the fan's centre along and across the course at each knot, m.
    pub deviation_m: [[f32; 2]; KNOTS],
    /// Share of the forecasts in which a mode of the network was nearer than all modes of the fan.
    pub network_share: f32,
    /// Typical residuals from the centre; omitted from a file if nothing was learned.
    #[serde(default, skip_serializing_if = "Pattern::is_default")]
    pub pattern: Pattern,
}

/// Typical residuals, by type of agent and speed.
pub type Patterns = [[Pattern; BANDS]; 3];

/// Priors learned on sources of recordings that the network was not trained on.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Priors {
    /// The prior of each source, by name. It has no pattern, because patterns have no mean.
    pub sources: BTreeMap<String, Prior>,
    /// The patterns of all sources together.
    pub pattern: Patterns,
    /// The patterns without one source, by the name of that source.
    pub pattern_without: BTreeMap<String, Patterns>,
}

/// Priors that can't be read.
#[derive(Debug)]
pub enum PriorError {
    /// The file can't be read.
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The text is not one of priors.
    Text {
        /// The file; `None` for the shipped priors.
        path: Option<PathBuf>,
        /// Line and column, and the cause.
        source: serde_json::Error,
    },
}

impl fmt::Display for PriorError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { path, source } => write!(formatter, "{}: {source}", path.display()),
            Self::Text { path, source } => {
                let path = path.as_deref().unwrap_or(Path::new("priors"));
                write!(formatter, "{}: no priors of the experts: {source}", path.display())
            }
        }
    }
}

impl std::error::Error for PriorError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::File { source, .. } => Some(source),
            Self::Text { source, .. } => Some(source),
        }
    }
}

impl Default for ContextPrior {
    fn default() -> Self {
        Self {
            blend: [Statistics::doubting(); KNOTS],
            log_width: LOG_WIDTHS,
            deviation_m: DEVIATIONS_M,
            network_share: 0.5,
            pattern: Pattern::default(),
        }
    }
}

impl Default for Prior {
    fn default() -> Self {
        Self([[ContextPrior::default(); BANDS]; 3])
    }
}

impl ContextPrior {
    /// Whether a source has evidence for the context.
    fn is_known(&self) -> bool {
        self.blend.iter().all(|blend| blend.len > 0.0)
    }

    /// The mean over sources: geometric for distances, the median for widths. A source with poor positions
    /// therefore does not dominate.
    fn mean(sources: &[&Self]) -> Self {
        let share = 1.0 / sources.len() as f64;
        let mut mean = Self { blend: Default::default(), deviation_m: [[0.0; 2]; KNOTS], ..Self::default() };
        for (knot, blend) in mean.blend.iter_mut().enumerate() {
            sources.iter().for_each(|source| blend.add_scaled(&source.blend[knot], share));
        }
        mean.deviation_m = std::array::from_fn(|knot| {
            [0, 1].map(|axis| geometric_mean(sources.iter().map(|source| source.deviation_m[knot][axis])))
        });
        mean.network_share = sources.iter().map(|source| source.network_share).sum::<f32>() * share as f32;
        for (knot, log_width) in mean.log_width.iter_mut().enumerate() {
            let mut widths: Vec<f32> = sources.iter().map(|source| source.log_width[knot]).collect();
            widths.sort_unstable_by(f32::total_cmp);
            let [low, high] = [(widths.len() - 1) / 2, widths.len() / 2].map(|middle| widths[middle]);
            *log_width = 0.5 * (low + high);
        }
        mean
    }

    /// The numbers rounded to the file's digits.
    fn rounded(&self) -> Self {
        let blend = self.blend.map(|of| Statistics {
            products: of.products.map(|row| row.map(rounded)),
            targets: of.targets.map(rounded),
            len: rounded(of.len),
        });
        let short = |value: f32| rounded(f64::from(value)) as f32;
        Self {
            blend,
            log_width: self.log_width.map(short),
            deviation_m: self.deviation_m.map(|of| of.map(short)),
            network_share: shorter(self.network_share),
            pattern: self.pattern.rounded(),
        }
    }
}

impl Pattern {
    /// The numbers rounded to the file's digits.
    fn rounded(&self) -> Self {
        Self {
            points: self.points.map(|knots| knots.map(|point| point.map(shorter))),
            probability: self.probability.map(shorter),
        }
    }
}

impl Priors {
    /// The shipped priors: the evidence about the embedded weights on sources that they were not trained on.
    ///
    /// # Panics
    /// Never: a test reads them.
    #[must_use]
    pub fn shipped() -> Self {
        Self::from_json(include_str!("priors.json")).expect("a test reads them")
    }

    /// The prior over all sources with equal weight; the default replaces missing ones up to three. A context
    /// without evidence takes the nearest known speed's.
    pub fn all(&self) -> Prior {
        Self::mean(self.sources.values(), &self.pattern)
    }

    /// As [`Priors::all`], without one source at any scale.
    #[must_use]
    pub fn without(&self, source: &str) -> Prior {
        let others = self.sources.iter().filter(|(name, _)| !is_of(name, source)).map(|(_, prior)| prior);
        Self::mean(others, self.pattern_without.get(source).unwrap_or(&self.pattern))
    }

    /// The mean of a source's recordings, each with equal weight: what one source of a file of priors holds.
    /// A context that no recording has evidence for stays empty.
    #[must_use]
    pub fn source(recordings: &[Prior]) -> Prior {
        let mut mean = Prior::default();
        for (of_type, contexts) in mean.0.iter_mut().enumerate() {
            for (band, context) in contexts.iter_mut().enumerate() {
                let of_recordings = recordings.iter().map(|prior| &prior.0[of_type][band]);
                let known: Vec<&ContextPrior> = of_recordings.filter(|of| of.is_known()).collect();
                *context = match &known[..] {
                    [] => ContextPrior { blend: Default::default(), ..ContextPrior::default() },
                    known => ContextPrior::mean(known),
                };
            }
        }
        mean
    }

    fn mean<'a>(sources: impl Iterator<Item = &'a Prior>, pattern: &Patterns) -> Prior {
        let sources: Vec<&Prior> = sources.collect();
        let mut mean = Prior::default();
        for (of_type, contexts) in mean.0.iter_mut().enumerate() {
            let mut known = [false; BANDS];
            for (band, context) in contexts.iter_mut().enumerate() {
                let of_sources = sources.iter().map(|source| &source.0[of_type][band]);
                let of_sources: Vec<&ContextPrior> = of_sources.filter(|of| of.is_known()).collect();
                known[band] = !of_sources.is_empty();
                if known[band] {
                    let default = ContextPrior::default();
                    let lacking = SOURCES_MIN.saturating_sub(of_sources.len());
                    let filled = of_sources.into_iter().chain(std::iter::repeat_n(&default, lacking));
                    *context = ContextPrior::mean(&filled.collect::<Vec<_>>());
                }
            }
            fill_unknown(contexts, &known);
            for (context, pattern) in contexts.iter_mut().zip(&pattern[of_type]) {
                context.pattern = *pattern;
            }
        }
        mean
    }

    /// Parses the text of [`Priors::to_json`].
    ///
    /// # Errors
    /// [`PriorError`] if the text is not valid.
    pub fn from_json(text: &str) -> Result<Self, PriorError> {
        serde_json::from_str(text).map_err(|source| PriorError::Text { path: None, source })
    }

    /// Reads a file with the text of [`Priors::to_json`].
    ///
    /// # Errors
    /// [`PriorError`] names the file.
    pub fn open(path: &Path) -> Result<Self, PriorError> {
        let named = |source| PriorError::File { path: path.to_owned(), source };
        let text = std::fs::read_to_string(path).map_err(named)?;
        let wrong = |source| PriorError::Text { path: Some(path.to_owned()), source };
        serde_json::from_str(&text).map_err(wrong)
    }

    /// The priors as text with few digits.
    ///
    /// # Panics
    /// Never: all keys are text.
    pub fn to_json(&self) -> String {
        let of_prior = |prior: &Prior| Prior(prior.0.map(|of_type| of_type.map(|context| context.rounded())));
        let of_patterns =
            |patterns: &Patterns| patterns.map(|of_type| of_type.map(|pattern| pattern.rounded()));
        let rounded = Self {
            sources: self.sources.iter().map(|(name, prior)| (name.clone(), of_prior(prior))).collect(),
            pattern: of_patterns(&self.pattern),
            pattern_without: (self.pattern_without.iter())
                .map(|(name, patterns)| (name.clone(), of_patterns(patterns)))
                .collect(),
        };
        serde_json::to_string(&rounded).expect("keys are text")
    }
}

/// Whether `name` is the name of `source`, at any scale.
fn is_of(name: &str, source: &str) -> bool {
    name.strip_prefix(source).is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
}

/// A number rounded to four decimal places.
fn shorter(value: f32) -> f32 {
    (value * 1e4).round() / 1e4
}

/// The geometric mean of distances; 1 for an empty list. Distances below a millimetre count as one
/// millimetre.
fn geometric_mean(distances_m: impl Iterator<Item = f32>) -> f32 {
    let (sum, len) = distances_m.fold((0.0, 0.0_f32), |(sum, len), x| (sum + x.max(1e-3).ln(), len + 1.0));
    (sum / len.max(1.0)).exp()
}

/// A number rounded to [`DIGITS`] digits.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return 0.0;
    }
    let unit = 10_f64.powi(value.abs().log10().floor() as i32 + 1 - DIGITS);
    // The shortest text that parses to this number.
    format!("{:e}", (value / unit).round() * unit)
        .parse::<f64>()
        .map_or(value, |value| format!("{value:.*e}", DIGITS as usize - 1).parse().unwrap_or(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_priors_expect_experts_to_be_worth_something() {
        let priors = Priors::shipped();
        let prior = priors.all();
        let worth = |of: &ContextPrior| of.blend.iter().all(|at| at.weights().iter().sum::<f32>() > 0.0);
        assert!(prior.0[0].iter().all(worth), "{:?}", prior.0[0].map(|of| of.blend.map(|at| at.weights())));
        assert!(Priors::from_json(&priors.to_json()).unwrap() == priors, "another one after a round trip");
    }

    #[test]
    fn a_source_that_is_left_out_has_no_part() {
        let prior = |width: f32| {
            let blend = [Statistics { len: 1.0, ..Statistics::default() }; KNOTS];
            let mut prior = Prior::default();
            prior.0[0][2] = ContextPrior { blend, log_width: [width; KNOTS], ..ContextPrior::default() };
            prior
        };
        let names = ["a", "b", "c ×2", "cd"].into_iter().zip([1.0, 2.0, 8.0, 5.0]);
        let sources =
            |len: usize| names.clone().take(len).map(|(name, width)| (name.to_owned(), prior(width)));
        let mut priors = Priors { sources: sources(4).collect(), ..Priors::default() };
        let widths = |mean: Prior| mean.0[0].map(|context| context.log_width[0]);
        assert_eq!(widths(priors.all()), [3.5; BANDS]);
        assert_eq!(widths(priors.without("other")), [3.5; BANDS]);
        // At any scale, but not a source whose name has the same start.
        assert_eq!(widths(priors.without("c")), [2.0; BANDS]);
        // The default replaces a third source, and then a second.
        priors.sources = sources(2).collect();
        assert_eq!(widths(priors.all()), [1.0; BANDS]);
        assert_eq!(widths(priors.without("b")), [LOG_WIDTHS[0]; BANDS]);
        assert_eq!(Priors::default().all(), Prior::default());
        // Its residuals are not part of the patterns either.
        let mut patterns = Patterns::default();
        patterns[0][2].points[0][0] = [7.0, 0.0];
        priors.pattern_without.insert("b".to_owned(), patterns);
        assert_eq!(priors.without("b").0[0][2].pattern, patterns[0][2]);
        assert_eq!(priors.without("a").0[0][2].pattern, Pattern::default());
    }

    #[test]
    fn a_source_is_the_mean_of_its_recordings() {
        let recording = |width: f32, len: f64| {
            let blend = [Statistics { len, ..Statistics::default() }; KNOTS];
            let mut prior = Prior::default();
            prior.0[0][2] = ContextPrior { blend, log_width: [width; KNOTS], ..ContextPrior::default() };
            prior
        };
        // The last one has no evidence.
        let source = Priors::source(&[recording(1.0, 1.0), recording(3.0, 1.0), recording(9.0, 0.0)]);
        assert_eq!(source.0[0][2].log_width, [2.0; KNOTS]);
        assert!(source.0[0][2].is_known() && !source.0[0][1].is_known() && !source.0[1][2].is_known());
    }

    #[test]
    fn a_file_that_holds_no_priors_is_named_with_the_place_in_it() {
        let path = std::env::temp_dir().join(format!("stgdat_prior_{}.json", std::process::id()));
        assert!(Priors::open(&path).is_err_and(|why| why.to_string().contains("stgdat_prior_")));
        std::fs::write(&path, "{\"sources\": {},\n \"pattern\": 7}").unwrap();
        let why = Priors::open(&path).unwrap_err().to_string();
        assert!(why.contains("stgdat_prior_") && why.contains("line 2"), "{why}");
        std::fs::write(&path, Priors::shipped().to_json()).unwrap();
        assert!(Priors::open(&path).is_ok_and(|priors| priors == Priors::shipped()));
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn numbers_are_written_with_four_digits() {
        assert_eq!([0.123_456, -98_765.4, 0.0, 2.0].map(rounded), [0.1235, -98_770.0, 0.0, 2.0]);
    }
}
