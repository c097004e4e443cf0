use super::*;

/// Maximum relative error of rounding to 8 significant bits, including the leading one.
const ROUNDING: f64 = 1.0 / 256.0;

fn value(i: usize) -> f32 {
    ((i * 37) % 101) as f32 * 0.0213 - 1.03
}

fn proof() -> Option<DotProducts> {
    let proof = Precision::Bf16.dot_products().ok().flatten();
    if proof.is_none() {
        testing::skip("no bf16 dot products with these kernels");
    }
    proof
}

/// Compares products with their definition in double precision, for tiles and panels of every size and for
/// odd lengths.
#[test]
fn products_agree_with_double_precision_within_the_rounding_of_their_factors() {
    let Some(proof) = proof() else { return };
    for (row_count, in_len, out_len) in [(1, 1, 1), (12, 3, 16), (31, 5, 33), (47, 96, 20), (61, 128, 384)] {
        let weight = |out: usize, i: usize| value(out * 7 + i * 3);
        let panels = PairPanels::pack(proof, [out_len, in_len], weight, value);
        let out_stride = panels.out_stride();
        // Extra floats between the rows, which must not affect any result.
        let stride = in_len + 3;
        let input: Vec<f32> = (0..stride * row_count).map(value).collect();
        let residual: Vec<f32> = (0..row_count * out_stride).map(value).collect();
        for relu in [false, true] {
            let mut out = vec![f32::NAN; row_count * out_stride];
            let residual = Some(&residual[..]);
            PairProduct { input: &input, stride, panels: &panels, residual, relu, out: &mut out }.run();
            for (row, out) in out.chunks_exact(out_stride).enumerate() {
                for (o, y) in out[..out_len].iter().enumerate() {
                    let terms =
                        (0..in_len).map(|i| f64::from(input[row * stride + i]) * f64::from(weight(o, i)));
                    let (sum, size) = terms.fold((0.0, 0.0), |(sum, size), x| (sum + x, size + x.abs()));
                    let whole = sum + f64::from(value(o)) + f64::from(value(row * out_stride + o));
                    let expected = if relu { whole.max(0.0) } else { whole };
                    // Both factors are rounded; the f32 sums are a thousand times more accurate.
                    let most = 2.01 * ROUNDING * size + 1e-4;
                    let off = (f64::from(*y) - expected).abs();
                    assert!(off <= most, "[{row}, {o}]: {y}, not {expected}: {off} off, at most {most}");
                }
            }
        }
    }
}

#[test]
fn factors_of_eight_bits_are_multiplied_exactly() {
    let Some(proof) = proof() else { return };
    let whole = |i: usize| ((i * 37) % 255) as f32 - 127.0;
    let panels = PairPanels::pack(proof, [40, 33], |out, i| whole(out * 5 + i), |_| 0.0);
    let input: Vec<f32> = (0..7 * 33).map(|i| whole(i * 3)).collect();
    let mut out = vec![0.0; 7 * panels.out_stride()];
    PairProduct { input: &input, stride: 33, panels: &panels, residual: None, relu: false, out: &mut out }
        .run();
    for (row, out) in out.chunks_exact(panels.out_stride()).enumerate() {
        for (o, y) in out.iter().enumerate() {
            let sum: f32 = (0..33).map(|i| input[row * 33 + i] * whole(o * 5 + i)).sum();
            assert_eq!(*y, if o < 40 { sum } else { 0.0 }, "[{row}, {o}]");
        }
    }
}

/// Covers tiles of all sizes, whole and partial, and more rows than are rounded together.
#[test]
fn a_row_has_the_same_bits_alone_and_in_a_batch() {
    let Some(proof) = proof() else { return };
    let (in_len, rows_max) = (37, 75);
    let panels = PairPanels::pack(proof, [48, in_len], |out, i| value(out * 7 + i * 3), value);
    let input: Vec<f32> = (0..rows_max * in_len).map(value).collect();
    let run = |input: &[f32]| {
        let mut out = vec![0.0_f32; input.len() / in_len * 48];
        PairProduct { input, stride: in_len, panels: &panels, residual: None, relu: false, out: &mut out }
            .run();
        out.into_iter().map(f32::to_bits).collect::<Vec<_>>()
    };
    let alone: Vec<u32> = input.chunks_exact(in_len).flat_map(run).collect();
    for row_count in 1..=rows_max {
        assert_eq!(run(&input[..row_count * in_len]), alone[..row_count * 48], "{row_count} rows");
    }
}

#[test]
fn a_processor_without_dot_products_is_told_what_is_missing() {
    assert_eq!(Precision::F32.check(), Ok(()));
    let checked = Precision::Bf16.check();
    if !available() {
        assert_eq!(checked, Err(PrecisionError::Unavailable));
    }
    let message = PrecisionError::OtherKernels(Isa::Avx2).to_string();
    assert_eq!(
        message,
        "precision bf16 needs the AVX-512 kernels, not AVX2: leave the precision at f32, or use --kernels avx512"
    );
}
