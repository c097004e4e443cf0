//! Numbers and bars of the report and the live table.

/// A bar of `width` cells, filled to `share` in steps of an eighth of a cell. Above 1 it ends in an arrow.
#[must_use]
pub fn bar(share: f64, width: usize) -> String {
    const PARTS: [char; 8] = [' ', '▏', '▎', '▍', '▌', '▋', '▊', '▉'];
    if share > 1.0 {
        return "█".repeat(width.saturating_sub(1)) + "▶";
    }
    let eighths = (share.max(0.0) * (width * 8) as f64).round() as usize;
    let mut bar = "█".repeat(eighths / 8);
    if !eighths.is_multiple_of(8) {
        bar.push(PARTS[eighths % 8]);
    } else if eighths == 0 && share > 0.0 && width > 0 {
        bar.push(PARTS[1]);
    }
    let rest = width - bar.chars().count();
    bar + &"·".repeat(rest)
}

/// The number of rows of this kind. A kind that begins with *with* names values that count as unknown; the rows
/// themselves are used. Rows of other kinds are left out.
#[must_use]
pub fn rows(kind: &str, rows: u64) -> String {
    let rows = count(rows);
    if kind.starts_with("with ") {
        format!("{rows} rows {kind}")
    } else {
        format!("{rows} rows left out ({kind})")
    }
}

/// Three significant digits and at most three decimals; `–` if unknown.
#[must_use]
pub fn number(value: Option<f64>) -> String {
    match value {
        None => "–".to_owned(),
        Some(v) if v.abs() < 0.0995 => format!("{v:.3}"),
        Some(v) if v.abs() < 9.995 => format!("{v:.2}"),
        Some(v) if v.abs() < 99.95 => format!("{v:.1}"),
        Some(v) => format!("{v:.0}"),
    }
}

/// A share in percent; `–` if unknown.
#[must_use]
pub fn percent(share: Option<f64>) -> String {
    match share.map(|share| share * 100.0) {
        None => "–".to_owned(),
        Some(p) if p > 0.0 && p < 9.95 => format!("{p:.1} %"),
        Some(p) => format!("{p:.0} %"),
    }
}

/// A number in subscript digits, as in minADE₂₀.
#[must_use]
pub fn subscript(number: u32) -> String {
    const DIGITS: [char; 10] = ['₀', '₁', '₂', '₃', '₄', '₅', '₆', '₇', '₈', '₉'];
    number.to_string().chars().filter_map(|digit| Some(DIGITS[digit.to_digit(10)? as usize])).collect()
}

/// A count with commas between thousands.
#[must_use]
pub fn count(count: u64) -> String {
    let digits = count.to_string();
    let mut grouped = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_fill_in_eighths_and_keep_their_width() {
        assert_eq!(bar(0.5, 4), "██··");
        assert_eq!(bar(0.406_25, 4), "█▋··");
        assert_eq!(bar(0.0, 3), "···");
        assert_eq!(bar(0.001, 3), "▏··", "small shares are visible");
        assert_eq!(bar(1.0, 3), "███");
        assert_eq!(bar(1.01, 3), "██▶");
        for share in (0..=120).map(|i| f64::from(i) / 100.0) {
            assert_eq!(bar(share, 13).chars().count(), 13);
        }
    }

    #[test]
    fn numbers_have_three_significant_digits() {
        let shown = [0.0, 0.052, 9.994, 9.996, 12.34, 99.96, 1234.5].map(|v| number(Some(v)));
        assert_eq!(shown, ["0.000", "0.052", "9.99", "10.0", "12.3", "100", "1234"]);
        assert_eq!(number(None), "–");
    }

    #[test]
    fn shares_counts_and_subscripts_are_formatted() {
        assert_eq!([0.0, 0.031, 0.5, 1.0].map(|s| percent(Some(s))), ["0 %", "3.1 %", "50 %", "100 %"]);
        assert_eq!(subscript(20), "₂₀");
        assert_eq!([0, 999, 1_000, 1_234_567].map(count), ["0", "999", "1,000", "1,234,567"]);
    }
}
