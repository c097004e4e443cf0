//! The tap's process: sockets and topics around [`Hub`].

use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::time::{Duration, Instant};

use console::failure::Failure;
use console::streams;
use ports::{Node, Publisher, Stop, TAP, is_own_user, monotonic_ns};
use recording::tap::{self, Hub, QUEUE_BYTES, REQUEST_BYTES_MAX, Request, SOCKET, TOOLS_MAX, Tool, Want};
use recording::{Event, Happened, LogLine};
use run::{Exit, Run};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use serde::{Deserialize, Serialize};
use wire::{Header, Heartbeat, HeartbeatsTopic, REFUSALS_MAX, RefusalCause, Refusals, StageId, TABLE, Topic};

use crate::tap::topic::{Input, Taken};

/// Longest sleep between checks that the run still exists.
const SLEEP: Duration = Duration::from_millis(500);
/// Time for the recordings to read their pending data when the run ends.
const RECORDING_LIMIT: Duration = Duration::from_secs(5);
/// The same time limit for other tools.
const END_LIMIT: Duration = Duration::from_millis(500);
/// Maximum number of connections whose request is incomplete. The oldest makes room.
const PENDING_MAX: usize = 16;
/// Longest message of the launcher.
const UNPROCESSED_MAX: usize = 1 << 20;
/// Number of bytes read at a time from the launcher's messages.
const BLOCK: usize = 1 << 14;

/// A message of the launcher to the tap, as one line of JSON.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FromLauncher {
    /// An event happened.
    Event(Event),
    /// A stage wrote a line.
    Line(LogLine),
}

/// The tap of a run.
struct Server {
    run: Run,
    /// Four descriptors. Opened for the first tool and kept: stages that come and go would have to notice a
    /// node that does.
    node: Option<Node>,
    hub: Hub<UnixStream>,
    /// Connections whose request is incomplete.
    pending: Vec<(UnixStream, Vec<u8>)>,
    inputs: Vec<Input>,
    refusals: Watched,
    /// Heartbeats of the tap. In lockstep the source waits for them, so the tap loses no frames.
    beats: Option<Publisher<HeartbeatsTopic>>,
    /// The newest forwarded tick, and the newest tick that a heartbeat carried.
    newest: u64,
    beaten: u64,
    beat: u64,
    /// Unprocessed input from the launcher.
    unprocessed: Vec<u8>,
}

/// Listens on a socket. The socket gets its final name only after it listens; otherwise a tool could connect
/// too early and be refused.
fn listen(path: &Path) -> std::io::Result<UnixListener> {
    let unfinished = path.with_extension("unfinished");
    // Left by a dead tap.
    let _ = std::fs::remove_file(&unfinished);
    let listener = UnixListener::bind(&unfinished)?;
    std::fs::rename(&unfinished, path)?;
    Ok(listener)
}

/// Serves the tools of a run until the launcher closes standard input or the run's folder is gone.
pub fn serve(record: &Path) -> Result<Exit, Failure> {
    // The tap shares the launcher's standard error, which may be stuck.
    streams::never_wait().map_err(Failure::unavailable)?;
    let run = Run::read(record).map_err(Failure::config)?;
    let stop = Stop::on_signals().map_err(Failure::unavailable)?;
    let path = run.root.join(SOCKET);
    let listener = listen(&path).map_err(|error| Failure::unavailable_about(path.display(), error))?;
    listener.set_nonblocking(true).map_err(Failure::unavailable)?;
    let root = run.root.clone();
    let mut server = Server {
        run,
        node: None,
        hub: Hub::new(QUEUE_BYTES),
        pending: Vec::new(),
        inputs: Vec::new(),
        refusals: Watched::default(),
        beats: None,
        newest: 0,
        beaten: 0,
        beat: 0,
        unprocessed: Vec::new(),
    };
    let mut input = std::io::stdin();
    loop {
        let ready = server.wait(&listener, input.as_fd(), SLEEP).map_err(Failure::unavailable)?;
        server.pump()?;
        server.beat()?;
        if ready.launcher && !server.listen(&mut input) {
            break;
        }
        if ready.listener {
            server.accept(&listener);
        }
        server.requests();
        server.flush();
        if stop.requested() || !root.exists() {
            break;
        }
    }
    server.end()
}

/// The sources that woke the tap.
struct Ready {
    listener: bool,
    launcher: bool,
}

impl Server {
    /// Sleeps until a source is ready.
    fn wait(
        &self,
        listener: &UnixListener,
        launcher: BorrowedFd<'_>,
        timeout: Duration,
    ) -> io::Result<Ready> {
        let mut fds =
            vec![PollFd::new(listener, PollFlags::IN), PollFd::from_borrowed_fd(launcher, PollFlags::IN)];
        fds.extend(
            self.inputs.iter().map(|input| PollFd::from_borrowed_fd(input.descriptor(), PollFlags::IN)),
        );
        fds.extend(self.pending.iter().map(|(socket, _)| PollFd::new(socket, PollFlags::IN)));
        for tool in self.hub.tools() {
            let wanted = if tool.is_waiting() { PollFlags::IN | PollFlags::OUT } else { PollFlags::IN };
            fds.push(PollFd::new(&tool.connection, wanted));
        }
        match poll(&mut fds, Timespec::try_from(timeout).ok().as_ref()) {
            Ok(_) => {
                Ok(Ready { listener: !fds[0].revents().is_empty(), launcher: !fds[1].revents().is_empty() })
            }
            Err(Errno::INTR) => Ok(Ready { listener: false, launcher: false }),
            Err(error) => Err(error.into()),
        }
    }

    /// Forwards the frames that have arrived.
    fn pump(&mut self) -> Result<(), Failure> {
        let Self { hub, inputs, refusals, newest, .. } = self;
        for input in inputs {
            input.take(|frame: &Taken<'_>| {
                let is_heartbeat = is_heartbeats(frame.topic);
                if !is_heartbeat && frame.header.is_tick() {
                    *newest = frame.header.seq.max(*newest);
                }
                if frame.lost > 0 {
                    hub.lost(frame.topic, frame.lost);
                }
                if hub.wants(frame.topic) {
                    hub.frame(
                        frame.topic,
                        frame.received_ns,
                        bytemuck::bytes_of(frame.header),
                        frame.payload,
                    );
                }
                if hub.wants_events() && TABLE.topics[usize::from(frame.topic)].name == HeartbeatsTopic::NAME
                {
                    for bytes in frame.payload.chunks_exact(size_of::<Heartbeat>()) {
                        let heartbeat: Heartbeat = bytemuck::pod_read_unaligned(bytes);
                        refusals.heartbeat(&heartbeat).iter().for_each(|event| hub.event(event));
                    }
                }
            })?;
        }
        Ok(())
    }

    /// Sends the tap's progress to the source if the run is in lockstep and the tap reads ticks.
    fn beat(&mut self) -> Result<(), Failure> {
        let reads_ticks = self.inputs.iter().any(|input| !is_heartbeats(input.number));
        if !self.run.lockstep || !reads_ticks && self.beats.is_none() {
            return Ok(());
        }
        if self.beats.is_none() {
            self.beats = self.node.as_ref().map(|node| node.publisher()).transpose()?;
        } else if reads_ticks && self.beaten == self.newest {
            return Ok(());
        }
        let Some(beats) = &self.beats else { return Ok(()) };
        let heartbeat = Heartbeat {
            stage: TAP,
            linked: u32::from(reads_ticks),
            pid: std::process::id(),
            beat: self.beat,
            seq: self.newest,
            frames_len: 1,
            sent_ns: monotonic_ns(),
            ..bytemuck::Zeroable::zeroed()
        };
        let mut header = Header::new(self.run.id, self.beat, 0);
        header.counts.agents_len = 1;
        beats.send_copy(&[heartbeat], header)?;
        (self.beat, self.beaten) = (self.beat + 1, self.newest);
        if !reads_ticks {
            // The heartbeat just sent announced that the tap no longer reads.
            self.beats = None;
        }
        Ok(())
    }

    /// Reads the launcher's messages. Returns false once the launcher has closed the pipe.
    fn listen(&mut self, input: &mut io::Stdin) -> bool {
        let mut block = [0; BLOCK];
        match input.read(&mut block) {
            Ok(0) => return false,
            Ok(len) => self.unprocessed.extend_from_slice(&block[..len]),
            Err(error) => return error.kind() == ErrorKind::Interrupted,
        }
        while let Some(end) = self.unprocessed.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = self.unprocessed.drain(..=end).collect();
            match serde_json::from_slice(&line) {
                Ok(FromLauncher::Event(event)) => self.hub.event(&event),
                Ok(FromLauncher::Line(line)) => self.hub.line(&line),
                Err(error) => tracing::warn!("from the launcher: {error}"),
            }
        }
        if self.unprocessed.len() > UNPROCESSED_MAX {
            self.unprocessed.clear();
        }
        true
    }

    fn accept(&mut self, listener: &UnixListener) {
        while let Ok((socket, _)) = listener.accept() {
            if is_own_user(&socket) && socket.set_nonblocking(true).is_ok() {
                if self.pending.len() == PENDING_MAX {
                    self.pending.remove(0);
                }
                self.pending.push((socket, Vec::new()));
            }
        }
    }

    /// Reads the pending requests and attaches their tools.
    fn requests(&mut self) {
        for (mut socket, mut line) in std::mem::take(&mut self.pending) {
            let mut block = [0; REQUEST_BYTES_MAX];
            match socket.read(&mut block) {
                Ok(0) => continue,
                Ok(len) => line.extend_from_slice(&block[..len]),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(_) => continue,
            }
            match line.iter().position(|&byte| byte == b'\n') {
                Some(end) => self.request(socket, &line[..end]),
                None if line.len() < REQUEST_BYTES_MAX => self.pending.push((socket, line)),
                None => tracing::warn!("a request of more than {REQUEST_BYTES_MAX} bytes"),
            }
        }
    }

    fn request(&mut self, socket: UnixStream, line: &[u8]) {
        let request: Request = match serde_json::from_slice(line) {
            Ok(request) => request,
            Err(error) => return tracing::warn!("a request that is none: {error}"),
        };
        if let Err(error) = self.open(Want::of(&request)) {
            tracing::warn!("{}: {error}", request.tool);
            return refuse(&socket, &error.to_string());
        }
        let attached = if request.mark.is_some() {
            let reads_ticks = self.inputs.iter().any(|input| !is_heartbeats(input.number));
            let tick = reads_ticks.then_some(self.newest);
            self.hub.mark(request, socket, monotonic_ns(), tick)
        } else {
            self.hub.attach(request, socket)
        };
        if let Err(socket) = attached {
            let why =
                format!("the tap serves {TOOLS_MAX} tools at once, and all are attached: end one of them");
            tracing::warn!("{why}");
            refuse(&socket, &why);
        }
    }

    /// Takes a reader's place on each wanted topic that is not open yet.
    fn open(&mut self, want: Want) -> Result<(), Failure> {
        for (number, entry) in TABLE.topics.iter().enumerate() {
            let number = number as u8;
            let is_wanted = want.has(number) || want.events && entry.name == HeartbeatsTopic::NAME;
            if !is_wanted || self.inputs.iter().any(|input| input.number == number) {
                continue;
            }
            if self.node.is_none() {
                self.node = Some(Node::open(&self.run, "tap")?);
            }
            if let Some(node) = &self.node {
                self.inputs.push(Input::open(node, number)?);
            }
        }
        Ok(())
    }

    /// Writes as much as the tools accept, detaches closed tools, and releases topics that no tool wants.
    fn flush(&mut self) {
        self.hub.write();
        let gone = self.hub.detach(|tool| {
            let mut block = [0; 64];
            match tool.connection.read(&mut block) {
                Ok(0) => true,
                Ok(_) => false,
                Err(error) => !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
            }
        });
        for tool in gone {
            tracing::debug!("{} has gone; it lost {} frames in its queue", tool.name, tool.lost());
        }
        let hub = &self.hub;
        self.inputs.retain(|input| {
            let number = input.number;
            hub.wants(number) || is_heartbeats(number) && hub.wants_events()
        });
    }

    /// Forwards the last frames and waits until the tools have read them.
    fn end(mut self) -> Result<Exit, Failure> {
        self.pump()?;
        let begun = Instant::now();
        self.flush();
        let is_awaited = |tool: &Tool<UnixStream>| {
            let limit = if tool.recording.is_some() { RECORDING_LIMIT } else { END_LIMIT };
            tool.is_waiting() && begun.elapsed() < limit
        };
        while self.hub.tools().iter().any(is_awaited) {
            std::thread::sleep(Duration::from_millis(2));
            self.flush();
        }
        // The launcher removes the run's files. Ports dropped after that would look for them.
        std::mem::forget((self.inputs, self.beats, self.node));
        Ok(Exit::Done)
    }
}

/// Answers a tool that is not attached. An empty socket accepts this few bytes at once.
fn refuse(mut socket: &UnixStream, why: &str) {
    let _ = socket.write_all(&tap::refused(why));
}

fn is_heartbeats(topic: u8) -> bool {
    TABLE.topics[usize::from(topic)].name == HeartbeatsTopic::NAME
}

/// The refusals that heartbeats have reported so far.
#[derive(Debug, Default)]
struct Watched(BTreeMap<(u32, u32), [Refusals; REFUSALS_MAX]>);

impl Watched {
    /// Returns the new refusals since a stage's last heartbeat. Refusals before the stage's first observed
    /// heartbeat do not count, because no tool was attached.
    fn heartbeat(&mut self, heartbeat: &Heartbeat) -> Vec<Event> {
        let key = (heartbeat.stage, heartbeat.incarnation);
        let Some(before) = self.0.insert(key, heartbeat.refusals) else { return Vec::new() };
        let name = |number: u32| {
            StageId::from_number(number).map_or_else(|| format!("stage {number}"), |s| s.name().to_owned())
        };
        let newer = heartbeat.refusals.iter().filter(|entry| entry.cause != 0 && entry.link().is_none());
        let events = newer.filter_map(|refused| {
            let same = before.iter().find(|old| (old.sender, old.cause) == (refused.sender, refused.cause));
            let frames = refused.frames_len.saturating_sub(same.map_or(0, |old| old.frames_len));
            let cause =
                RefusalCause::from_number(u32::from(refused.cause)).map_or("unknown", RefusalCause::name);
            (frames > 0).then(|| Event {
                at_ns: heartbeat.sent_ns,
                what: Happened::Refused {
                    stage: name(heartbeat.stage),
                    incarnation: heartbeat.incarnation,
                    sender: name(u32::from(refused.sender)),
                    cause: cause.to_owned(),
                    frames: u64::from(frames),
                },
            })
        });
        events.collect()
    }
}
