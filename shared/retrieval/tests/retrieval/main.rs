//! Tests of the retrieval memory: retrieved residuals, their effect, and memory files.

mod files;
mod online;
mod passing;
mod selection;
