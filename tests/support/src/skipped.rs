//! Tests that can't run on this machine. The test harness counts them as passed and hides what they print, so
//! the process lists them at its end.
#![expect(unsafe_code, reason = "a function that the process calls at its end")]

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::Write as _;
use std::sync::{Mutex, PoisonError};

/// Tests by the reason for which they were skipped.
static SKIPPED: Mutex<BTreeMap<String, Vec<String>>> = Mutex::new(BTreeMap::new());

/// Notes that the current test is skipped. The process prints all of them at its end, with their reasons.
pub fn skip(reason: impl Display) {
    let mut skipped = SKIPPED.lock().unwrap_or_else(PoisonError::into_inner);
    if skipped.is_empty() {
        // SAFETY: the function neither panics nor returns to Rust's runtime. It uses only the standard library
        // and a static.
        unsafe { libc::atexit(print) };
    }
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    skipped.entry(reason.to_string()).or_default().push(test);
}

extern "C" fn print() {
    let skipped = SKIPPED.lock().unwrap_or_else(PoisonError::into_inner);
    let count: usize = skipped.values().map(Vec::len).sum();
    let mut text = format!("skipped tests, which count as passed: {count}\n");
    for (reason, tests) in &*skipped {
        text += &format!("    {reason}: {}\n", tests.join(", "));
    }
    // The harness captures print macros only.
    let _ = std::io::stderr().write_all(text.as_bytes());
}
