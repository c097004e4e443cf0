//! Perfetto traces: spans, instants, counters and flows on tracks of processes, for
//! <https://ui.perfetto.dev>.
//!
//! A trace is a sequence of packets (protobuf messages of Perfetto's `trace_packet.proto`). So it can be
//! written piece by piece, and a truncated trace is readable. [`Trace`] appends packets to a buffer, from
//! which the caller takes them. It does not depend on files, clocks or pipelines.
//!
//! Times are nanoseconds on `CLOCK_MONOTONIC`. [`Trace::clocks`] must come first: without a snapshot that
//! relates the clocks, Perfetto drops every event.
//!
//! The caller chooses the numbers that identify tracks. Spans of one track must follow one another or nest.

mod encode;

pub use encode::Message;

/// Fields of a `TracePacket`.
mod packet {
    pub const CLOCK_SNAPSHOT: u32 = 6;
    pub const TIMESTAMP: u32 = 8;
    pub const SEQUENCE_ID: u32 = 10;
    pub const TRACK_EVENT: u32 = 11;
    pub const CLOCK_ID: u32 = 58;
    pub const TRACK_DESCRIPTOR: u32 = 60;
}

/// Fields of a `TrackDescriptor` and of its parts.
mod track {
    pub const UUID: u32 = 1;
    pub const NAME: u32 = 2;
    pub const PROCESS: u32 = 3;
    pub const PARENT: u32 = 5;
    pub const COUNTER: u32 = 8;
    pub const CHILD_ORDER: u32 = 11;
    pub const RANK: u32 = 12;
    pub const PROCESS_ID: u32 = 1;
    pub const PROCESS_NAME: u32 = 6;
    pub const UNIT_NAME: u32 = 6;
    /// Children are shown by their rank.
    pub const EXPLICIT: u64 = 3;
}

/// Fields of a `TrackEvent` and of its parts.
mod event {
    pub const ANNOTATION: u32 = 4;
    pub const TYPE: u32 = 9;
    pub const TRACK: u32 = 11;
    pub const CATEGORY: u32 = 22;
    pub const NAME: u32 = 23;
    pub const COUNTER_VALUE: u32 = 44;
    pub const FLOW: u32 = 47;
    pub const FLOW_END: u32 = 48;
    pub const ANNOTATION_UINT: u32 = 3;
    pub const ANNOTATION_DOUBLE: u32 = 5;
    pub const ANNOTATION_TEXT: u32 = 6;
    pub const ANNOTATION_NAME: u32 = 10;
    pub const BEGIN: u64 = 1;
    pub const END: u64 = 2;
    pub const INSTANT: u64 = 3;
    pub const COUNTER: u64 = 4;
}

/// Perfetto's numbers of `CLOCK_REALTIME`, `CLOCK_MONOTONIC` and `CLOCK_BOOTTIME`.
const REALTIME: u64 = 1;
const MONOTONIC: u64 = 3;
const BOOTTIME: u64 = 6;
/// Perfetto's number of the single writer of these traces.
const SEQUENCE: u64 = 1;

/// One reading of the three clocks, as close together as possible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// `CLOCK_MONOTONIC`.
    pub monotonic_ns: u64,
    /// `CLOCK_BOOTTIME`, Perfetto's default clock: monotonic time plus suspended time.
    pub boottime_ns: u64,
    /// `CLOCK_REALTIME`, for the time of day; `None` if unknown.
    pub realtime_ns: Option<u64>,
}

/// A number or text shown with a span or instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// A count.
    Count(u64),
    /// A measured quantity.
    Number(f64),
    /// A text.
    Text(&'a str),
}

/// The properties of a span or instant besides time and name.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Details<'a> {
    /// The category.
    pub category: Option<&'a str>,
    /// The flow that passes through it.
    pub flow: Option<u64>,
    /// Whether the flow ends here.
    pub ends_flow: bool,
    /// Values to show, by name.
    pub values: &'a [(&'a str, Value<'a>)],
}

/// Packets of a trace that the caller has not taken yet.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    bytes: Vec<u8>,
}

impl Trace {
    /// A trace with room for `bytes_len` bytes.
    #[must_use]
    pub fn with_room(bytes_len: usize) -> Self {
        Self { bytes: Vec::with_capacity(bytes_len) }
    }

    /// The packets in the buffer.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Takes the packets out of the buffer.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }

    /// Relates the clocks to one another.
    pub fn clocks(&mut self, clocks: Clocks) {
        let read = [
            (REALTIME, clocks.realtime_ns),
            (MONOTONIC, Some(clocks.monotonic_ns)),
            (BOOTTIME, Some(clocks.boottime_ns)),
        ];
        self.packet(|packet| {
            packet.message(packet::CLOCK_SNAPSHOT, |snapshot| {
                for (id, time_ns) in read {
                    let Some(time_ns) = time_ns else { continue };
                    snapshot.message(1, |clock| {
                        clock.number(1, id);
                        clock.number(2, time_ns);
                    });
                }
            });
        });
    }

    /// Names a process and its track.
    pub fn process(&mut self, track: u64, pid: u32, name: &str, rank: u64) {
        self.descriptor(track, |descriptor| {
            descriptor.number(track::CHILD_ORDER, track::EXPLICIT);
            descriptor.number(track::RANK, rank);
            descriptor.message(track::PROCESS, |process| {
                process.number(track::PROCESS_ID, pid.into());
                process.text(track::PROCESS_NAME, name);
            });
        });
    }

    /// Names a track, which is shown below its parent.
    pub fn track(&mut self, track: u64, parent: u64, name: &str, rank: u64) {
        self.descriptor(track, |descriptor| {
            descriptor.text(track::NAME, name);
            descriptor.number(track::PARENT, parent);
            descriptor.number(track::RANK, rank);
        });
    }

    /// Names a counter, which is shown below its parent.
    pub fn counter(&mut self, track: u64, parent: u64, name: &str, unit: &str, rank: u64) {
        self.descriptor(track, |descriptor| {
            descriptor.text(track::NAME, name);
            descriptor.number(track::PARENT, parent);
            descriptor.number(track::RANK, rank);
            descriptor.message(track::COUNTER, |counter| counter.text(track::UNIT_NAME, unit));
        });
    }

    /// A span from `begin_ns` to `end_ns`.
    pub fn span(&mut self, track: u64, [begin_ns, end_ns]: [u64; 2], name: &str, details: Details<'_>) {
        self.event(begin_ns, event::BEGIN, track, Some(name), details, |_| {});
        self.event(end_ns.max(begin_ns), event::END, track, None, Details::default(), |_| {});
    }

    /// An event at one time.
    pub fn instant(&mut self, track: u64, at_ns: u64, name: &str, details: Details<'_>) {
        self.event(at_ns, event::INSTANT, track, Some(name), details, |_| {});
    }

    /// The value of a counter from this time on.
    pub fn count(&mut self, track: u64, at_ns: u64, value: f64) {
        let value = |event: &mut Message<'_>| event.double(event::COUNTER_VALUE, value);
        self.event(at_ns, event::COUNTER, track, None, Details::default(), value);
    }

    fn event(
        &mut self,
        at_ns: u64,
        kind: u64,
        track: u64,
        name: Option<&str>,
        details: Details<'_>,
        more: impl FnOnce(&mut Message<'_>),
    ) {
        self.packet(|packet| {
            packet.number(packet::TIMESTAMP, at_ns);
            packet.number(packet::CLOCK_ID, MONOTONIC);
            packet.message(packet::TRACK_EVENT, |event| {
                event.number(event::TYPE, kind);
                event.number(event::TRACK, track);
                if let Some(name) = name {
                    event.text(event::NAME, name);
                }
                if let Some(category) = details.category {
                    event.text(event::CATEGORY, category);
                }
                if let Some(flow) = details.flow {
                    event.fixed(if details.ends_flow { event::FLOW_END } else { event::FLOW }, flow);
                }
                for (name, value) in details.values {
                    event.message(event::ANNOTATION, |annotation| {
                        annotation.text(event::ANNOTATION_NAME, name);
                        match *value {
                            Value::Count(count) => annotation.number(event::ANNOTATION_UINT, count),
                            Value::Number(number) => annotation.double(event::ANNOTATION_DOUBLE, number),
                            Value::Text(text) => annotation.text(event::ANNOTATION_TEXT, text),
                        }
                    });
                }
                more(event);
            });
        });
    }

    fn descriptor(&mut self, track: u64, fill: impl FnOnce(&mut Message<'_>)) {
        self.packet(|packet| {
            packet.message(packet::TRACK_DESCRIPTOR, |descriptor| {
                descriptor.number(track::UUID, track);
                fill(descriptor);
            });
        });
    }

    fn packet(&mut self, fill: impl FnOnce(&mut Message<'_>)) {
        Message::new(&mut self.bytes).message(1, |packet| {
            packet.number(packet::SEQUENCE_ID, SEQUENCE);
            fill(packet);
        });
    }
}

#[cfg(test)]
mod tests;
