//! The server of the live page: the page itself, and one stream of server-sent events per browser.
//!
//! The server holds the newest tick and the newest status, nothing older. A browser that reads slowly misses
//! ticks; the stream contains the number of ticks that it has missed. A browser that stops reading is
//! disconnected after [`WRITE_LIMIT`].

use std::io::{self, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::http::{self, PLAIN, Request, respond};

/// Time limit for a browser to accept an event.
pub const WRITE_LIMIT: Duration = Duration::from_secs(5);
/// Interval between signs of life if nothing happens. They also find browsers that are gone.
const ALIVE: Duration = Duration::from_millis(250);
/// Number of bytes of a token.
const TOKEN_BYTES: usize = 16;

/// The security policy of the page: it contains everything, and connects to its own server only.
const HEADERS: &str = "Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; style-src \
                       'unsafe-inline'; connect-src 'self'; img-src data:\r\nReferrer-Policy: no-referrer\r\nCache-Control: \
                       no-store\r\nX-Content-Type-Options: nosniff\r\n";

/// The live page of a run, served until the process ends.
#[derive(Debug)]
pub struct Live {
    shared: Arc<Shared>,
    address: SocketAddr,
    token: Option<String>,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

/// The newest of everything.
#[derive(Debug, Default)]
struct State {
    /// Facts of the run that do not change.
    hello: Arc<str>,
    /// With its number, from 1.
    tick: (u64, Arc<str>),
    status: (u64, Arc<str>),
    has_ended: bool,
    browsers: usize,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        // Every change of the state is a single assignment, so a panic leaves the state whole.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state());
        self.changed.notify_all();
    }
}

/// A random token.
fn token() -> io::Result<String> {
    let mut bytes = [0; TOKEN_BYTES];
    std::fs::File::open("/dev/urandom").and_then(|mut file| io::Read::read_exact(&mut file, &mut bytes))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

impl Live {
    /// Serves the page on an address. Other machines can reach an address that is not of the loopback
    /// interface, so the page's URL then has a token. `hello` is JSON that each browser receives first.
    ///
    /// # Errors
    /// The system's error if the address is taken or does not belong to this machine.
    pub fn serve(address: SocketAddr, hello: &str) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let token = (!address.ip().is_loopback()).then(token).transpose()?;
        let live = Self { shared: Arc::default(), address: listener.local_addr()?, token: token.clone() };
        live.shared.change(|state| state.hello = hello.into());
        let shared = Arc::clone(&live.shared);
        let next = move || listener.accept().map(|(stream, _)| stream);
        http::accept("view", next, move |stream, request| {
            answer(stream, request.as_ref(), token.as_deref(), &shared)
        })?;
        Ok(live)
    }

    /// The page's URL.
    #[must_use]
    pub fn url(&self) -> String {
        let token = self.token.as_ref().map(|token| format!("?token={token}"));
        format!("http://{}/{}", self.address, token.unwrap_or_default())
    }

    /// Number of browsers that watch.
    #[must_use]
    pub fn browsers(&self) -> usize {
        self.shared.state().browsers
    }

    /// Waits until a browser watches, at most `limit`. Returns whether one does.
    #[must_use]
    pub fn wait_for_browser(&self, limit: Duration) -> bool {
        let waited = self.shared.changed.wait_timeout_while(self.shared.state(), limit, |s| s.browsers == 0);
        waited.unwrap_or_else(PoisonError::into_inner).0.browsers > 0
    }

    /// Shows a tick, as JSON on one line.
    pub fn tick(&self, json: &str) {
        self.shared.change(|state| state.tick = (state.tick.0 + 1, json.into()));
    }

    /// Shows a status, as JSON on one line.
    pub fn status(&self, json: &str) {
        self.shared.change(|state| state.status = (state.status.0 + 1, json.into()));
    }

    /// Reports the end of the run and waits until all browsers have received it, at most `limit`.
    pub fn end(&self, limit: Duration) {
        self.shared.change(|state| state.has_ended = true);
        drop(self.shared.changed.wait_timeout_while(self.shared.state(), limit, |state| state.browsers > 0));
    }
}

/// Whether a request addresses this machine by number or as localhost. Other names may be those of a foreign
/// page that had its own name point here.
#[must_use]
pub fn is_direct(request: &Request) -> bool {
    let Some(host) = request.header("host") else { return true };
    let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
    name == "localhost" || host.parse::<SocketAddr>().is_ok() || name.parse::<std::net::IpAddr>().is_ok()
}

fn answer(
    mut stream: TcpStream,
    request: Option<&Request>,
    token: Option<&str>,
    shared: &Shared,
) -> io::Result<()> {
    let refuse = |stream: &mut TcpStream, status: &str, why: &str| {
        respond(stream, "GET", status, (PLAIN, ""), &format!("{why}\n"))
    };
    let Some(request) = request else {
        return refuse(&mut stream, "400 Bad Request", "not a request, or too long");
    };
    if !matches!(request.method(), "GET" | "HEAD") {
        return refuse(&mut stream, "405 Method Not Allowed", "only GET is answered");
    }
    if !is_direct(request) || token.is_some_and(|token| request.query("token") != Some(token)) {
        return refuse(&mut stream, "403 Forbidden", "use the URL that stgdat view has printed");
    }
    match request.path() {
        "/" => {
            let kind = ("text/html; charset=utf-8", HEADERS);
            respond(&mut stream, request.method(), "200 OK", kind, &crate::live_page())
        }
        "/events" if request.method() == "GET" => {
            shared.change(|state| state.browsers += 1);
            let followed = follow(stream, shared);
            shared.change(|state| state.browsers -= 1);
            followed
        }
        _ => refuse(&mut stream, "404 Not Found", "there is only the page"),
    }
}

/// What a browser receives next.
#[derive(Debug, Default)]
struct News {
    tick: Option<Arc<str>>,
    status: Option<Arc<str>>,
    has_ended: bool,
}

/// Sends events until the run ends or the browser is gone.
fn follow(mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_write_timeout(Some(WRITE_LIMIT))?;
    stream.set_nodelay(true)?;
    let head = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nConnection: \
                close\r\n\r\nretry: 1000\n\n";
    stream.write_all(head.as_bytes())?;
    let hello = Arc::clone(&shared.state().hello);
    write!(stream, "event: hello\ndata: {hello}\n\n")?;
    // A browser begins with the newest tick.
    let (mut ticks, mut statuses, mut missed) = (shared.state().tick.0.saturating_sub(1), 0, 0);
    loop {
        let idle =
            |state: &mut State| state.tick.0 == ticks && state.status.0 == statuses && !state.has_ended;
        let waited = shared.changed.wait_timeout_while(shared.state(), ALIVE, idle);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let mut news = News { has_ended: state.has_ended, ..News::default() };
        if state.tick.0 > ticks {
            missed += state.tick.0 - ticks - 1;
            ticks = state.tick.0;
            news.tick = Some(Arc::clone(&state.tick.1));
        }
        if state.status.0 > statuses {
            statuses = state.status.0;
            news.status = Some(Arc::clone(&state.status.1));
        }
        drop(state);
        send(&mut stream, &news, missed)?;
        if news.has_ended {
            return Ok(());
        }
    }
}

fn send(stream: &mut TcpStream, news: &News, missed: u64) -> io::Result<()> {
    if let Some(status) = &news.status {
        write!(stream, "event: status\ndata: {status}\n\n")?;
    }
    if let Some(tick) = &news.tick {
        write!(stream, "event: tick\ndata: {{\"missed\":{missed},\"scene\":{tick}}}\n\n")?;
    }
    if news.has_ended {
        return stream.write_all(b"event: end\ndata: {}\n\n");
    }
    if news.tick.is_none() && news.status.is_none() {
        stream.write_all(b": alive\n\n")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader, Read as _};

    use super::*;

    fn serve(address: &str) -> Live {
        Live::serve(address.parse().unwrap(), "{\"run\":\"a\"}").unwrap()
    }

    fn ask(live: &Live, target: &str, host: &str) -> TcpStream {
        let mut stream = TcpStream::connect(("127.0.0.1", live.address.port())).unwrap();
        write!(stream, "GET {target} HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
        stream
    }

    fn answer_of(live: &Live, target: &str, host: &str) -> String {
        let mut text = String::new();
        ask(live, target, host).read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn the_page_is_served_and_a_foreign_name_is_refused() {
        let live = serve("127.0.0.1:0");
        let page = answer_of(&live, "/", "127.0.0.1:1");
        assert!(page.starts_with("HTTP/1.1 200 OK") && page.contains("default-src 'none'"));
        assert!(page.ends_with("</html>\n") && !page.contains("https://"), "no address is in the page");
        assert!(answer_of(&live, "/", "evil.example").starts_with("HTTP/1.1 403"));
        assert!(answer_of(&live, "/x", "localhost:1").starts_with("HTTP/1.1 404"));
        assert_eq!(live.url(), format!("http://{}/", live.address));
    }

    #[test]
    fn an_address_that_others_reach_needs_the_token() {
        let live = serve("0.0.0.0:0");
        let token = live.token.clone().unwrap();
        assert!(token.len() == 32 && live.url().ends_with(&token));
        assert!(answer_of(&live, "/", "10.0.0.1:1").starts_with("HTTP/1.1 403"));
        assert!(answer_of(&live, "/events?token=0", "10.0.0.1:1").starts_with("HTTP/1.1 403"));
        assert!(answer_of(&live, &format!("/?token={token}"), "10.0.0.1:1").starts_with("HTTP/1.1 200"));
    }

    #[test]
    fn a_slow_browser_gets_the_newest_tick_and_the_number_that_it_missed() {
        let live = serve("127.0.0.1:0");
        live.tick("0");
        let mut browser = BufReader::new(ask(&live, "/events", "127.0.0.1")).lines();
        assert!(live.wait_for_browser(Duration::from_secs(10)));
        let mut data = |event: &str| {
            let mut lines = browser.by_ref().map(|line| line.unwrap());
            lines.find(|line| *line == format!("event: {event}")).unwrap();
            lines.next().unwrap()
        };
        assert_eq!(data("hello"), "data: {\"run\":\"a\"}");
        assert_eq!(data("tick"), "data: {\"missed\":0,\"scene\":0}");
        // Ticks of 1 MB overflow the socket while the browser does not read.
        let large = "1".repeat(1 << 20);
        (0..64).for_each(|_| live.tick(&large));
        live.status("{}");
        live.tick("2");
        let newest = loop {
            let tick = data("tick");
            if tick.ends_with(":2}") {
                break tick;
            }
        };
        assert_ne!(newest, "data: {\"missed\":0,\"scene\":2}");
        live.end(Duration::from_secs(10));
        assert_eq!(data("end"), "data: {}");
        assert_eq!(live.browsers(), 0);
    }
}
