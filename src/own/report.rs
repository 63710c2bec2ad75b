//! What is wrong with a text, shown in the text.

use codespan_reporting::diagnostic::{Diagnostic, Label};
use codespan_reporting::files::SimpleFile;
use codespan_reporting::term;
use naga::front::wgsl::ParseError;
use naga::{Span, WithSpan};
use std::error::Error;
use std::ops::Range;

/// Something wrong, with the places in what naga was given.
#[derive(Debug)]
pub struct Problem {
    message: String,
    labels: Vec<(Option<Range<usize>>, String)>,
    notes: Vec<String>,
}

impl Problem {
    /// Something wrong at one place.
    pub fn at(span: Span, message: impl Into<String>) -> Self {
        Self::labelled(message, span.to_range(), "here")
    }

    /// Something wrong with the text as a whole.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), labels: Vec::new(), notes: Vec::new() }
    }

    /// Something wrong at one place, about which there is something to say.
    pub fn labelled(
        message: impl Into<String>,
        place: Option<Range<usize>>,
        label: impl Into<String>,
    ) -> Self {
        Self { labels: vec![(place, label.into())], ..Self::new(message) }
    }

    /// As the user's text shows it, which begins at `offset` of what naga was given. Places outside of it are moved to
    /// its ends.
    pub fn show(self, name: &str, text: &str, offset: usize) -> String {
        let place = |place: Range<usize>| {
            let inside = |at: usize| floor_char_boundary(text, at.saturating_sub(offset));
            let (start, end) = (inside(place.start), inside(place.end));
            start..end.max(start)
        };
        let labels = self.labels.into_iter().filter_map(|(range, label)| Some((place(range?), label)));
        let labels = labels.map(|(range, label)| Label::primary((), range).with_message(label));
        let diagnostic = Diagnostic::error()
            .with_message(&self.message)
            .with_labels(labels.collect())
            .with_notes(self.notes);
        let mut shown = String::new();
        let file = SimpleFile::new(name, text);
        match term::emit_to_string(&mut shown, &term::Config::default(), &file, &diagnostic) {
            Ok(()) => shown.trim_end().to_owned(),
            Err(_) => format!("error: {}", self.message),
        }
    }
}

fn floor_char_boundary(text: &str, at: usize) -> usize {
    let mut at = at.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

impl From<ParseError> for Problem {
    fn from(error: ParseError) -> Self {
        Self {
            message: error.message().to_owned(),
            labels: error.labels().map(|(span, label)| (span.to_range(), label.to_owned())).collect(),
            notes: error.notes().map(|note| format!("note: {note}")).collect(),
        }
    }
}

impl<E: Error> From<WithSpan<E>> for Problem {
    fn from(error: WithSpan<E>) -> Self {
        let mut notes = Vec::new();
        let mut source = error.as_inner().source();
        while let Some(next) = source {
            notes.push(next.to_string());
            source = next.source();
        }
        Self {
            message: error.to_string(),
            labels: error.spans().map(|(span, label)| (span.to_range(), label.clone())).collect(),
            notes,
        }
    }
}
