use std::path::PathBuf;

use thiserror::Error;

/// Why a Lanelet2 map could not be read.
#[derive(Debug, Error)]
pub enum LaneMapError {
    /// The file can't be opened or read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file as a whole can't be used: it is too large, has too many items of one kind, or has no lanelet
    /// that any agent uses.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: String,
        /// What is wrong.
        problem: String,
    },
    /// The file is not valid OSM XML.
    #[error("{path}:{line}:{column}: {problem}")]
    Syntax {
        /// The file.
        path: String,
        /// The line, from 1.
        line: u32,
        /// The column, from 1.
        column: u32,
        /// The reason.
        problem: String,
    },
    /// An element of the map cannot be used.
    #[error("{path}:{line}: {element}: {problem}")]
    Element {
        /// The file.
        path: String,
        /// The line of the element, from 1.
        line: u32,
        /// The element.
        element: Element,
        /// The reason, with the value.
        problem: String,
    },
}

wire::named! {
    /// The kind of an element of OSM XML.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Kind {
        /// A point.
        Node => "node",
        /// A line of nodes.
        Way => "way",
        /// A set of elements, such as a lanelet.
        Relation => "relation",
    }
}

/// An element by kind and number. The number is 0 if the element has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Element {
    /// The kind.
    pub kind: Kind,
    /// The number in the file; negative for elements that were never uploaded.
    pub id: i64,
}

impl std::fmt::Display for Element {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.kind.name(), self.id)
    }
}
