use wire::doubts;

wire::named! {
    /// A kind of input fault. The number is its bit in [`InputCounts::doubts`](wire::InputCounts::doubts).
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    #[repr(u32)]
    pub enum Doubt {
        /// Headings are in degrees.
        HeadingsInDegrees = doubts::HEADINGS_IN_DEGREES => "headings_in_degrees",
        /// Headings are clockwise from north, or x and y are swapped.
        HeadingsFromNorth = doubts::HEADINGS_FROM_NORTH => "headings_from_north",
        /// Headings mirror the motion: clockwise from +x, or y is flipped.
        HeadingsMirrored = doubts::HEADINGS_MIRRORED => "headings_mirrored",
        /// Headings differ from the motion by a quarter or half turn.
        HeadingsTurned = doubts::HEADINGS_TURNED => "headings_turned",
        /// Headings and motion do not agree.
        HeadingsUnrelated = doubts::HEADINGS_UNRELATED => "headings_unrelated",
        /// Speeds are in km/h.
        SpeedsInKmh = doubts::SPEEDS_IN_KMH => "speeds_in_kmh",
        /// Speeds are in mph.
        SpeedsInMph = doubts::SPEEDS_IN_MPH => "speeds_in_mph",
        /// The speed of the positions differs from the reported speed.
        SpeedsDiffer = doubts::SPEEDS_DIFFER => "speeds_differ",
        /// Agents of a type move at unusual speeds.
        SpeedsUnusual = doubts::SPEEDS_UNUSUAL => "speeds_unusual",
        /// Lengths or positions are in feet.
        Feet = doubts::FEET => "feet",
        /// Positions are in pixels.
        Pixels = doubts::PIXELS => "pixels",
        /// Stamps are in a unit other than seconds.
        StampsInOtherUnit = doubts::STAMPS_IN_OTHER_UNIT => "stamps_in_other_unit",
        /// Stamps are frame numbers.
        StampsAreFrames = doubts::STAMPS_ARE_FRAMES => "stamps_are_frames",
        /// Stamps go back in time.
        StampsGoBack = doubts::STAMPS_GO_BACK => "stamps_go_back",
        /// Detections repeat the previous one of a moving agent.
        Repeated = doubts::REPEATED => "repeated",
        /// Positions are out of their agent's reach.
        Outliers = doubts::OUTLIERS => "outliers",
        /// Positions stand for missing ones.
        Placeholders = doubts::PLACEHOLDERS => "placeholders",
        /// Identities jump from one agent to another.
        IdentitiesJump = doubts::IDENTITIES_JUMP => "identities_jump",
        /// The noise of the positions has changed by a factor of three.
        NoiseChanged = doubts::NOISE_CHANGED => "noise_changed",
        /// Positions are degrees of longitude and latitude.
        Geographic = doubts::GEOGRAPHIC => "geographic",
        /// Boxes are on top of each other.
        Stacked = doubts::STACKED => "stacked",
        /// Frames are too far apart for agents without identities.
        Sparse = doubts::SPARSE => "sparse",
        /// Agents take the same paths twice, by two clocks.
        SeenTwice = doubts::SEEN_TWICE => "seen_twice",
        /// Identities change while their agents continue. They are not used then.
        IdentitiesChange = doubts::IDENTITIES_CHANGE => "identities_change",
        /// All agents are displaced at once.
        AllDisplaced = doubts::ALL_DISPLACED => "all_displaced",
        /// Vehicles are wider than they are long.
        SizesSwapped = doubts::SIZES_SWAPPED => "sizes_swapped",
    }
}

impl Doubt {
    /// The bit in [`InputCounts::doubts`](wire::InputCounts::doubts).
    pub const fn bit(self) -> u32 {
        self as u32
    }

    /// The kinds of these bits. Bits of newer versions are ignored.
    pub fn of_bits(bits: u32) -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(move |doubt| bits & doubt.bit() != 0)
    }

    /// The observation, without figures.
    pub const fn observation(self) -> &'static str {
        match self {
            Self::HeadingsInDegrees => "headings look like degrees",
            Self::HeadingsFromNorth => "headings look clockwise from north (+y), or x and y are swapped",
            Self::HeadingsMirrored => "headings mirror the motion: they look clockwise, or y is flipped",
            Self::HeadingsTurned => "headings are turned against the motion",
            Self::HeadingsUnrelated => "headings and motion do not agree",
            Self::SpeedsInKmh => "speeds look like km/h",
            Self::SpeedsInMph => "speeds look like mph",
            Self::SpeedsDiffer => "positions move at another speed than is reported",
            Self::SpeedsUnusual => "agents move at unusual speeds",
            Self::Feet => "positions or lengths look like feet",
            Self::Pixels => "positions look like pixels: all are whole numbers",
            Self::StampsInOtherUnit => "stamps do not look like seconds",
            Self::StampsAreFrames => "stamps look like frame numbers",
            Self::StampsGoBack => "stamps go back in time",
            Self::Repeated => "detections repeat the previous one of a moving agent",
            Self::Outliers => "positions are out of their agent's reach",
            Self::Placeholders => "positions look like placeholders for missing ones",
            Self::IdentitiesJump => "identities jump: they are swapped or reused",
            Self::NoiseChanged => "the noise of the positions has changed by a factor of three",
            Self::Geographic => "positions look like degrees of longitude and latitude",
            Self::Stacked => "boxes are on top of each other, as if objects were detected twice",
            Self::Sparse => "frames are too far apart to follow agents without identities",
            Self::SeenTwice => {
                "agents take the same paths twice, as if two sensors with different clocks saw them"
            }
            Self::IdentitiesChange => "identities change while their agents continue",
            Self::AllDisplaced => "all agents are displaced at once, as if the localisation jumped",
            Self::SizesSwapped => "vehicles are wider than they are long",
        }
    }

    /// The advice to the user.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::HeadingsInDegrees => "divide them by 57.29578",
            Self::HeadingsFromNorth => "write π/2 − heading, or swap x and y",
            Self::HeadingsMirrored => "negate the headings or y",
            Self::HeadingsTurned => "add the angle, or leave the column empty",
            Self::HeadingsUnrelated => "write radians counter-clockwise from +x, or leave the column empty",
            Self::SpeedsInKmh => "divide them by 3.6",
            Self::SpeedsInMph => "multiply them by 0.44704",
            Self::SpeedsDiffer | Self::SpeedsUnusual => "write metres and seconds",
            Self::Feet => "multiply them by 0.3048",
            Self::Pixels => "multiply them by the metres of a pixel",
            Self::StampsInOtherUnit => "write seconds",
            Self::StampsAreFrames => "divide them by the frames a second",
            Self::StampsGoBack => "sort the rows, or split the recording where its clock was set",
            Self::Repeated => "write only new measurements; repeated ones are not counted as measurements",
            Self::Outliers => "leave wrong positions out; they count as missed detections",
            Self::Placeholders => "leave these rows out; they count as missed detections",
            Self::IdentitiesJump => "check the identities, or let the tracker associate (--associate)",
            Self::NoiseChanged => "check the detector",
            Self::Geographic => "project them to metres, such as UTM less the coordinates of a point nearby",
            Self::Stacked => "write each object once",
            Self::Sparse => "write identities, or more frames a second",
            Self::SeenTwice => "set one clock, or leave one sensor out",
            Self::IdentitiesChange => {
                "they are ignored, and tracks follow the positions (as with --associate)"
            }
            Self::SizesSwapped => "swap length and width",
            Self::AllDisplaced => {
                "correct the localisation, or write positions in a frame that does not jump"
            }
        }
    }
}
