//! Fuzz targets for the content of a weights file: its header, the model's options in it, and its numbers.
//!
//! Each target starts from the embedded model, which the fuzzer edits. Nothing may panic, neither while the
//! file is read nor while layers are built from it. All accepted numbers are finite.
//!
//! `readers.rs` has the command for a longer search.

use nn::{ContextCnn, Decoder, Gdat, RelationMlp, StateMlp, Weights, WeightsError};
use safetensors::Dtype;
use serde_json::{Value, json};
use testing::Model;

/// Iterations of a target in an ordinary test run. Each one reads some megabytes.
const ITERATIONS: usize = 200;
/// Longest list of edits, in bytes.
const EDITS_BYTES_MAX: usize = 24;
/// Bytes before the header, which hold its length.
const LENGTH_BYTES: usize = 8;
/// Texts that often break readers of the header.
const WORDS: [&[u8]; 16] = [
    b"0",
    b"-1",
    b"18446744073709551615",
    b"1e999",
    b"[",
    b"]",
    b"{}",
    b"\"",
    b"\\u0000",
    b",",
    b"\"F16\"",
    b"\"F64\"",
    b"\"data_offsets\":[0,0]",
    b"\"shape\":[]",
    b"null",
    b"\xff",
];

/// Reads a file and builds all layers from a readable one.
fn read(bytes: &[u8]) {
    match Weights::from_bytes(bytes) {
        Ok(weights) => {
            assert!(weights.config().check().is_ok());
            for (name, shape) in weights.shapes() {
                let values = weights.tensor(name, shape).unwrap_or_else(|error| panic!("{name}: {error}"));
                assert_eq!(values.len(), shape.iter().product::<usize>());
                assert!(values.iter().all(|x| x.is_finite()));
            }
            if let Err(error) = build(&weights) {
                assert!(!error.to_string().is_empty());
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn build(weights: &Weights) -> Result<(), WeightsError> {
    StateMlp::new(weights)?;
    RelationMlp::new(weights)?;
    ContextCnn::new(weights)?;
    Gdat::new(weights)?;
    Decoder::new(weights)?;
    Ok(())
}

fn fuzz(edit: impl Fn(&[u8]) -> Vec<u8> + std::panic::RefUnwindSafe) {
    bolero::check!().with_iterations(ITERATIONS).with_max_len(EDITS_BYTES_MAX).for_each(|bytes: &[u8]| {
        read(&edit(bytes));
    });
}

/// Header and numbers of a good file.
fn parts(good: &[u8]) -> (&[u8], &[u8]) {
    read(good);
    let length = u64::from_le_bytes(*good.first_chunk().expect("a length")) as usize;
    good[LENGTH_BYTES..].split_at(length)
}

fn file(length: u64, header: &[u8], data: &[u8]) -> Vec<u8> {
    [&length.to_le_bytes()[..], header, data].concat()
}

/// Edits of four bytes each: position (two bytes), kind, and the byte or word. The header's length matches
/// its content, except in one of eight edits.
#[test]
fn weights_header() {
    let good = Model::onboard().bytes(Dtype::F16);
    let (header, data) = parts(&good);
    fuzz(|edits| {
        let mut header = header.to_vec();
        let mut wrong_length = None;
        for edit in edits.chunks_exact(4) {
            let place = usize::from(u16::from_le_bytes([edit[0], edit[1]])) % (header.len() + 1);
            let word = WORDS[usize::from(edit[3]) % WORDS.len()];
            let end = (place + usize::from(edit[3] % 32)).min(header.len());
            match edit[2] % 8 {
                0 if place < header.len() => header[place] = edit[3],
                1 => header.insert(place, edit[3]),
                2 => drop(header.drain(place..end)),
                3 => drop(header.splice(place..end, word.iter().copied())),
                4 => {
                    let length = [edit[0], edit[1], edit[3], 0, 0, 0, 0, edit[3]];
                    wrong_length = Some(u64::from_le_bytes(length));
                }
                _ => drop(header.splice(place..place, word.iter().copied())),
            }
        }
        file(wrong_length.unwrap_or(header.len() as u64), &header, data)
    });
}

/// The model's options, which determine the layers: one byte selects the option, one its value.
#[test]
fn weights_options() {
    let model = Model::with_all_options();
    let good = model.bytes(Dtype::F16);
    let (header, data) = parts(&good);
    let header: Value = serde_json::from_slice(header).expect("JSON");
    let options: Vec<&String> = model.config.as_object().expect("options").keys().collect();
    let value = |byte: u8, old: &Value| match byte % 12 {
        0 => json!(0),
        1 => json!(-1),
        2 => json!(u64::MAX),
        3 => json!(1e300),
        4 => Value::Null,
        5 => json!([]),
        6 => json!("none"),
        7 => json!(true),
        8 => json!(false),
        9 => json!(f64::from(byte) * 0.1),
        10 => old.as_u64().map_or(json!(1), |old| json!(old.saturating_add(1))),
        _ => json!(byte),
    };
    fuzz(|edits| {
        let mut config = model.config.clone();
        for edit in edits.chunks_exact(2).take(3) {
            let option = options[usize::from(edit[0]) % options.len()];
            config[option] = value(edit[1], &model.config[option]);
        }
        let mut header = header.clone();
        header["__metadata__"]["config"] = Value::String(config.to_string());
        let header = header.to_string();
        file(header.len() as u64, header.as_bytes(), data)
    });
}

/// Shapes and numbers of the tensors: one byte selects the tensor, one the kind of edit, one the number or
/// its index.
#[test]
fn weights_tensors() {
    let good = Model::with_all_options().bytes(Dtype::F16);
    let (header, data) = parts(&good);
    let header: Value = serde_json::from_slice(header).expect("JSON");
    let names: Vec<&String> =
        header.as_object().expect("tensors").keys().filter(|n| *n != "__metadata__").collect();
    // Half precision: not a number, both infinities, the largest number, the smallest above 0, 0, −1 and 1.
    let numbers: [u16; 8] = [0x7E00, 0x7C00, 0xFC00, 0x7BFF, 1, 0, 0xBC00, 0x3C00];
    fuzz(|edits| {
        let (mut header, mut data) = (header.clone(), data.to_vec());
        for edit in edits.chunks_exact(3) {
            let name = names[usize::from(edit[0]) % names.len()];
            let number = numbers[usize::from(edit[2]) % numbers.len()].to_le_bytes();
            let Some(tensor) = header.get_mut(name) else { continue };
            let shape = tensor["shape"].as_array_mut().expect("a shape");
            match edit[1] % 6 {
                0 => drop(header.as_object_mut().expect("tensors").remove(name)),
                1 => shape.reverse(),
                2 => shape.insert(0, json!(1)),
                3 => tensor["dtype"] = json!(["F32", "I64", "BF16", "F8_E5M2"][usize::from(edit[2]) % 4]),
                how => {
                    let offset =
                        |place: usize| tensor["data_offsets"][place].as_u64().expect("an offset") as usize;
                    let values = data[offset(0)..offset(1)].chunks_exact_mut(2);
                    let len = if how == 4 { usize::MAX } else { 1 };
                    values
                        .skip(usize::from(edit[2]))
                        .take(len)
                        .for_each(|value| value.copy_from_slice(&number));
                }
            }
        }
        let header = header.to_string();
        file(header.len() as u64, header.as_bytes(), &data)
    });
}
