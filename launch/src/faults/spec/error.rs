use std::ops::Range;
use std::path::Path;

use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode};
use thiserror::Error;

/// An error in a specification, with its place.
#[derive(Debug, Error)]
#[error("{}:{line}: {message}", source_code.name())]
pub struct SpecError {
    message: String,
    label: String,
    line: usize,
    span: Range<usize>,
    source_code: Box<NamedSource<String>>,
}

/// A mistake at a place of the text. [`Mistake::at`] adds the text.
#[derive(Debug)]
pub(super) struct Mistake {
    pub span: Range<usize>,
    pub message: String,
    pub label: String,
}

impl Mistake {
    pub fn new(span: Range<usize>, message: impl Into<String>, label: impl Into<String>) -> Self {
        Self { span, message: message.into(), label: label.into() }
    }

    pub fn at(self, path: &Path, text: &str) -> SpecError {
        let Self { span, message, label } = self;
        let line = text.bytes().take(span.start).filter(|byte| *byte == b'\n').count() + 1;
        let name = path.display().to_string();
        let source_code = Box::new(NamedSource::new(name, text.to_owned()).with_language("TOML"));
        SpecError { message, label, line, span, source_code }
    }
}

impl Diagnostic for SpecError {
    fn source_code(&self) -> Option<&dyn SourceCode> {
        Some(&*self.source_code)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let label = LabeledSpan::new_with_span(Some(self.label.clone()), self.span.clone());
        Some(Box::new(std::iter::once(label)))
    }
}
