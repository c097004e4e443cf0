use super::*;

fn value(i: usize) -> f32 {
    ((i * 37) % 101) as f32 * 0.02 - 1.0
}

/// Compares products with a matrix's rows and columns with their definition, for tiles and panels of every
/// size.
#[test]
fn rows_and_columns_agree_with_the_definition() {
    for (row_count, in_len, out_len) in [(1, 1, 1), (12, 3, 16), (31, 5, 33), (47, 96, 20), (6, 40, 64)] {
        let weight = |out: usize, i: usize| value(out * 7 + i * 3);
        let panels = Panels::pack([out_len, 1, in_len], |out, _, i| weight(out, i), value);
        let out_stride = panels.out_stride();
        let residual: Vec<f32> = (0..row_count * out_stride).map(value).collect();
        for across in [false, true] {
            // Extra floats between the rows, which must not affect any result.
            let stride = 3 + if across { row_count } else { in_len };
            let input: Vec<f32> = (0..stride * row_count.max(in_len)).map(value).collect();
            let gather = if across { Gather::Columns { stride } } else { Gather::Rows { stride } };
            let mut out = vec![0.0; row_count * out_stride];
            let residual = Some(&residual[..]);
            Product { input: &input, gather, panels: &panels, residual, relu: false, out: &mut out }.run();
            for (row, out) in out.chunks_exact(out_stride).enumerate() {
                for (o, y) in out[..out_len].iter().enumerate() {
                    let x = |i: usize| input[if across { i * stride + row } else { row * stride + i }];
                    let sum: f32 = (0..in_len).map(|i| x(i) * weight(o, i)).sum();
                    let expected = sum + value(o) + value(row * out_stride + o);
                    assert!((y - expected).abs() < 1e-4, "{across} [{row}, {o}]: {y}, not {expected}");
                }
            }
        }
    }
}

#[test]
#[should_panic(expected = "columns of input")]
fn columns_beyond_the_input_are_refused() {
    let panels = Panels::pack([16, 1, 4], |_, _, _| 1.0, |_| 0.0);
    let (input, mut out) = ([0.0; 4 * 8 - 1], [0.0; 8 * 16]);
    let gather = Gather::Columns { stride: 8 };
    Product { input: &input, gather, panels: &panels, residual: None, relu: false, out: &mut out }.run();
}

/// Covers tiles of all sizes, whole and partial, in whole panels and in a last panel that is half padding.
#[test]
fn a_row_has_the_same_bits_alone_and_in_a_batch() {
    let (in_len, rows_max) = (37, 31);
    let input: Vec<f32> = (0..rows_max * in_len).map(value).collect();
    let pack = |out_len| Panels::pack([out_len, 1, in_len], |out, _, i| value(out * 7 + i * 3), value);
    let run = |panels: &Panels, input: &[f32]| {
        let mut out = vec![f32::NAN; input.len() / in_len * 48];
        let gather = Gather::Rows { stride: in_len };
        Product { input, gather, panels, residual: None, relu: false, out: &mut out }.run();
        out.into_iter().map(f32::to_bits).collect::<Vec<_>>()
    };
    let whole = pack(48);
    for out_len in [48, 40, 37] {
        let panels = pack(out_len);
        let mut alone: Vec<u32> = input.chunks_exact(in_len).flat_map(|row| run(&whole, row)).collect();
        alone.chunks_exact_mut(48).for_each(|row| row[out_len..].fill(0));
        for row_count in 1..=rows_max {
            let batch = run(&panels, &input[..row_count * in_len]);
            assert_eq!(batch, alone[..row_count * 48], "{row_count} rows, {out_len} outputs");
        }
    }
}
