//! Mistakes in a text that a user wrote, shown at their place in the text.

use std::fmt;
use std::ops::Range;

use annotate_snippets::renderer::{DecorStyle, Renderer};
use annotate_snippets::{AnnotationKind, Level, Snippet};

/// A mistake at a place of a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistake {
    /// The bytes of the text that are wrong.
    pub span: Range<usize>,
    /// What is wrong.
    pub message: String,
    /// What is expected at the place.
    pub label: String,
    /// Further advice, if any.
    pub help: Option<String>,
}

impl Mistake {
    /// A mistake without further advice.
    pub fn new(span: Range<usize>, message: impl Into<String>, label: impl Into<String>) -> Self {
        Self { span, message: message.into(), label: label.into(), help: None }
    }

    /// A text that is not the TOML of the expected type.
    #[must_use]
    pub fn syntax(text: &str, error: &toml::de::Error) -> Self {
        let span = error.span().unwrap_or(0..text.len().min(1));
        Self::new(span, error.message().lines().next().unwrap_or("not TOML"), "here")
    }

    /// The same mistake with advice.
    #[must_use]
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// The mistake with its text; `name` is the name of the file.
    #[must_use]
    pub fn at(self, name: &str, text: &str) -> SourceError {
        SourceError { mistake: Box::new(self), name: name.to_owned(), text: text.to_owned() }
    }
}

/// A mistake together with the text that contains the mistake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceError {
    mistake: Box<Mistake>,
    name: String,
    text: String,
}

impl SourceError {
    /// Returns the mistake.
    #[must_use]
    pub fn mistake(&self) -> &Mistake {
        &self.mistake
    }

    /// Formats the mistake with the lines of the text around it, for a terminal if `is_terminal`.
    #[must_use]
    pub fn report(&self, is_terminal: bool, is_colored: bool) -> String {
        let Mistake { span, message, label, help } = &*self.mistake;
        let place = AnnotationKind::Primary.span(span.clone()).label(label);
        let snippet = Snippet::source(&self.text).path(&self.name).annotation(place);
        let group = Level::ERROR.primary_title(message).element(snippet);
        let group = group.elements(help.as_ref().map(|help| Level::HELP.message(help)));
        let decor = if is_terminal { DecorStyle::Unicode } else { DecorStyle::Ascii };
        let renderer = if is_colored { Renderer::styled() } else { Renderer::plain() };
        renderer.decor_style(decor).render(&[group])
    }
}

impl fmt::Display for SourceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = line_of(&self.text, self.mistake.span.start);
        write!(f, "{}:{line}: {}", self.name, self.mistake.message)
    }
}

/// The line, counted from 1, of a byte of the text.
#[must_use]
pub fn line_of(text: &str, at: usize) -> usize {
    text.get(..at).unwrap_or(text).matches('\n').count() + 1
}

impl std::error::Error for SourceError {}
