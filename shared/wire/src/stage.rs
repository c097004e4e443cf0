use std::fmt;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::ADDED_STAGES_MAX;
use crate::table::{Number, Numbers};

/// A stage of the pipeline, by number: one of stgdat's own, with a number below 64, or one that a pipeline
/// file has added.
///
/// Numbers below 64 are reserved for stgdat's own stages; 0 stands for none. Number 64 is the tap, which is
/// not a stage. The stages of a pipeline file have the numbers from [`StageId::ADDED_FIRST`], in the order of
/// the file. Their names belong to the run. A process learns them from the run's record
/// ([`StageId::name_added`]), and works with one run at a time.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StageId(u32);

macro_rules! stages {
    ($($(#[doc = $doc:literal])+ $stage:ident = $number:literal => $name:literal,)+) => {
        #[expect(non_upper_case_globals, reason = "they are used like the variants of an enum")]
        impl StageId {
            $($(#[doc = $doc])+ pub const $stage: Self = Self($number);)+

            /// Stgdat's own stages, in the order of their numbers.
            pub const ALL: [Self; [$($number),+].len()] = [$(Self::$stage),+];
        }

        impl StageId {
            /// Their entry in the table.
            pub const NUMBERS: Numbers = Numbers {
                name: "StageId",
                doc: "A stage of the pipeline, by number. Numbers below 64 are kept for stages of stgdat's own, 0 stands for\n\
                    none of them, 64 is the tap's; from 65 to 80 are those of the stages that a pipeline file adds, in the\n\
                    order of the file.\n",
                entries: &[$(Number { name: $name, doc: concat!($($doc, "\n"),+), number: $number }),+],
            };
        }
    };
}

stages! {
    /// Releases detections.
    Source = 1 => "source",
    /// Computes tracks from detections.
    Tracker = 2 => "tracker",
    /// Samples local patches of the context map.
    Localiser = 3 => "localiser",
    /// Computes node and edge attributes.
    Extractor = 4 => "extractor",
    /// Graph dual attention: the temporal summary of each agent.
    Encoder = 5 => "encoder",
    /// Control Gaussians of each agent, draw and step.
    Decoder = 6 => "decoder",
    /// Trajectories through the kinematic layer.
    Sampler = 7 => "sampler",
    /// Collects the data for the report.
    Recorder = 8 => "recorder",
}

/// Maximum number of different names of added stages that a process learns. Later names are ignored.
const NAMES_MAX: usize = 256;

/// Names, each stored once and until the process ends. Reading takes no lock.
struct Names<const LEN: usize>([OnceLock<Box<str>>; LEN]);

impl<const LEN: usize> Names<LEN> {
    const fn new() -> Self {
        Self([const { OnceLock::new() }; LEN])
    }

    /// The index of a name; `None` if there is no room for it.
    fn intern(&self, name: &str) -> Option<usize> {
        self.0.iter().position(|slot| **slot.get_or_init(|| name.into()) == *name)
    }
}

/// All names of added stages that this process has learnt.
static NAMES: Names<NAMES_MAX> = Names::new();

/// The current run's added stages, by place: the index of the name plus one; 0 for an unknown name.
static ADDED: [AtomicUsize; ADDED_STAGES_MAX] = [const { AtomicUsize::new(0) }; ADDED_STAGES_MAX];

/// The names of added stages whose names this process does not know, by place.
const UNKNOWN: [&str; ADDED_STAGES_MAX] = [
    "stage-65", "stage-66", "stage-67", "stage-68", "stage-69", "stage-70", "stage-71", "stage-72",
    "stage-73", "stage-74", "stage-75", "stage-76", "stage-77", "stage-78", "stage-79", "stage-80",
];

/// The name that the current run has given to the added stage at this place.
fn given_name(place: usize) -> Option<&'static str> {
    let index = ADDED[place].load(Ordering::Acquire).checked_sub(1)?;
    NAMES.0[index].get().map(|name| &**name)
}

impl StageId {
    /// Number of the first added stage; [`ADDED_STAGES_MAX`] numbers follow each other.
    pub const ADDED_FIRST: u32 = 65;

    /// The greatest number that a stage can have.
    pub const NUMBER_MAX: u32 = Self::ADDED_FIRST + ADDED_STAGES_MAX as u32 - 1;

    /// Maximum number of stages at a time: stgdat's own and those of a pipeline file.
    pub const PLACES_LEN: usize = Self::ALL.len() + ADDED_STAGES_MAX;

    /// The added stage at this place in the pipeline file, from 0.
    #[must_use]
    pub fn added(place: usize) -> Option<Self> {
        (place < ADDED_STAGES_MAX).then(|| Self(Self::ADDED_FIRST + place as u32))
    }

    /// The stage with this number; `None` if no stage can have it.
    #[must_use]
    pub const fn from_number(number: u32) -> Option<Self> {
        match number {
            1..=8 | Self::ADDED_FIRST..=Self::NUMBER_MAX => Some(Self(number)),
            _ => None,
        }
    }

    /// Its number in headers and heartbeats.
    pub const fn number(self) -> u32 {
        self.0
    }

    /// Whether a pipeline file has added the stage.
    pub const fn is_added(self) -> bool {
        self.0 >= Self::ADDED_FIRST
    }

    /// Its index in tables of [`StageId::PLACES_LEN`] stages.
    pub const fn place(self) -> usize {
        if self.is_added() {
            Self::ALL.len() + (self.0 - Self::ADDED_FIRST) as usize
        } else {
            self.0 as usize - 1
        }
    }

    /// The name used on the command line, in files and in reports. If this process does not know an added
    /// stage's name, the name is its number.
    pub fn name(self) -> &'static str {
        if let Some(entry) = Self::NUMBERS.entries.iter().find(|entry| entry.number == self.0) {
            return entry.name;
        }
        let place = (self.0 - Self::ADDED_FIRST) as usize;
        given_name(place).unwrap_or(UNKNOWN[place])
    }

    /// Sets the name of an added stage in this process, by its place in the pipeline file. Places beyond
    /// [`ADDED_STAGES_MAX`] are ignored.
    pub fn name_added(place: usize, name: &str) {
        if let (Some(added), Some(index)) = (ADDED.get(place), NAMES.intern(name)) {
            added.store(index + 1, Ordering::Release);
        }
    }

    /// The stage of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::known().find(|stage| stage.name() == name)
    }

    /// Stgdat's own stages, and the added ones whose names this process knows.
    pub fn known() -> impl Iterator<Item = Self> {
        let added = (0..ADDED_STAGES_MAX).filter(|&place| given_name(place).is_some());
        Self::ALL.into_iter().chain(added.filter_map(Self::added))
    }
}

impl fmt::Debug for StageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn added_stages_follow_the_shipped_ones_up_to_the_limit() {
        let numbers: Vec<u32> = (0..200).filter_map(StageId::from_number).map(StageId::number).collect();
        let expected: Vec<u32> = (1..=8).chain(65..=80).collect();
        assert_eq!(numbers, expected);
        let places: Vec<usize> = (0..200).filter_map(StageId::from_number).map(StageId::place).collect();
        assert!(places.iter().copied().eq(0..StageId::PLACES_LEN));
        assert_eq!(StageId::added(15).map(StageId::number), Some(StageId::NUMBER_MAX));
        assert_eq!(StageId::added(16), None);
    }

    #[test]
    fn names_are_stored_once_and_have_a_limit() {
        let names = Names::<2>::new();
        assert_eq!(
            ["a", "b", "a", "c", "b"].map(|name| names.intern(name)),
            [Some(0), Some(1), Some(0), None, Some(1)]
        );
        for (place, name) in UNKNOWN.iter().enumerate() {
            assert_eq!(*name, format!("stage-{}", StageId::added(place).unwrap().number()));
        }
    }

    #[test]
    fn an_added_stage_has_the_name_that_its_run_gave_it() {
        let stage = StageId::added(11).unwrap();
        assert_eq!(StageId::from_name("planner"), None);
        StageId::name_added(11, "planner");
        assert_eq!((stage.name(), StageId::from_name("planner")), ("planner", Some(stage)));
        StageId::name_added(11, "monitor");
        assert_eq!((stage.name(), StageId::from_name("planner")), ("monitor", None), "another run");
        let unknown = StageId::from_number(74).unwrap();
        assert_eq!((unknown.name(), format!("{unknown:?}").as_str()), ("stage-74", "stage-74"));
        assert!(StageId::known().all(|stage| stage != unknown), "reading a name sets none");
        assert_eq!(StageId::from_name("sampler"), Some(StageId::Sampler));
    }
}
