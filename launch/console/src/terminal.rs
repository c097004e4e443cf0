//! A terminal: a table below the printed lines, or a whole screen with keys.

use std::fs::File;
use std::io::{self, IsTerminal, Read, stdout};
use std::time::Duration;

use crate::screen::Line;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcgetwinsize, tcsetattr};

use crate::color;
use crate::streams::{self, Stream};

/// Size that is assumed if the terminal does not report one.
const SIZE: [usize; 2] = [80, 24];
/// Longest sequence of bytes that is read at once.
const BYTES_MAX: usize = 64;
const HIDE_CURSOR: &str = "\x1b[?25l";
const SHOW_CURSOR: &str = "\x1b[?25h";
const CLEAR_LINE: &str = "\x1b[K";
const CLEAR_BELOW: &str = "\x1b[J";
/// Without wrapping, a line stays one line even if the terminal has just become too narrow for it.
const NO_WRAP: &str = "\x1b[?7l";
const WRAP: &str = "\x1b[?7h";
/// Switch to an empty screen, and back to the text before.
const ENTER: &str = "\x1b[?1049h";
const LEAVE: &str = "\x1b[?1049l";
const HOME: &str = "\x1b[H";

/// Columns and rows of the terminal at standard output.
pub fn size() -> [usize; 2] {
    let size = tcgetwinsize(stdout()).ok().filter(|size| size.ws_col > 0 && size.ws_row > 0);
    size.map_or(SIZE, |size| [size.ws_col.into(), size.ws_row.into()])
}

/// Writes to standard output. Returns false if the text is discarded: the terminal may be closed or stopped.
fn write(text: &str) -> bool {
    streams::write(Stream::Output, None, text)
}

/// A table at the bottom of the terminal, below the lines that were printed.
#[derive(Debug, Default)]
pub struct Table {
    /// The painted lines. The cursor is at the start of the line below them.
    shown: Vec<String>,
}

impl Table {
    /// Creates an empty table if standard output is a terminal that can move its cursor.
    pub fn on_output() -> Option<Self> {
        let is_dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        (stdout().is_terminal() && !is_dumb).then(Self::default)
    }

    /// Replaces the lines of the table, unless the terminal is stopped.
    pub fn draw(&mut self, lines: &[Line]) {
        let ([width, height], is_styled) = (size(), color::choice().is_on(&stdout()));
        let lines = lines.iter().take(height.saturating_sub(1));
        let lines: Vec<String> = lines.map(|line| line.paint(width, is_styled)).collect();
        if write(&repaint(self.shown.len(), None, &lines)) {
            self.shown = lines;
        }
    }

    /// Prints lines above the table. Returns false if the terminal is stopped.
    pub fn print(&self, lines: &str) -> bool {
        write(&repaint(self.shown.len(), Some(lines), &self.shown))
    }

    /// Removes the table.
    pub fn close(&self) {
        let _ = write(&(repaint(self.shown.len(), None, &[]) + SHOW_CURSOR));
    }
}

/// The text that replaces a table of `before` lines by `lines`, with a line printed above.
fn repaint(before: usize, above: Option<&str>, lines: &[String]) -> String {
    let mut text = HIDE_CURSOR.to_owned();
    if before > 0 {
        text += &format!("\x1b[{before}F");
    }
    if let Some(above) = above {
        text += &format!("{CLEAR_BELOW}{above}\n");
    }
    text += NO_WRAP;
    lines.iter().for_each(|line| text += &format!("{line}{CLEAR_LINE}\n"));
    text + WRAP + CLEAR_BELOW
}

/// A key that a view knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// A letter.
    Char(char),
    /// The arrow up.
    Up,
    /// The arrow down.
    Down,
    /// Return.
    Enter,
    /// Escape.
    Escape,
    /// Control with C.
    Interrupt,
}

/// The whole terminal, until it is dropped.
pub struct Screen {
    keyboard: File,
    before: Termios,
}

impl Screen {
    /// Takes over the terminal. A panic restores the terminal before it prints its message.
    ///
    /// # Errors
    /// An error of the system if the process has no terminal.
    pub fn open() -> io::Result<Self> {
        let keyboard = File::open("/dev/tty")?;
        let before = tcgetattr(&keyboard)?;
        let mut raw = before.clone();
        raw.make_raw();
        tcsetattr(&keyboard, OptionalActions::Now, &raw)?;
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            write(&format!("{SHOW_CURSOR}{LEAVE}"));
            hook(panic);
        }));
        write(&format!("{ENTER}{HIDE_CURSOR}"));
        Ok(Self { keyboard, before })
    }

    /// Shows lines, the first at the top.
    pub fn draw(&self, lines: &[Line], [width, height]: [usize; 2]) {
        let is_styled = color::choice().is_on(&stdout());
        let lines: Vec<String> =
            lines.iter().take(height).map(|line| line.paint(width, is_styled) + CLEAR_LINE).collect();
        write(&format!("{HOME}{NO_WRAP}{}{CLEAR_BELOW}{WRAP}", lines.join("\r\n")));
    }

    /// Returns the pressed keys. Waits for one for at most `limit`; a change of the terminal's size ends the
    /// wait.
    ///
    /// # Errors
    /// An error of the system if the terminal can't be read.
    pub fn keys(&mut self, limit: Duration) -> io::Result<Vec<Key>> {
        let mut ready = [PollFd::new(&self.keyboard, PollFlags::IN)];
        match poll(&mut ready, Timespec::try_from(limit).ok().as_ref()) {
            Ok(0) | Err(Errno::INTR) => return Ok(Vec::new()),
            polled => polled?,
        };
        let mut bytes = [0; BYTES_MAX];
        match self.keyboard.read(&mut bytes)? {
            0 => Err(io::ErrorKind::UnexpectedEof.into()),
            len => Ok(keys_of(&bytes[..len])),
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            write(&format!("{SHOW_CURSOR}{LEAVE}"));
        }
        let _ = tcsetattr(&self.keyboard, OptionalActions::Now, &self.before);
    }
}

/// The keys that a terminal sends as these bytes. Keys that no view knows are left out.
fn keys_of(mut bytes: &[u8]) -> Vec<Key> {
    let mut keys = Vec::new();
    while let [first, rest @ ..] = bytes {
        bytes = rest;
        match first {
            0x03 => keys.push(Key::Interrupt),
            b'\r' | b'\n' => keys.push(Key::Enter),
            0x1b => match rest {
                [b'[' | b'O', sequence @ ..] => {
                    // A sequence ends with its first byte from @ to ~.
                    let end = sequence.iter().position(|byte| matches!(byte, b'@'..=b'~'));
                    let end = end.unwrap_or(sequence.len());
                    match sequence.get(..=end) {
                        Some(b"A") => keys.push(Key::Up),
                        Some(b"B") => keys.push(Key::Down),
                        _ => {}
                    }
                    bytes = sequence.get(end + 1..).unwrap_or_default();
                }
                _ => keys.push(Key::Escape),
            },
            b' '..=b'~' => keys.push(Key::Char(char::from(*first))),
            _ => {}
        }
    }
    keys
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_of_a_terminal_are_keys() {
        assert_eq!(keys_of(b"q"), [Key::Char('q')]);
        assert_eq!(keys_of(b"\x1b[A\x1bOBjk"), [Key::Up, Key::Down, Key::Char('j'), Key::Char('k')]);
        assert_eq!(keys_of(b"\x1b"), [Key::Escape]);
        assert_eq!(keys_of(b"\r\x03"), [Key::Enter, Key::Interrupt]);
        assert_eq!(keys_of(b"\x1b[1;5A\x1b[3~s"), [Key::Char('s')], "keys that no view knows");
        assert_eq!(keys_of("ü\x1b[".as_bytes()), []);
    }

    #[test]
    fn a_table_is_painted_over_the_table_before() {
        let lines = ["a".to_owned(), "b".to_owned()];
        let first = repaint(0, None, &lines);
        assert!(!first.contains('F') && first.contains("a\x1b[K\nb\x1b[K\n"), "{first:?}");
        let next = repaint(2, Some("log"), &lines);
        let (up, rest) = next.split_once("\x1b[J").unwrap();
        assert!(up.ends_with("\x1b[2F") && rest.starts_with("log\n"), "{next:?}");
    }
}
