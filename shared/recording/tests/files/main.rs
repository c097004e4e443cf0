//! Files of recordings: the written messages are read back from intact and damaged files.

mod rewritten;
mod support;
mod torn;

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::rc::Rc;

use proptest::prelude::*;
use recording::{About, Comparison, Ending, Frame, Message, ReadError, Recording, Sink, Writer};
use wire::{Forecast, ForecastsTopic};

use crate::support::{TICK_NS, about, header, messages, written};

fn read(path: &Path) -> Vec<Message> {
    let recording = Recording::open(path).expect("a recording");
    recording.messages().collect::<Result<_, _>>().expect("whole messages")
}

#[test]
fn what_was_written_is_read_back() {
    let all = messages(60);
    let (_folder, path) = written(&all);
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.about(), &about());
    let how = "the run has ended".to_owned();
    assert_eq!(recording.ending(), &Ending::Complete { how, lost_on_disk: "{}".to_owned() });
    recording.verify().unwrap();
    assert_eq!(read(&path), all);
}

#[test]
fn forecasts_without_their_controls_are_read_and_compared_as_far_as_they_go() {
    let folder = tempfile::tempdir().unwrap();
    let written = |name: &str, lean: bool, control: f32, x_m: f32| {
        let element_bytes = if lean { recording::lean() } else { BTreeMap::new() };
        let path = folder.path().join(name);
        let mut writer = Writer::create(&path, &About { element_bytes, ..about() }, "{}").unwrap();
        for seq in 0..5 {
            let mut forecasts = [0, 1].map(|id| Forecast { id, x_m, ..bytemuck::Zeroable::zeroed() });
            forecasts.iter_mut().for_each(|forecast| forecast.controls[19][11].cholesky[2] = control);
            writer.frame(&Frame::of::<ForecastsTopic>(&header(seq, 2), &forecasts, seq * TICK_NS));
        }
        writer.finish("").unwrap();
        Recording::open(&path).unwrap()
    };
    let [whole, lean] = [written("a.mcap", false, 1.0, 3.0), written("b.mcap", true, 2.0, 3.0)];
    assert!(whole.has_whole("forecasts") && !lean.has_whole("forecasts") && lean.has_topic("forecasts"));
    lean.verify().unwrap();
    let Some(Ok(Message::Frame(frame))) = lean.messages().next() else { panic!("no frame") };
    let forecasts = frame.elements::<ForecastsTopic>().unwrap();
    assert_eq!((forecasts.len(), forecasts[1].id, forecasts[1].x_m), (2, 1, 3.0));
    assert_eq!(forecasts[1].controls[19][11].cholesky[2], 0.0, "not in the file");
    assert!(Comparison::of(&whole, &lean).is_equal(), "what both have is equal");
    let other = written("c.mcap", true, 1.0, 3.5);
    for (a, b) in [(&whole, &other), (&other, &lean)] {
        let found = Comparison::of(a, b);
        assert_eq!(found.first().map(|first| (first.field.as_str(), first.apart())), Some(("[0].x_m", 0.5)));
    }
    let other = written("d.mcap", false, 1.5, 3.0);
    let first = Comparison::of(&whole, &other).first().cloned().unwrap();
    assert!(first.field.contains("controls[19][11].cholesky[2]"), "{first:?}");
}

#[test]
fn a_cut_file_is_read_up_to_its_last_whole_chunk_and_called_incomplete() {
    let all = messages(60);
    let (folder, path) = written(&all);
    let whole = fs::read(&path).unwrap();
    let cut = folder.path().join("cut.mcap");
    let mut found_count = 0;
    // Every position would take long; a prime step reaches all kinds of records.
    let places: Vec<usize> =
        (1..).map(|i| i * whole.len() / 211).take_while(|at| *at < whole.len()).collect();
    assert!(places.len() > 100);
    for at in places {
        fs::write(&cut, &whole[..at]).unwrap();
        let Ok(recording) = Recording::open(&cut) else {
            assert!(at < 4_000, "only without its metadata is it none: cut to {at}");
            continue;
        };
        assert!(!recording.is_complete(), "cut to {at} of {}", whole.len());
        let messages: Vec<Message> = recording.messages().collect::<Result<_, _>>().unwrap();
        assert_eq!(messages, all[..messages.len()], "cut to {at}");
        assert!(messages.len() >= found_count, "a longer file has no fewer messages");
        found_count = messages.len();
    }
    assert_eq!(found_count, all.len(), "the index alone was cut off last");
}

#[test]
fn a_flipped_bit_is_found_wherever_it_is() {
    let (folder, path) = written(&messages(20));
    let whole = fs::read(&path).unwrap();
    let hurt = folder.path().join("hurt.mcap");
    for at in (0..whole.len()).step_by(13) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        fs::write(&hurt, &bytes).unwrap();
        let is_found = match Recording::open(&hurt) {
            Err(_) => true,
            Ok(recording) => !recording.is_complete() || recording.verify().is_err(),
        };
        assert!(is_found, "byte {at} of {}", whole.len());
    }
}

#[test]
fn a_damaged_chunk_is_named_and_the_next_ones_are_read() {
    let all = messages(60);
    let (_folder, path) = written(&all);
    let mut bytes = fs::read(&path).unwrap();
    // The first chunk starts after the channels, and its content after its sizes.
    let lz4 = b"\x03\0\0\0lz4";
    let first = bytes.windows(lz4.len()).position(|window| window == lz4).unwrap();
    bytes[first + 60] ^= 0x10;
    fs::write(&path, &bytes).unwrap();
    let recording = Recording::open(&path).unwrap();
    let results: Vec<_> = recording.messages().collect();
    let Some(Err(ReadError::Damaged { offset, .. })) = results.first() else {
        panic!("{:?}", results.first())
    };
    assert!((*offset as usize) < first);
    let rest: Vec<Message> = results.into_iter().skip(1).map(Result::unwrap).collect();
    assert!(!rest.is_empty() && all.ends_with(&rest));
}

/// A disk that refuses its third and fourth block.
#[derive(Default)]
struct Disk {
    block_count: usize,
    bytes: u64,
    /// Number of blocks when the writer last waited for the disk.
    synced: Rc<Cell<usize>>,
}

impl Sink for Disk {
    fn append(&mut self, block: &[u8]) -> io::Result<()> {
        self.block_count += 1;
        if (3..5).contains(&self.block_count) {
            return Err(ErrorKind::StorageFull.into());
        }
        self.bytes += block.len() as u64;
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        self.synced.set(self.block_count);
        Ok(())
    }
}

#[test]
fn the_end_of_a_file_waits_for_the_disk() {
    let disk = Disk { block_count: 9, ..Disk::default() };
    let synced = disk.synced.clone();
    let mut writer = Writer::over(disk, &about(), "{}", None).unwrap();
    messages(4).iter().for_each(|message| writer.add(message));
    assert_eq!(synced.get(), 0, "no message waits for it");
    writer.finish("over").unwrap();
    assert!(synced.get() > 10, "after the last block");
}

#[test]
fn what_a_full_disk_did_not_take_is_counted_in_the_file() {
    let all = messages(75);
    let mut writer = Writer::over(Disk::default(), &about(), "{}", None).unwrap();
    all.iter().for_each(|message| writer.add(message));
    assert!(matches!(writer.take_error(), Some(error) if error.kind() == ErrorKind::StorageFull));
    let written = writer.finish("over").unwrap();
    let lost: u64 = written.lost.values().sum();
    assert!(lost > 20 && written.lost["forecasts"] > 5, "{written:?}");
    let events_of_loss = written.lost.len() as u64;
    assert_eq!(written.messages, all.len() as u64 - lost + events_of_loss, "{written:?}");
}

#[test]
fn other_files_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let refusal = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        Recording::open(&path).unwrap_err().to_string()
    };
    assert!(refusal(b"id,x,y\n").ends_with("a.mcap: not an MCAP file"));
    assert!(refusal(b"\x89MCAP0\r\n").contains("no metadata \"stgdat.run\""));
    let foreign = About { schema: 1, program: "stgdat 0.0.1".to_owned(), ..about() };
    fs::remove_file(&path).unwrap();
    Writer::create(&path, &foreign, "{}").unwrap().finish("").unwrap();
    let bytes = fs::read(&path).unwrap();
    let text = refusal(&bytes);
    assert!(text.contains("wire schema 1") && text.contains("stgdat 0.0.1"), "{text}");
    fs::write(&path, "kept").unwrap();
    let error = Writer::create(&path, &about(), "{}").unwrap_err().to_string();
    assert!(error.contains("a.mcap") && error.contains("not replaced"), "{error}");
    assert_eq!(fs::read(&path).unwrap(), b"kept");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// For any bytes after a valid start, reading gives an end or an error and does not panic.
    #[test]
    fn any_bytes_are_read_without_a_panic(tail in prop::collection::vec(any::<u8>(), 0..600), cut in 0_usize..20_000) {
        let (folder, path) = written(&messages(4));
        let mut bytes = fs::read(&path).unwrap();
        bytes.truncate(cut);
        bytes.extend(tail);
        let hurt = folder.path().join("hurt.mcap");
        fs::write(&hurt, &bytes).unwrap();
        if let Ok(recording) = Recording::open(&hurt) {
            let _ = recording.verify();
            let _ = recording.messages().count();
        }
    }
}
