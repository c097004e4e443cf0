//! Tests of the measures of tracking: against reference programs, and by scenes with a known result.
#![expect(clippy::unwrap_used, reason = "a broken fixture or scene is a broken test")]

mod tracking_golden;
mod tracking_properties;
