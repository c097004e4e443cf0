use serde::Serialize;

/// The deviation of numbers from their reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The tensor's name in the folder. For tracking, the file and the quantity in it.
    pub name: String,
    /// The shape.
    pub shape: Vec<usize>,
    /// The largest magnitude.
    pub largest: f64,
    /// Largest error. For a model it is relative to `largest`, and for covariances to the largest entry of
    /// each matrix. For tracking it is relative to a number above 1 and otherwise absolute.
    pub error: f64,
    /// Position of the number with this error, one index per dimension.
    pub worst: Vec<usize>,
    /// Largest accepted error.
    pub tolerance: f64,
}

impl Comparison {
    /// Compares numbers with the given magnitudes and errors. A NaN error counts as infinite.
    pub(super) fn new(
        name: String,
        shape: Vec<usize>,
        numbers: impl Iterator<Item = f64>,
        errors: impl Iterator<Item = f64>,
        tolerance: f64,
    ) -> Self {
        let (mut worst, mut error) = (0, 0.0);
        for (at, off) in errors.enumerate() {
            let off = if off.is_nan() { f64::INFINITY } else { off };
            if off > error {
                (worst, error) = (at, off);
            }
        }
        let largest = numbers.fold(0.0_f64, |most, number| most.max(number.abs()));
        Self { worst: indices(&shape, worst), name, shape, largest, error, tolerance }
    }

    /// Whether the numbers are reproduced.
    pub fn agrees(&self) -> bool {
        self.error <= self.tolerance
    }
}

/// The index per dimension of the number at a place in memory. The last index moves fastest.
fn indices(shape: &[usize], mut at: usize) -> Vec<usize> {
    let mut indices = vec![0; shape.len()];
    for (index, len) in indices.iter_mut().zip(shape).rev() {
        (*index, at) = (at % len.max(&1), at / len.max(&1));
    }
    indices
}

#[cfg(test)]
mod tests {
    use super::Comparison;

    fn comparison(numbers: &[f64], errors: &[f64]) -> Comparison {
        let (numbers, errors) = (numbers.iter().copied(), errors.iter().copied());
        Comparison::new("some".to_owned(), vec![2, 3], numbers, errors, 1e-3)
    }

    #[test]
    fn the_largest_magnitude_ignores_signs() {
        assert_eq!(comparison(&[1.0, -3.0, f64::NAN, 2.0], &[]).largest, 3.0);
        assert_eq!(comparison(&[], &[]).largest, 0.0);
    }

    #[test]
    fn the_worst_number_is_found() {
        let off = comparison(&[], &[0.0, 1e-4, 0.0, 0.0, 0.2, 0.1]);
        assert_eq!((off.error, off.worst.as_slice(), off.agrees()), (0.2, [1, 1].as_slice(), false));
        assert!(comparison(&[], &[1e-4; 6]).agrees());
    }

    #[test]
    fn what_is_no_number_does_not_agree() {
        let off = comparison(&[], &[0.0, 0.0, f64::NAN, 7.0, 0.0, 0.0]);
        assert_eq!((off.error, off.worst.as_slice()), (f64::INFINITY, [0, 2].as_slice()));
    }
}
