//! The noise of measurements against an independent implementation in float64, `reference/noise.py`.

use filters::noise::{Measured, Scale, Window};

const GAP_MAX_NS: u64 = 1_100_000_000;

#[test]
fn contrasts_and_scale_equal_the_reference() {
    let mut window = Window::<2, 4>::new();
    let mut scale = Scale::new(1.0, 0.1, 25.0);
    let mut compared = 0;
    for line in include_str!("reference/noise.csv").lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |column: usize| cells[column].parse::<f64>().expect("a number");
        let time_ns = cells[0].parse().expect("a time");
        let measured = Measured { time_ns, value: [number(1), number(2)], sigma: number(3) };
        let found = window.add(measured, GAP_MAX_NS, u64::MAX);
        assert_eq!(found.is_some(), !cells[4].is_empty(), "{line}");
        for (contrast, column) in found.into_iter().flatten().zip([4, 5]) {
            let expected = number(column);
            assert!((contrast - expected).abs() < 1e-9 * expected.abs().max(1.0), "{contrast}: {line}");
            scale.add(contrast);
            compared += 1;
        }
        assert!((scale.variance() / number(6) - 1.0).abs() < 1e-9, "{}: {line}", scale.variance());
    }
    assert!(compared > 100, "{compared}");
}
