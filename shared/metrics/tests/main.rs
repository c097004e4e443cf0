//! Tests of the tracking measures, against reference programs and on scenes with a known result.
#![expect(clippy::unwrap_used, reason = "a broken fixture or scene is a broken test")]

mod tracking_golden;
mod tracking_properties;
