use std::io::IsTerminal;

/// The environment variable that holds a [`Color`], for programs that get no `--color`.
pub const COLOR_VARIABLE: &str = "STGDAT_COLOR";

wire::named! {
    /// When a program colours its output.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum Color {
        /// On a terminal, unless `NO_COLOR` is set.
        #[default]
        Auto => "auto",
        /// Always.
        Always => "always",
        /// Never.
        Never => "never",
    }
}

impl Color {
    /// The choice of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|color| color.name() == name)
    }

    /// The choice in [`COLOR_VARIABLE`]; `Auto` if there is none.
    #[must_use]
    pub fn of_environment() -> Self {
        std::env::var(COLOR_VARIABLE).ok().and_then(|name| Self::from_name(&name)).unwrap_or_default()
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
