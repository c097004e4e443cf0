use std::io::{Error, Result, Write as _};
use std::net::SocketAddr;
use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use foxglove::websocket::{ChannelView, Client as Subscriber, ServerListener, Status};
use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle,
};
use interop::{GRID_TOPIC, Target, ViewOptions};
use recording::tap::{Client, Item, Request};
use recording::{ABOUT, About, Event, Happened, Message, View, ViewChannel};
use scene::ContextMap;
use wire::{ForecastsTopic, Topic as _, TracksTopic};

use crate::arguments::Arguments;

/// The address if none is named; any free port if this one is taken. Foxglove offers this port by default.
const ADDRESS: ([u8; 4], u16) = ([127, 0, 0, 1], 8765);
/// Messages that wait for a client: about three seconds of a run at 12.5 Hz.
pub const BACKLOG: usize = 128;
/// Longest wait for an item or a client.
const WAIT: Duration = Duration::from_millis(200);
/// Time limit for the tap to accept this program, after which the run counts as dead.
const ATTACH_LIMIT: Duration = Duration::from_secs(10);

/// Time limit for clients to accept the end of the connection.
const END_LIMIT: Duration = Duration::from_secs(2);

/// Serves a run until it ends.
pub fn serve(arguments: &Arguments) -> Result<()> {
    let Arguments { run: root, address, paths, map } = arguments;
    let about_path = root.join(ABOUT);
    let about = About::of_run(root)
        .map_err(|error| Error::new(error.kind(), format!("{}: {error}", about_path.display())))?;
    let map = map.as_deref().map(ContextMap::load).transpose().map_err(Error::other)?;
    let targets = &[Target::Foxglove];
    let options = ViewOptions { targets, paths_max: (*paths).into(), max_age_ns: None, map };
    let Some(view) = interop::views(options, &about) else { return Ok(()) };
    let mut live = Live::new(&about, *address, view)?;
    let mut refused_since: Option<Instant> = None;
    while about_path.exists() && !live.has_ended {
        if !live.is_watched() {
            std::thread::sleep(WAIT);
            continue;
        }
        match Client::attach(root, &request()) {
            Ok(tap) => {
                refused_since = None;
                live.follow(tap)?;
            }
            // The tap may have died and be starting again, or the run may end at this moment.
            Err(error) => {
                if refused_since.get_or_insert_with(Instant::now).elapsed() > ATTACH_LIMIT {
                    return Err(Error::other(error));
                }
                std::thread::sleep(WAIT);
            }
        }
    }
    live.end();
    Ok(())
}

fn request() -> Request {
    let topics = vec![TracksTopic::NAME.to_owned(), ForecastsTopic::NAME.to_owned()];
    Request { tool: "foxglove".to_owned(), topics, events: true, mark: None, recording: None }
}

/// The server with its channels.
struct Live {
    server: WebSocketServerHandle,
    /// The channels belong to it: without it they are closed.
    _context: Arc<Context>,
    channels: Vec<Arc<RawChannel>>,
    latched: Arc<Latched>,
    view: Box<dyn View>,
    clock_offset_ns: i64,
    /// Frames that did not arrive from the tap.
    lost: u64,
    has_ended: bool,
}

impl Live {
    /// Starts the server and prints its URL.
    fn new(about: &About, address: Option<SocketAddr>, view: Box<dyn View>) -> Result<Self> {
        let context = Context::new();
        let channels = view.channels().into_iter().map(|channel| build(channel, &context));
        let channels = channels.collect::<std::result::Result<_, _>>().map_err(Error::other)?;
        let latched = Arc::<Latched>::default();
        let start = |address: SocketAddr| {
            let server = WebSocketServer::new().name(format!("stgdat: {}", about.scene)).context(&context);
            let server = server.message_backlog_size(BACKLOG).listener(latched.clone());
            let started = server.bind(address.ip().to_string(), address.port()).start_blocking();
            started.map_err(|error| Error::other(format!("{address}: {error}")))
        };
        let (server, ip) = match address {
            Some(address) => (start(address)?, address.ip()),
            // Another program is there already.
            None => {
                let any = SocketAddr::from((ADDRESS.0, 0));
                (start(ADDRESS.into()).or_else(|_| start(any))?, any.ip())
            }
        };
        let url = SocketAddr::new(ip, server.port());
        let mut output = std::io::stdout().lock();
        // A closed pipe is not an error.
        let scene = ports::escaped(&about.scene, false);
        let _ = writeln!(output, "ws://{url} shows {scene} in Foxglove; Ctrl-C ends it")
            .and_then(|()| output.flush());
        let clock_offset_ns = about.clock_offset_ns;
        Ok(Self {
            server,
            _context: context,
            channels,
            latched,
            view,
            clock_offset_ns,
            lost: 0,
            has_ended: false,
        })
    }

    /// Whether a client subscribes to a channel.
    fn is_watched(&self) -> bool {
        self.channels.iter().any(|channel| channel.has_sinks())
    }

    /// Sends the run's messages while a client watches and the tap is there.
    fn follow(&mut self, mut tap: Client) -> Result<()> {
        let mut newest_ns = 0;
        while self.is_watched() && !tap.is_closed() && !self.has_ended {
            match tap.next(WAIT).map_err(Error::other)? {
                Some(Item::Frame(frame)) => {
                    newest_ns = frame.received_ns();
                    self.send(&Message::Frame(frame));
                }
                Some(Item::Event(event)) => {
                    newest_ns = event.at_ns;
                    self.has_ended = matches!(event.what, Happened::Ended { .. });
                    self.send(&Message::Event(event));
                }
                Some(Item::Line(line)) => self.send(&Message::Line(line)),
                Some(Item::Lost(lost)) => {
                    self.lost += lost.frames;
                    let (at, topic) = (lost.at.name().to_owned(), lost.topic().to_owned());
                    let what = Happened::Lost { at, topic, frames: lost.frames };
                    self.send(&Message::Event(Event { at_ns: newest_ns, what }));
                    let text = format!("{} frames of the run are not shown", self.lost);
                    self.server.publish_status(Status::warning(text).with_id("lost"));
                }
                Some(Item::Refused(why)) => return Err(Error::other(why)),
                Some(Item::Attached | Item::Marked(_)) | None => {}
            }
        }
        Ok(())
    }

    /// Closes the connections. Clients that do not read are left behind.
    fn end(self) {
        // The last messages are on their way.
        std::thread::sleep(WAIT);
        let (done, is_done) = sync_channel(1);
        let server = self.server;
        std::thread::spawn(move || {
            server.stop().wait_blocking();
            let _ = done.send(());
        });
        let _ = is_done.recv_timeout(END_LIMIT);
    }

    fn send(&mut self, message: &Message) {
        let Self { channels, latched, view, clock_offset_ns, .. } = self;
        let log_time = message.at_ns().saturating_add_signed(*clock_offset_ns);
        view.add(message, &mut |place, bytes| {
            if let Some(channel) = channels.get(usize::from(place)) {
                if channel.topic() == GRID_TOPIC {
                    latched.keep(channel, bytes);
                }
                channel.log_with_meta(bytes, PartialMetadata::with_log_time(log_time));
            }
        });
    }
}

/// The map, which is sent once and which later subscribers need too.
#[derive(Default)]
struct Latched(Mutex<Option<(Arc<RawChannel>, Vec<u8>)>>);

impl Latched {
    fn kept(&self) -> MutexGuard<'_, Option<(Arc<RawChannel>, Vec<u8>)>> {
        // The only change is an assignment, so a panic leaves the value whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn keep(&self, channel: &Arc<RawChannel>, bytes: &[u8]) {
        *self.kept() = Some((channel.clone(), bytes.to_vec()));
    }
}

impl ServerListener for Latched {
    fn on_subscribe(&self, client: Subscriber, channel: ChannelView<'_>) {
        if let Some((kept, bytes)) = &*self.kept()
            && kept.id() == channel.id()
        {
            kept.log_to_sink(bytes, client.sink_id());
        }
    }
}

fn build(
    channel: ViewChannel,
    context: &Arc<Context>,
) -> std::result::Result<Arc<RawChannel>, foxglove::FoxgloveError> {
    let schema = Schema::new(channel.schema, channel.schema_encoding, channel.schema_data);
    let builder = ChannelBuilder::new(channel.topic).schema(schema).message_encoding(channel.encoding);
    builder.context(context).build_raw()
}
