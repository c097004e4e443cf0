use std::ops::Range;

use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode};
use thiserror::Error;

/// What is wrong with a pipeline.toml, and where.
#[derive(Debug, Error)]
#[error("{message}")]
pub struct PipelineError {
    message: String,
    help: Option<String>,
    label: String,
    span: Range<usize>,
    source_code: Box<NamedSource<String>>,
}

/// A fault at a place of the text; the text itself is added by [`Fault::at`].
#[derive(Debug)]
pub(super) struct Fault {
    pub message: String,
    pub label: String,
    pub help: Option<String>,
    pub span: Range<usize>,
}

impl Fault {
    pub fn new(span: Range<usize>, message: impl Into<String>, label: impl Into<String>) -> Self {
        Self { message: message.into(), label: label.into(), help: None, span }
    }

    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    pub fn at(self, name: &str, text: &str) -> PipelineError {
        let Self { message, label, help, span } = self;
        let source_code = Box::new(NamedSource::new(name, text.to_owned()).with_language("TOML"));
        PipelineError { message, help, label, span, source_code }
    }
}

impl PipelineError {
    pub(super) fn syntax(name: &str, text: &str, error: &toml::de::Error) -> Self {
        let span = error.span().unwrap_or(0..text.len().min(1));
        let message = error.message().lines().next().unwrap_or("not a pipeline.toml").to_owned();
        Fault::new(span, message, "here").at(name, text)
    }
}

impl Diagnostic for PipelineError {
    fn help<'a>(&'a self) -> Option<Box<dyn std::fmt::Display + 'a>> {
        self.help.as_ref().map(|help| Box::new(help) as Box<dyn std::fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        Some(&*self.source_code)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let label = LabeledSpan::new_with_span(Some(self.label.clone()), self.span.clone());
        Some(Box::new(std::iter::once(label)))
    }
}
