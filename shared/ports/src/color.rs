use std::io::IsTerminal;
use std::str::FromStr;

use thiserror::Error;

/// The environment variable that holds a [`Color`], for programs that get no `--color`.
pub const COLOR_VARIABLE: &str = "STGDAT_COLOR";

/// When a program colours its output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Color {
    /// On a terminal, unless `NO_COLOR` is set.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// The text does not name a [`Color`].
#[derive(Debug, Error, PartialEq, Eq)]
#[error("expected auto, always or never")]
pub struct UnknownColor;

impl Color {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::Auto, Self::Always, Self::Never];

    /// The name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Always => "always",
            Self::Never => "never",
        }
    }

    /// The choice in [`COLOR_VARIABLE`]; `Auto` if there is none.
    #[must_use]
    pub fn of_environment() -> Self {
        std::env::var(COLOR_VARIABLE).ok().and_then(|name| name.parse().ok()).unwrap_or_default()
    }

    /// Whether an output gets colours.
    #[must_use]
    pub fn is_on(self, output: &impl IsTerminal) -> bool {
        let is_set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
        match self {
            Self::Always => true,
            Self::Never => false,
            Self::Auto => output.is_terminal() && !is_set("NO_COLOR"),
        }
    }
}

impl FromStr for Color {
    type Err = UnknownColor;

    fn from_str(name: &str) -> Result<Self, UnknownColor> {
        Self::ALL.into_iter().find(|color| color.name() == name).ok_or(UnknownColor)
    }
}
