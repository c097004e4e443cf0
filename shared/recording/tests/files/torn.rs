//! Recordings that were torn: by a power loss, a full disk, a bad sector or a bad copy.

use std::fs;
use std::path::Path;

use mcap::Summary;
use recording::{Ending, Message, ReadError, Recording};

use crate::support::{messages, written};

/// The chunks of a whole file: first byte, first byte after the chunk, and number of messages.
fn chunks(whole: &[u8]) -> Vec<(usize, usize, usize)> {
    let summary = Summary::read(whole).expect("a whole file").expect("the file has an index");
    let read = |chunk: &mcap::records::ChunkIndex| {
        let messages = summary.read_message_indexes(whole, chunk).expect("the index of a chunk");
        let (at, len) = (chunk.chunk_start_offset as usize, chunk.chunk_length as usize);
        (at, at + len, messages.values().map(Vec::len).sum())
    };
    summary.chunk_indexes.iter().map(read).collect()
}

fn open(path: &Path, bytes: &[u8]) -> Recording {
    fs::write(path, bytes).expect("the file can be written");
    Recording::open(path).expect("a recording")
}

/// Messages of a file, without its damaged parts.
fn read(recording: &Recording) -> Vec<Message> {
    recording.messages().flatten().collect()
}

#[test]
fn zeros_and_garbage_behind_a_cut_leave_all_whole_chunks() {
    let all = messages(60);
    let (folder, path) = written(&all);
    let whole = fs::read(&path).unwrap();
    let chunks = chunks(&whole);
    let torn = folder.path().join("torn.mcap");
    let mut random = 0_u64;
    let mut garbage = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 56) as u8
    };
    for at in (chunks[0].0..whole.len()).step_by(67) {
        // Messages of the whole chunks, and of the chunks that have started.
        let expected = [1, 0].map(|edge| {
            let is_there = |(begin, end, _): &&(usize, usize, usize)| [*begin, *end][edge] <= at;
            chunks.iter().filter(is_there).map(|(.., messages)| messages).sum::<usize>()
        });
        let to_old_len = whole.len() - at;
        let tails = [0, 1, 777, 4096, 5 << 20, to_old_len].map(|len| vec![0; len]);
        let garbage: Vec<u8> = std::iter::repeat_with(&mut garbage).take(to_old_len + 3).collect();
        for tail in tails.into_iter().chain([garbage]) {
            let bytes = [&whole[..at], &tail].concat();
            let recording = open(&torn, &bytes);
            let len = tail.len();
            assert!(!recording.is_complete(), "cut to {at}, {len} bytes behind");
            let found = read(&recording);
            assert!(found == all[..found.len()], "cut to {at}, {len} bytes behind");
            // The bytes that were cut off may have been zeros: then the chunk is whole by its check value.
            let most = if tail.first() == Some(&0) { expected[1] } else { expected[0] };
            assert!((expected[0]..=most).contains(&found.len()), "cut to {at}, {len} bytes behind");
            assert!(recording.damages().is_empty(), "a torn end is no damage");
        }
    }
}

#[test]
fn zeroed_pages_of_the_last_chunk_end_the_recording_before_it() {
    let all = messages(60);
    let (folder, path) = written(&all);
    let whole = fs::read(&path).unwrap();
    let chunks = chunks(&whole);
    let (at, end, last_len) = chunks[chunks.len() - 1];
    // The chunk's length is present, its tail is missing.
    let mut bytes = whole[..end].to_vec();
    bytes[at + 100..].fill(0);
    let recording = open(&folder.path().join("torn.mcap"), &bytes);
    let Ending::Incomplete { at: found_at, why } = recording.ending() else { panic!("it is torn") };
    assert_eq!(*found_at, at as u64);
    assert!(why.starts_with("a chunk"), "{why}");
    assert_eq!(read(&recording), all[..all.len() - last_len]);
    assert!(recording.damages().is_empty());
    bytes.resize(whole.len() + 4096, 0);
    let recording = open(&folder.path().join("torn.mcap"), &bytes);
    assert_eq!((recording.is_complete(), read(&recording)), (false, all[..all.len() - last_len].to_vec()));
}

/// For any place of the hole, also over the length of a chunk: the intact chunks after it are read.
#[test]
fn chunks_behind_a_hole_are_read_and_the_hole_is_named() {
    let all = messages(60);
    let (folder, path) = written(&all);
    let whole = fs::read(&path).unwrap();
    let chunks = chunks(&whole);
    let hurt = folder.path().join("hurt.mcap");
    let (first, last_end) = (chunks[0].0, chunks[chunks.len() - 1].1);
    let mut damaged = 0;
    for (at, has_index) in (first..last_end - 300).step_by(97).flat_map(|at| [(at, true), (at, false)]) {
        let mut bytes = whole[..if has_index { whole.len() } else { last_end }].to_vec();
        let hole = at..at + 300;
        bytes[hole.clone()].fill(0);
        let (mut expected, mut number) = (Vec::new(), 0);
        for (begin, end, len) in &chunks {
            if bytes[*begin..*end] == whole[*begin..*end] {
                expected.extend_from_slice(&all[number..number + len]);
            }
            number += len;
        }
        let recording = open(&hurt, &bytes);
        assert!(read(&recording) == expected, "a hole at {at}, with an index: {has_index}");
        let is_named = recording
            .damages()
            .iter()
            .any(|damage| matches!(damage, ReadError::Damaged { offset, .. } if *offset < hole.end as u64));
        assert!(is_named || !recording.is_complete(), "a hole at {at}, with an index: {has_index}");
        damaged += usize::from(is_named);
    }
    assert!(damaged > 20, "{damaged}");
}

#[test]
fn bytes_behind_a_whole_recording_are_reported() {
    let all = messages(20);
    let (folder, path) = written(&all);
    let whole = fs::read(&path).unwrap();
    for tail in [vec![0; 4096], whole.clone()] {
        let recording = open(&folder.path().join("longer.mcap"), &[whole.clone(), tail].concat());
        let Ending::Incomplete { at, why } = recording.ending() else { panic!("more bytes follow") };
        assert_eq!(*at, whole.len() as u64 - 8);
        assert!(why.contains("more bytes follow"), "{why}");
        assert_eq!(read(&recording), all);
    }
}

/// The record of a chunk that claims to unpack to `len` bytes, with a check value.
fn bomb(len: u64) -> Vec<u8> {
    let mut body = Vec::new();
    [0, 1, len].iter().for_each(|number: &u64| body.extend(number.to_le_bytes()));
    body.extend(0x1234_5678_u32.to_le_bytes());
    body.extend(4_u32.to_le_bytes());
    body.extend(b"zstd");
    // A frame of Zstandard: blocks of 128 KiB of one repeated byte.
    let mut packed = b"\x28\xb5\x2f\xfd\x00\x38".to_vec();
    let blocks = len >> 17;
    for block in 1..=blocks {
        let head = 1_u32 << 20 | 2 | u32::from(block == blocks);
        packed.extend(&head.to_le_bytes()[..3]);
        packed.push(0);
    }
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    let mut record = vec![6];
    record.extend((body.len() as u64).to_le_bytes());
    record.extend(body);
    record
}

#[test]
fn chunks_that_unpack_to_much_more_than_the_file_are_refused() {
    let bombs = bomb(16 << 20).repeat(20);
    let error = recording::bag_messages(&[mcap::MAGIC, &bombs].concat(), |_| Ok::<(), String>(()));
    // Without the limit, the wrong check value of the first chunk is found.
    assert!(error.unwrap_err().contains("check value"));
    let error = recording::bag_messages(&[mcap::MAGIC, &bomb(1 << 29)].concat(), |_| Ok::<(), String>(()));
    assert!(error.unwrap_err().contains("the limit for this file: 67108864 and 255 times its size"));

    let (_folder, path) = written(&messages(3));
    let whole = fs::read(&path).unwrap();
    let torn = [&whole[..whole.len() / 2], &[0; 20], &bombs].concat();
    let whole = [mcap::MAGIC, &bombs, &whole[mcap::MAGIC.len()..]].concat();
    let limit = "the chunks unpack to more than";
    fs::write(&path, torn).unwrap();
    let error = Recording::open(&path).unwrap_err().to_string();
    assert!(error.contains(limit), "{error}");
    let damages = open(&path, &whole).damages();
    assert!(damages.iter().any(|damage| damage.to_string().contains(limit)), "{damages:?}");
}

#[test]
fn metadata_beyond_the_limit_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sparse.mcap");
    let len: u64 = 64 << 30;
    let file = fs::File::create(&path).unwrap();
    let head = [mcap::MAGIC, &[0x0C], &len.to_le_bytes()].concat();
    std::os::unix::fs::FileExt::write_all_at(&file, &head, 0).unwrap();
    file.set_len(head.len() as u64 + len).unwrap();
    let error = Recording::open(&path).unwrap_err().to_string();
    assert!(error.contains("a record of 68719476736 bytes, at most 16777216 are read"), "{error}");
}
