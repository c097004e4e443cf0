/// The exit codes of this project's programs. The numbers follow sysexits.h if it has a suitable one.
///
/// | code | meaning |
/// |---|---|
/// | 0 | done |
/// | 1 | `diff` and `replay` have found differences |
/// | 2 | wrong usage of the command line |
/// | 65 | a recording, map or weights file can't be used, or an output file can't be written |
/// | 69 | a resource is missing: shared memory, space, a port |
/// | 70 | a stage died, or a check came out wrong |
/// | 78 | pipeline.toml or the run's record can't be used |
/// | 129 | ended by SIGHUP (the terminal is gone) |
/// | 130 | ended by SIGINT (Ctrl-C) |
/// | 131 | ended by SIGQUIT |
/// | 143 | ended by SIGTERM |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Done.
    Done = 0,
    /// A comparison has found differences.
    Different = 1,
    /// Wrong usage of the command line.
    Usage = 2,
    /// A recording, map or weights file can't be used.
    Data = 65,
    /// A resource is missing: shared memory, space, a port.
    Unavailable = 69,
    /// A stage died, or a check came out wrong.
    Failed = 70,
    /// pipeline.toml or the run's record can't be used.
    Config = 78,
    /// Ended by SIGHUP.
    HungUp = 129,
    /// Ended by SIGINT.
    Interrupted = 130,
    /// Ended by SIGQUIT.
    Quit = 131,
    /// Ended by SIGTERM.
    Terminated = 143,
}

impl Exit {
    /// The variant of a process's exit code, if there is one.
    #[must_use]
    pub fn from_code(code: i32) -> Option<Self> {
        [
            Self::Done,
            Self::Different,
            Self::Usage,
            Self::Data,
            Self::Unavailable,
            Self::Failed,
            Self::Config,
            Self::HungUp,
            Self::Interrupted,
            Self::Quit,
            Self::Terminated,
        ]
        .into_iter()
        .find(|&exit| exit as i32 == code)
    }
}

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}
