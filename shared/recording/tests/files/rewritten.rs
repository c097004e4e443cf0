//! Recordings that other programs rewrote: everything that the MCAP specification allows is read.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write as _};

use lz4_flex::frame::FrameEncoder;
use mcap::records::{MessageHeader, Metadata, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Attachment, MAGIC, WriteOptions};
use recording::{Comparison, Message, Recording};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use crate::support::{messages, written};

/// The records of a file, with chunks as they are.
fn records(file: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut reader = LinearReader::new_with_options(LinearReaderOptions::default().with_emit_chunks(true));
    let (mut rest, mut records) = (file, Vec::new());
    while let Some(event) = reader.next_event() {
        match event.expect("a whole file") {
            LinearReadEvent::Record { opcode, data } => records.push((opcode, data.to_vec())),
            LinearReadEvent::ReadRequest(len) => {
                let (now, later) = rest.split_at(len.min(rest.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
        }
    }
    records
}

/// Options of a rewriting program.
#[derive(Clone, Debug)]
struct Rewrite {
    options: WriteOptions,
    /// Groups the messages by topic.
    by_topic: bool,
    /// Attachments, metadata, private records and a topic of another program among the messages.
    extras: bool,
}

/// Writes a recording again, with channels of other numbers inside the chunks.
fn rewrite(file: &[u8], Rewrite { options, by_topic, extras }: Rewrite) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).expect("a file");
    let mut all: Vec<_> = mcap::MessageStream::new(&decompressed(file))
        .expect("a file")
        .map(|message| message.expect("a message"))
        .collect();
    if by_topic {
        all.sort_by_key(|message| std::cmp::Reverse(message.channel.topic.clone()));
    }
    let metadata = records(file).into_iter().filter_map(|(op, body)| match mcap::parse_record(op, &body) {
        Ok(Record::Metadata(metadata)) => Some(metadata),
        _ => None,
    });
    let metadata: Vec<Metadata> = metadata.collect();
    writer.write_metadata(&metadata[0]).expect("a file");
    for (number, message) in all.iter().enumerate() {
        if extras && number % 10 == 3 {
            let (name, media_type) = ("notes".to_owned(), "text/plain".to_owned());
            let data = Cow::Borrowed(&b"\x06 no chunk"[..]);
            let attachment = Attachment { log_time: 0, create_time: 0, name, media_type, data };
            writer.attach(&attachment).expect("a file");
            let metadata = Metadata { name: "other".to_owned(), metadata: BTreeMap::new() };
            writer.write_metadata(&metadata).expect("a file");
        }
        if extras {
            let schema = writer.add_schema("other", "jsonschema", b"{}").expect("a file");
            let camera = writer.add_channel(schema, "camera", "jpeg", &BTreeMap::new()).expect("a file");
            let (log_time, publish_time, sequence) = (message.log_time, 0, 0);
            let header = MessageHeader { channel_id: camera, sequence, log_time, publish_time };
            writer.write_to_known_channel(&header, b"\xFF\xD8").expect("a file");
        }
        let channel = &message.channel;
        let schema = channel.schema.as_ref().expect("a schema");
        let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data).expect("a file");
        let added = writer.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata);
        let (channel_id, sequence) = (added.expect("a file"), message.sequence);
        let (log_time, publish_time) = (message.log_time, message.publish_time);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        writer.write_to_known_channel(&header, &message.data).expect("a file");
    }
    writer.write_metadata(&metadata[1]).expect("a file");
    writer.finish().expect("a file");
    writer.into_inner().into_inner()
}

/// The records in a new file, with chunks as `chunk` makes them, and without an index.
fn with_chunks(file: &[u8], chunk: impl Fn(&[u8]) -> (&'static str, Vec<u8>)) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    for (op, body) in records(file) {
        let body = match mcap::parse_record(op, &body) {
            Ok(Record::Chunk { header, data }) => {
                let plain = match header.compression.as_str() {
                    "" => data.to_vec(),
                    _ => lz4_flex_decompress(&data),
                };
                let (name, packed) = chunk(&plain);
                let (times, lengths) = (&body[..16], header.uncompressed_size.to_le_bytes());
                let [name_len, packed_len] = [name.len() as u64, packed.len() as u64].map(u64::to_le_bytes);
                let crc = header.uncompressed_crc.to_le_bytes();
                let head = [times, &lengths, &crc, &name_len[..4], name.as_bytes(), &packed_len];
                [&head.concat(), &packed[..]].concat()
            }
            Ok(Record::Footer(_)) => vec![0; 20],
            _ => body,
        };
        let is_index =
            matches!(op, op::CHUNK_INDEX | op::STATISTICS | op::METADATA_INDEX | op::SUMMARY_OFFSET);
        let is_end = op == op::DATA_END;
        if is_index || op == op::MESSAGE_INDEX {
            continue;
        }
        if op == op::CHUNK {
            // A record of a kind that is reserved for other programs.
            out.extend([0x99, 3, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3]);
        }
        out.push(op);
        out.extend((body.len() as u64).to_le_bytes());
        // No check value of the data.
        out.extend(if is_end { vec![0; body.len()] } else { body });
    }
    out.extend(MAGIC);
    out
}

fn lz4_flex_decompress(packed: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    std::io::Read::read_to_end(&mut lz4_flex::frame::FrameDecoder::new(packed), &mut plain).expect("LZ4");
    plain
}

/// The same file with uncompressed chunks: without its C libraries the crate reads no others.
fn decompressed(file: &[u8]) -> Vec<u8> {
    with_chunks(file, |plain| ("", plain.to_vec()))
}

fn lz4(plain: &[u8]) -> (&'static str, Vec<u8>) {
    let mut encoder = FrameEncoder::new(Vec::new());
    encoder.write_all(plain).expect("memory");
    ("lz4", encoder.finish().expect("memory"))
}

fn zstd(plain: &[u8]) -> (&'static str, Vec<u8>) {
    ("zstd", compress_to_vec(plain, CompressionLevel::Fastest))
}

#[test]
fn whatever_the_specification_allows_is_read() {
    let all = messages(60);
    let (folder, path) = written(&all);
    let (original, whole) = (Recording::open(&path).unwrap(), fs::read(&path).unwrap());
    let chunks = |bytes| WriteOptions::new().compression(None).chunk_size(Some(bytes));
    let no_index = |options: WriteOptions| options.emit_summary_records(false).emit_summary_offsets(false);
    let no_checks = |options: WriteOptions| {
        let options = options.calculate_chunk_crcs(false).calculate_data_section_crc(false);
        options.calculate_summary_section_crc(false)
    };
    let loose = WriteOptions::new().compression(None).use_chunks(false);
    let options = [
        ("small chunks", chunks(10_000)),
        ("one chunk", chunks(1 << 30)),
        ("no chunks", loose.clone()),
        ("chunks without an index", no_index(chunks(100_000))),
        ("no chunks and no index", no_index(loose)),
        ("no check values", no_checks(chunks(100_000))),
        ("no indexes of messages", chunks(100_000).emit_message_indexes(false)),
        ("channels in chunks alone", chunks(100_000).repeat_channels(false).repeat_schemas(false)),
    ];
    let other = folder.path().join("other.mcap");
    for (name, options) in options {
        for (by_topic, extras) in [(false, false), (true, false), (false, true), (true, true)] {
            let name = format!("{name}, by topic: {by_topic}, extras: {extras}");
            let plain = rewrite(&whole, Rewrite { options: options.clone(), by_topic, extras });
            let packed = [with_chunks(&plain, lz4), with_chunks(&plain, zstd)];
            for bytes in [plain].into_iter().chain(packed) {
                fs::write(&other, &bytes).unwrap();
                let recording = Recording::open(&other).unwrap_or_else(|error| panic!("{name}: {error}"));
                assert!(recording.is_complete(), "{name}: {:?}", recording.ending());
                assert!(recording.damages().is_empty(), "{name}: {:?}", recording.damages());
                let found: Vec<Message> = recording.messages().map(Result::unwrap).collect();
                assert!(found == all, "{name}: {} of {} messages", found.len(), all.len());
                assert_eq!(recording.about(), original.about());
                assert_eq!(recording.foreign_topics(), if extras { &["camera"][..] } else { &[] }, "{name}");
                let compared = Comparison::of(&original, &recording);
                assert!(compared.is_equal() && compared.ticks() == 60, "{name}");
            }
        }
    }
}

#[test]
fn a_rewritten_recording_is_read_up_to_where_it_was_torn() {
    let all = messages(40);
    let (folder, path) = written(&all);
    let whole = fs::read(&path).unwrap();
    let options = WriteOptions::new().compression(None).chunk_size(Some(100_000));
    let plain = rewrite(&whole, Rewrite { options, by_topic: false, extras: true });
    let torn = folder.path().join("torn.mcap");
    for (name, whole) in [("lz4", with_chunks(&plain, lz4)), ("zstd", with_chunks(&plain, zstd)), ("", plain)]
    {
        let mut most = 0;
        for at in (3_000..whole.len()).step_by(whole.len() / 97) {
            for tail in [0, 4096, whole.len() - at] {
                fs::write(&torn, [&whole[..at], &vec![0; tail]].concat()).unwrap();
                let recording = Recording::open(&torn).unwrap();
                assert!(!recording.is_complete(), "{name} cut to {at}, {tail} zeros");
                let found: Vec<Message> = recording.messages().map(Result::unwrap).collect();
                assert!(found == all[..found.len()], "{name} cut to {at}, {tail} zeros");
                if tail == 0 {
                    assert!(found.len() >= most, "a longer file has no fewer messages");
                    most = found.len();
                }
            }
        }
        assert_eq!(most, all.len(), "{name}: the end was cut off last");
    }
}

#[test]
fn without_the_description_of_its_run_a_file_is_refused_with_the_remedy() {
    let (folder, path) = written(&messages(5));
    let whole = fs::read(&path).unwrap();
    let mut out = MAGIC.to_vec();
    for (op, body) in records(&whole).into_iter().filter(|(op, _)| *op != op::METADATA) {
        out.push(op);
        out.extend((body.len() as u64).to_le_bytes());
        out.extend(body);
    }
    out.extend(MAGIC);
    let other = folder.path().join("other.mcap");
    fs::write(&other, out).unwrap();
    let error = Recording::open(&other).unwrap_err().to_string();
    assert!(error.contains("other.mcap: it has no metadata \"stgdat.run\""), "{error}");
    assert!(error.contains("--include-metadata"), "{error}");
}
