//! The options of the bridge: in pipeline.toml as `options = { … }` of its stages, and as arguments of
//! `stgdat bridge`.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use run::Conflict;
use serde::Deserialize;
use thiserror::Error;

use crate::auth::{Key, KeyError};
use crate::frame::Kind;
use crate::frame::forecasts::MODES_SENT_MAX;
use crate::receiver::Link;
use crate::socket::Address;

/// Fewest modes of an agent.
const MODES_SENT_MIN: usize = 3;
/// Limits of the time without a frame.
const TIMEOUT_MS: std::ops::RangeInclusive<u64> = 50..=60_000;
/// Defaults.
const TIMEOUT_DEFAULT_MS: u64 = 1_000;
const MAX_AGE_DEFAULT_MS: u64 = 500;

/// What both ends need.
#[derive(Clone, Debug, Args)]
pub struct Protection {
    /// File with the key of both ends, which only its owner can read (mode 0600)
    #[arg(long, value_name = "FILE")]
    pub key: Option<PathBuf>,
    /// Without a key over TCP: a tunnel such as WireGuard protects the link
    #[arg(long, conflicts_with = "key")]
    pub tunnel: bool,
    /// Time without a sign of the other end after which the link is lost, in ms, from 50 to 60000
    #[arg(long = "timeout", value_name = "MS", default_value_t = TIMEOUT_DEFAULT_MS, value_parser = clap::value_parser!(u64).range(50..=60_000))]
    pub timeout_ms: u64,
}

/// What a receiver needs besides.
#[derive(Clone, Debug, Args)]
pub struct Ages {
    /// Discard frames that may be older than this when they arrive, in ms
    #[arg(long = "max-age", value_name = "MS", default_value_t = MAX_AGE_DEFAULT_MS)]
    pub max_age_ms: u64,
    /// The sender's Unix time minus this host's, in ns, if PTP provides it: ages are then exact; otherwise
    /// clocks are not compared, and ages are upper bounds
    #[arg(long = "clock-offset", value_name = "NS", allow_negative_numbers = true)]
    pub clock_offset_ns: Option<i64>,
}

/// Why a link can't be used.
#[derive(Debug, Error)]
pub enum LinkOptionError {
    /// The key can't be read.
    #[error("the key: {0}")]
    Key(#[from] KeyError),
    /// Nothing would protect the link.
    #[error(
        "{0}: a link over TCP needs a key; without one, state that a tunnel such as WireGuard protects it (`tunnel`)"
    )]
    Unprotected(Address),
}

impl Protection {
    /// The key for a link.
    ///
    /// # Errors
    /// [`LinkOptionError`] if the key can't be read, or a link over TCP has neither key nor tunnel.
    pub fn key(&self, address: &Address) -> Result<Key, LinkOptionError> {
        match (&self.key, address) {
            (Some(path), _) => Ok(Key::read(path)?),
            (None, Address::Tcp(_)) if !self.tunnel => Err(LinkOptionError::Unprotected(address.clone())),
            (None, _) => Ok(Key::none()),
        }
    }

    /// The time limit.
    #[must_use]
    pub const fn timeout(&self) -> Duration {
        Duration::from_millis(self.timeout_ms)
    }

    /// The link of a receiver.
    ///
    /// # Errors
    /// As [`Protection::key`].
    pub fn link(&self, address: Address, kind: Kind, ages: &Ages) -> Result<Link, LinkOptionError> {
        let (key, timeout) = (self.key(&address)?, self.timeout());
        let max_age = Duration::from_millis(ages.max_age_ms);
        Ok(Link { address, kind, key, timeout, max_age, clock_offset_ns: ages.clock_offset_ns })
    }
}

/// What may be set of the stages.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Where the sender of detections listens.
    pub connect: Option<Address>,
    /// Where the stage with forecasts listens.
    pub listen: Option<Address>,
    /// As [`Protection::key`].
    pub key: Option<PathBuf>,
    /// As [`Protection::tunnel`].
    pub tunnel: bool,
    /// As [`Protection::timeout_ms`].
    pub timeout_ms: u64,
    /// As [`Ages::max_age_ms`].
    pub max_age_ms: u64,
    /// As [`Ages::clock_offset_ns`].
    pub clock_offset_ns: Option<i64>,
    /// Number of modes of an agent.
    pub modes: usize,
    /// Number of ticks after which the source ends.
    pub ticks: Option<u64>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            connect: None,
            listen: None,
            key: None,
            tunnel: false,
            timeout_ms: TIMEOUT_DEFAULT_MS,
            max_age_ms: MAX_AGE_DEFAULT_MS,
            clock_offset_ns: None,
            modes: MODES_SENT_MIN,
            ticks: None,
        }
    }
}

impl Options {
    /// Refuses values that the command line refuses, too.
    ///
    /// # Errors
    /// [`Conflict`] names the option.
    pub fn check(&self) -> Result<(), Conflict> {
        let refuse = |key, reason| Err(Conflict { key, reason, because: "" });
        if !TIMEOUT_MS.contains(&self.timeout_ms) {
            return refuse("timeout_ms", "`timeout_ms` is out of range: expected 50 to 60000");
        }
        if !(MODES_SENT_MIN..=MODES_SENT_MAX).contains(&self.modes) {
            return refuse("modes", "`modes` is out of range: expected 3 to 5");
        }
        if self.tunnel && self.key.is_some() {
            return refuse("tunnel", "`tunnel` is set although there is a `key`");
        }
        Ok(())
    }

    /// As [`Options::check`], for the source.
    ///
    /// # Errors
    /// [`Conflict`] names the option.
    pub fn check_source(&self) -> Result<(), Conflict> {
        let reason = "`connect` is missing: the address of the sender of detections";
        self.connect.as_ref().ok_or(Conflict { key: "connect", reason, because: "" })?;
        self.check()
    }

    /// As [`Options::check`], for the stage with forecasts.
    ///
    /// # Errors
    /// [`Conflict`] names the option.
    pub fn check_output(&self) -> Result<(), Conflict> {
        let reason = "`listen` is missing: the address for other boxes";
        self.listen.as_ref().ok_or(Conflict { key: "listen", reason, because: "" })?;
        self.check()
    }

    /// The protection of the link.
    #[must_use]
    pub fn protection(&self) -> Protection {
        Protection { key: self.key.clone(), tunnel: self.tunnel, timeout_ms: self.timeout_ms }
    }

    /// The limits of a receiver.
    #[must_use]
    pub const fn ages(&self) -> Ages {
        Ages { max_age_ms: self.max_age_ms, clock_offset_ns: self.clock_offset_ns }
    }
}

/// Parses the number of modes.
///
/// # Errors
/// The expected range.
pub fn modes(text: &str) -> Result<usize, String> {
    let number = text.parse().ok().filter(|number| (MODES_SENT_MIN..=MODES_SENT_MAX).contains(number));
    number.ok_or_else(|| format!("expected {MODES_SENT_MIN} to {MODES_SENT_MAX}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused() {
        assert_eq!(Options::default().check(), Ok(()));
        let wrong = [
            Options { timeout_ms: 49, ..Options::default() },
            Options { timeout_ms: 60_001, ..Options::default() },
            Options { modes: 2, ..Options::default() },
            Options { modes: 6, ..Options::default() },
            Options { tunnel: true, key: Some("a".into()), ..Options::default() },
        ];
        for options in wrong {
            assert!(options.check().is_err(), "{options:?}");
        }
        assert_eq!(Options::default().check_source().map_err(|refused| refused.key), Err("connect"));
        assert_eq!(Options::default().check_output().map_err(|refused| refused.key), Err("listen"));
    }

    #[test]
    fn a_link_over_tcp_needs_a_key_or_a_tunnel() {
        let [tcp, unix]: [Address; 2] = ["127.0.0.1:1", "/run/a"].map(|text| text.parse().unwrap());
        let none = Options::default().protection();
        assert!(matches!(none.key(&tcp), Err(LinkOptionError::Unprotected(_))));
        assert!(none.key(&unix).is_ok());
        assert!(Protection { tunnel: true, ..none.clone() }.key(&tcp).is_ok());
        let missing = Protection { key: Some("/nowhere/key".into()), ..none };
        assert!(matches!(missing.key(&unix), Err(LinkOptionError::Key(_))));
    }
}
