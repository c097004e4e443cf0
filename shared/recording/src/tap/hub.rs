use std::collections::VecDeque;
use std::io::{self, ErrorKind, Write};
use std::sync::Arc;

use wire::TABLE;

use super::protocol::{self, Lost, LostAt, Marked, Request, Want};
use crate::{Event, Happened, LogLine};

/// Maximum bytes that wait for a tool: about five seconds of all topics of a full scene.
pub const QUEUE_BYTES: usize = 64 << 20;
/// Maximum number of attached tools.
pub const TOOLS_MAX: usize = 16;

/// The tap's side: distributes items to tools. `C` is the writer of a tool's items, which must not block.
#[derive(Debug)]
pub struct Hub<C> {
    tools: Vec<Tool<C>>,
    queue_bytes: usize,
}

/// An attached tool.
#[derive(Debug)]
pub struct Tool<C> {
    /// Name.
    pub name: String,
    /// The items that it requests.
    pub want: Want,
    /// Name of the recording that it writes the events to, if it does.
    pub recording: Option<String>,
    /// Writer of its items.
    pub connection: C,
    queue: VecDeque<Arc<[u8]>>,
    queued_bytes: usize,
    /// Written bytes of the first item.
    written: usize,
    /// Frames lost in its queue that are not reported to it yet, by topic.
    unsent_losses: Vec<u64>,
    /// Frames lost in its queue.
    lost: u64,
}

impl<C: Write> Hub<C> {
    /// A tap without tools. `queue_bytes` is [`QUEUE_BYTES`] except in tests.
    #[must_use]
    pub const fn new(queue_bytes: usize) -> Self {
        Self { tools: Vec::new(), queue_bytes }
    }

    /// Attaches a tool. Returns the connection if [`TOOLS_MAX`] tools are attached already.
    ///
    /// # Errors
    /// The connection.
    pub fn attach(&mut self, request: Request, connection: C) -> Result<(), C> {
        if self.tools.len() >= TOOLS_MAX {
            return Err(connection);
        }
        let unsent_losses = vec![0; TABLE.topics.len()];
        let want = Want::of(&request);
        let Request { tool: name, recording, .. } = request;
        let (queue, queued_bytes, written, lost) = (VecDeque::new(), 0, 0, 0);
        let mut tool =
            Tool { name, want, recording, connection, queue, queued_bytes, written, unsent_losses, lost };
        tool.enqueue(protocol::attached());
        self.tools.push(tool);
        Ok(())
    }

    /// The tools.
    pub fn tools(&self) -> &[Tool<C>] {
        &self.tools
    }

    /// Detaches and returns the tools for which `gone` is true.
    pub fn detach(&mut self, mut gone: impl FnMut(&mut Tool<C>) -> bool) -> Vec<Tool<C>> {
        self.tools.extract_if(.., |tool| gone(tool)).collect()
    }

    /// Whether a tool requests the frames of a topic.
    #[must_use]
    pub fn wants(&self, topic: u8) -> bool {
        self.tools.iter().any(|tool| tool.want.has(topic))
    }

    /// Whether a tool requests events and log lines.
    pub fn wants_events(&self) -> bool {
        self.tools.iter().any(|tool| tool.want.events)
    }

    /// Forwards a frame. It is copied once for any number of tools.
    pub fn frame(&mut self, topic: u8, received_ns: u64, header: &[u8], payload: &[u8]) {
        let packet = protocol::frame(topic, received_ns, header, payload);
        let limit = self.queue_bytes;
        for tool in self.tools.iter_mut().filter(|tool| tool.want.has(topic)) {
            tool.push(topic, &packet, limit);
        }
    }

    /// Reports to the tools the frames that the tap itself has lost.
    pub fn lost(&mut self, topic: u8, frames: u64) {
        let packet = protocol::lost(&Lost { at: LostAt::Tap, topic, frames });
        let limit = self.queue_bytes;
        for tool in self.tools.iter_mut().filter(|tool| tool.want.has(topic)) {
            if tool.queued_bytes + packet.len() <= limit {
                tool.enqueue(packet.clone());
            } else {
                // Reported with the losses of the queue, once it has room.
                tool.unsent_losses[usize::from(topic)] += frames;
            }
        }
    }

    /// Forwards an event.
    pub fn event(&mut self, event: &Event) {
        self.broadcast(&protocol::event(event));
    }

    /// Attaches a tool that marks this moment. The mark is forwarded to all tools, and the answer names the
    /// recordings that have it.
    ///
    /// # Errors
    /// The connection, if there are [`TOOLS_MAX`] tools already.
    pub fn mark(&mut self, request: Request, connection: C, at_ns: u64, tick: Option<u64>) -> Result<(), C> {
        let text = request.mark.clone().unwrap_or_default();
        self.event(&Event { at_ns, what: Happened::Mark { text } });
        let keeps = |tool: &&Tool<C>| tool.want.events;
        let recordings = self.tools.iter().filter(keeps).filter_map(|tool| tool.recording.clone());
        let marked = Marked { tick, recordings: recordings.collect() };
        self.attach(request, connection)?;
        if let Some(tool) = self.tools.last_mut() {
            tool.enqueue(protocol::marked(&marked));
        }
        Ok(())
    }

    /// Forwards a log line.
    pub fn line(&mut self, line: &LogLine) {
        self.broadcast(&protocol::line(line));
    }

    fn broadcast(&mut self, packet: &Arc<[u8]>) {
        let limit = self.queue_bytes;
        for tool in self.tools.iter_mut().filter(|tool| tool.want.events) {
            // An endless series of log lines must not fill the memory.
            if tool.queued_bytes + packet.len() <= limit {
                tool.enqueue(packet.clone());
            }
        }
    }

    /// Writes as much as the connections take. Tools whose connection has failed are detached and returned.
    pub fn write(&mut self) -> Vec<Tool<C>> {
        self.detach(|tool| tool.write().is_err())
    }
}

impl<C: Write> Tool<C> {
    /// Whether an item waits to be written.
    pub fn is_waiting(&self) -> bool {
        !self.queue.is_empty()
    }

    /// Number of frames lost in its queue.
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    fn push(&mut self, topic: u8, packet: &Arc<[u8]>, limit: usize) {
        // An empty queue takes any frame.
        if self.queued_bytes > 0 && self.queued_bytes + packet.len() > limit {
            self.unsent_losses[usize::from(topic)] += 1;
            self.lost += 1;
            return;
        }
        for topic in 0..self.unsent_losses.len() {
            let frames = std::mem::take(&mut self.unsent_losses[topic]);
            if frames > 0 {
                self.enqueue(protocol::lost(&Lost { at: LostAt::Queue, topic: topic as u8, frames }));
            }
        }
        self.enqueue(packet.clone());
    }

    fn enqueue(&mut self, packet: Arc<[u8]>) {
        self.queued_bytes += packet.len();
        self.queue.push_back(packet);
    }

    /// Writes as much as the connection takes now.
    fn write(&mut self) -> io::Result<()> {
        while let Some(packet) = self.queue.front() {
            match self.connection.write(&packet[self.written..]) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(len) => self.written += len,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
            if self.written == packet.len() {
                self.queued_bytes -= packet.len();
                self.written = 0;
                self.queue.pop_front();
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tap::protocol::{Item, take};
    use wire::Header;

    /// A connection that takes a limited number of bytes in all.
    #[derive(Debug)]
    struct Pipe {
        taken: Vec<u8>,
        room: usize,
    }

    impl Write for Pipe {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let len = bytes.len().min(self.room);
            if len == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
            self.room -= len;
            self.taken.extend_from_slice(&bytes[..len]);
            Ok(len)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn attach(hub: &mut Hub<Pipe>, name: &str, room: usize) {
        let pipe = Pipe { taken: Vec::new(), room };
        hub.attach(request(name, None), pipe).expect("there is room");
    }

    fn request(name: &str, mark: Option<&str>) -> Request {
        let (tool, topics) = (name.to_owned(), vec!["detections".to_owned()]);
        let (mark, recording) = (mark.map(str::to_owned), name.ends_with(".mcap").then(|| name.to_owned()));
        Request { tool, topics, events: true, mark, recording }
    }

    #[test]
    fn a_mark_reaches_all_tools_and_its_sender_learns_which_record_it() {
        let mut hub = Hub::new(QUEUE_BYTES);
        ["a.mcap", "top", "b.mcap"].iter().for_each(|name| attach(&mut hub, name, usize::MAX));
        let pipe = Pipe { taken: Vec::new(), room: usize::MAX };
        hub.mark(request("mark", Some("now")), pipe, 5, Some(7)).expect("there is room");
        assert!(hub.write().is_empty());
        let event = Event { at_ns: 5, what: Happened::Mark { text: "now".to_owned() } };
        for tool in &hub.tools()[..3] {
            assert_eq!(items(&tool.connection.taken), [Item::Attached, Item::Event(event.clone())]);
        }
        let recordings = vec!["a.mcap".to_owned(), "b.mcap".to_owned()];
        let marked = Item::Marked(Marked { tick: Some(7), recordings });
        assert_eq!(items(&hub.tools()[3].connection.taken), [Item::Attached, marked]);
    }

    fn items(mut bytes: &[u8]) -> Vec<Item> {
        let mut items = Vec::new();
        while let Some((item, len)) = take(bytes).expect("whole items") {
            items.push(item);
            bytes = &bytes[len..];
        }
        items
    }

    #[test]
    fn a_slow_tool_loses_frames_that_are_counted_and_the_others_none() {
        let mut hub = Hub::new(3_000);
        attach(&mut hub, "slow", 0);
        attach(&mut hub, "fast", usize::MAX);
        for seq in 0..10 {
            let header = Header::new(1, seq, 0);
            hub.frame(0, seq, bytemuck::bytes_of(&header), &[]);
            assert!(hub.write().is_empty());
        }
        assert_eq!(hub.tools()[0].lost(), 6, "four frames of 720 bytes have room");
        let all = items(&hub.tools()[1].connection.taken);
        assert_eq!((all.len(), &all[0]), (11, &Item::Attached));

        hub.detach(|tool| {
            tool.connection.room = usize::MAX;
            false
        });
        hub.write();
        hub.frame(0, 10, bytemuck::bytes_of(&Header::new(1, 10, 0)), &[]);
        hub.write();
        let got = items(&hub.tools()[0].connection.taken);
        let seqs: Vec<u64> = got
            .iter()
            .filter_map(|item| if let Item::Frame(frame) = item { Some(frame.header().seq) } else { None })
            .collect();
        assert_eq!(seqs, [0, 1, 2, 3, 10]);
        assert!(got.contains(&Item::Lost(Lost { at: LostAt::Queue, topic: 0, frames: 6 })), "{got:?}");
    }

    #[test]
    fn nothing_is_wanted_after_the_last_tool_has_gone() {
        let mut hub = Hub::new(QUEUE_BYTES);
        assert!(!hub.wants(0));
        attach(&mut hub, "a", 1);
        assert!(hub.wants(0) && !hub.wants(1) && hub.wants_events());
        assert_eq!(hub.detach(|tool| tool.name == "a").len(), 1);
        assert!(!hub.wants(0) && !hub.wants_events());
    }

    #[test]
    fn items_are_read_back_however_they_arrive() {
        let mut hub = Hub::new(QUEUE_BYTES);
        attach(&mut hub, "a", usize::MAX);
        hub.line(&LogLine { at_ns: 5, stage: "tracker".to_owned(), line: "hello".to_owned() });
        hub.lost(0, 3);
        hub.write();
        let bytes = &hub.tools()[0].connection.taken;
        for cut in 0..bytes.len() {
            assert!(items(&bytes[..cut]).len() < 3);
        }
        assert_eq!(items(bytes).len(), 3);
        assert!(take(&[0xFF; 64]).is_err());
    }
}
