//! Decimal seconds as whole nanoseconds.

use crate::ReadError;
use crate::text::Field;

/// Largest stamp: more than a century, with room for arithmetic in nanoseconds.
const SECONDS_MAX: i128 = 4_000_000_000;
/// Decimal digits of a second in nanoseconds.
const DECIMALS: i64 = 9;
/// Maximum number of digits of a number.
const DIGITS_MAX: usize = 60;

/// A number of seconds such as `12.08`, `1.7e9` or `0.30000000000000004`, to the nearest nanosecond, without
/// floating point.
pub(crate) fn stamp_ns(field: Field<'_>) -> Result<i64, ReadError> {
    let wrong = || field.error("expected seconds like 12.08");
    let (negative, number) = match field.text.strip_prefix('-') {
        Some(number) => (true, number),
        None => (false, field.text.strip_prefix('+').unwrap_or(field.text)),
    };
    let (mantissa, exponent) = number.split_once(['e', 'E']).unwrap_or((number, "0"));
    let exponent = exponent.parse::<i64>().ok().filter(|exponent| exponent.abs() <= 99).ok_or_else(wrong)?;
    let (whole, decimals) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let digits = [whole, decimals].concat();
    if digits.is_empty() || digits.len() > DIGITS_MAX || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(wrong());
    }
    // The digits up to the nanosecond, and the next digit, which rounds.
    let kept = whole.len() as i64 + exponent + DECIMALS;
    let digit = |place: i64| {
        let place = usize::try_from(place).ok();
        place.and_then(|place| digits.as_bytes().get(place)).map_or(0, |byte| i128::from(byte - b'0'))
    };
    let mut nanoseconds = 0_i128;
    for place in 0..kept {
        nanoseconds = nanoseconds * 10 + digit(place);
        if nanoseconds > SECONDS_MAX * 1_000_000_000 {
            return Err(beyond(field, number));
        }
    }
    nanoseconds += i128::from(digit(kept) >= 5);
    if nanoseconds > SECONDS_MAX * 1_000_000_000 {
        return Err(beyond(field, number));
    }
    let stamp_ns = i64::try_from(nanoseconds).map_err(|_| wrong())?;
    Ok(if negative { -stamp_ns } else { stamp_ns })
}

/// The error of a stamp beyond [`SECONDS_MAX`]. It names the unit if the stamp is a time since 1970 in another one.
fn beyond(field: Field<'_>, number: &str) -> ReadError {
    let value: f64 = number.parse().unwrap_or(0.0);
    let units = [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)];
    let unit = units.into_iter().find(|(_, per_s)| (1e9..=SECONDS_MAX as f64).contains(&(value / per_s)));
    let remedy = unit.map(|(name, per_s)| format!(": it looks like {name}, divide it by {per_s:.0}"));
    field.error(format!("beyond ±{SECONDS_MAX} s{}", remedy.unwrap_or_default()))
}
