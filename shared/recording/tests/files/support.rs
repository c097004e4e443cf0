//! Recordings that the tests write.

use std::path::PathBuf;

use recording::{About, Event, Frame, Happened, LogLine, Message, Writer};
use tempfile::TempDir;
use wire::{Detection, DetectionsTopic, Forecast, ForecastsTopic, Header, Hop, StageId};

/// Time between ticks.
pub const TICK_NS: u64 = 80_000_000;

pub fn about() -> About {
    About {
        program: "stgdat 0".to_owned(),
        pipeline: "[[stage]]\n".to_owned(),
        clock_offset_ns: 1_700_000_000_000_000_000,
        ..About::default()
    }
}

pub fn header(seq: u64, agents_len: u32) -> Header {
    let mut header = Header::new(7, seq, (seq * TICK_NS) as i64);
    header.counts.agents_len = agents_len;
    let sent_ns = seq * TICK_NS + 5;
    header.push_hop(Hop { stage: StageId::Source.number(), sent_ns, ..Hop::default() });
    header
}

/// The messages of `ticks` ticks: detections, forecasts, and occasionally an event and a line.
pub fn messages(ticks: u64) -> Vec<Message> {
    let mut messages = Vec::new();
    for seq in 0..ticks {
        let at_ns = seq * TICK_NS + 10;
        let detections: Vec<Detection> = (0..seq % 5)
            .map(|id| Detection { id, x_m: seq as f32 * 0.1, ..bytemuck::Zeroable::zeroed() })
            .collect();
        let len = detections.len() as u32;
        let frame = Frame::of::<DetectionsTopic>(&header(seq, len), &detections, at_ns);
        messages.push(Message::Frame(frame));
        let forecast = Forecast { id: seq, ..bytemuck::Zeroable::zeroed() };
        messages.push(Message::Frame(Frame::of::<ForecastsTopic>(&header(seq, 1), &[forecast], at_ns + 1)));
        if seq % 7 == 3 {
            let what = Happened::Died { stage: "encoder".to_owned(), how: "was killed".to_owned(), next: 1 };
            messages.push(Message::Event(Event { at_ns: at_ns + 2, what }));
            let line = LogLine { at_ns: at_ns + 3, stage: "encoder".to_owned(), line: "\"x\" ü".to_owned() };
            messages.push(Message::Line(line));
        }
    }
    messages
}

/// A recording as a file, in a folder that lives as long as the first return value.
pub fn written(messages: &[Message]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, &about(), "{\"schema\":2}").expect("the file can be made");
    messages.iter().for_each(|message| writer.add(message));
    writer.finish("the run has ended").expect("the file can be finished");
    (folder, path)
}
