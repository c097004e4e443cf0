//! The second user: what it tries, and what it could do.

use std::fs::{File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::os::unix::fs::{MetadataExt as _, symlink};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use rustix::fs::inotify::{self, CreateFlags, WatchFlags};
use serde::{Deserialize, Serialize};

/// The environment variable that selects an attack.
pub const VARIABLE: &str = "STGDAT_ATTACK";
/// Printed when the attack has begun, and before its result.
pub const READY: &str = "attack begins";
pub const RESULT: &str = "attack result ";

/// The folders with files of runs.
const FOLDERS: [&str; 2] = ["/dev/shm", "/tmp"];
/// Names in shared memory that follow from a prefix.
const FOLLOWING: [&str; 4] = [
    "9204dd183d1c4d8e1ff592a30766ffa6765aa8b5_node.0_10_0.global_mgmt",
    "sampler_kept",
    "lock",
    "00000000_sampler_kept",
];
/// Length of the names' part that all files of a run in shared memory have: `stgdat_`, eight digits, `_`, eight
/// digits, `_`.
const PREFIX_LEN: usize = 25;
const SOCKETS: [&str; 3] = ["status", "tap", "control"];

/// Set once the parent has closed standard input.
static IS_OVER: AtomicBool = AtomicBool::new(false);

/// What the attacker tried and could do.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Seen {
    /// Operations.
    pub tried: usize,
    /// Names taken in advance, or files that filled the memory.
    pub taken: usize,
    /// Files that could be read or written.
    pub opened: Vec<PathBuf>,
    /// Files that could be removed or renamed.
    pub removed: Vec<PathBuf>,
    /// Sockets that answered.
    pub connected: Vec<PathBuf>,
    /// Processes that could be signalled or read.
    pub touched: Vec<String>,
}

impl Seen {
    /// Tries to open a file.
    fn try_open(&mut self, path: &Path) {
        self.opened.extend(open(path).map(|_| path.to_owned()));
    }

    /// The number of successful attempts.
    pub fn successes(&self) -> usize {
        self.opened.len() + self.removed.len() + self.connected.len() + self.touched.len()
    }
}

/// Attacks as the environment demands, until standard input is closed.
pub fn attack() {
    let Ok(what) = std::env::var(VARIABLE) else { return };
    std::thread::spawn(|| {
        let _ = std::io::stdin().read(&mut [0]);
        IS_OVER.store(true, Relaxed);
    });
    let seen = match what.split_once(' ') {
        Some(("fill", folder)) => fill(Path::new(folder), 1 << 20),
        Some((_, folder)) => fill(Path::new(folder), 0),
        None if what == "race" => race(),
        None => intrude(),
    };
    println!("{RESULT}{}", serde_json::to_string(&seen).expect("names are text"));
}

fn begin() {
    println!("{READY}");
    std::io::stdout().flush().expect("the test reads it");
}

/// Watches the folders, and takes every name that follows from a new one.
fn race() -> Seen {
    let watch = inotify::init(CreateFlags::CLOEXEC | CreateFlags::NONBLOCK).expect("Linux has inotify");
    for folder in FOLDERS {
        inotify::add_watch(&watch, folder, WatchFlags::CREATE).expect("everybody may list it");
    }
    begin();
    let mut seen = Seen::default();
    let mut buffer = [std::mem::MaybeUninit::uninit(); 4_096];
    let mut reader = inotify::Reader::new(&watch, &mut buffer);
    while !IS_OVER.load(Relaxed) {
        let Ok(event) = reader.next() else { continue };
        let Some(name) = event.file_name().and_then(|name| name.to_str().ok()) else { continue };
        if let Some(run) = name.trim_start_matches('.').get(..15).filter(|name| name.starts_with("stgdat_")) {
            // The transport itself would open this file for everybody a moment after its creation.
            let tries = if name.ends_with(".global_mgmt") { 200 } else { 1 };
            (0..tries).for_each(|_| seen.try_open(&Path::new("/dev/shm").join(name)));
            take_names(run, name, &mut seen);
        }
    }
    seen
}

/// Takes the names that follow from the name of a run and of one of its files.
fn take_names(run: &str, name: &str, seen: &mut Seen) {
    let prefix = name.get(..PREFIX_LEN).filter(|prefix| prefix.ends_with('_')).unwrap_or("stgdat_");
    let shared = [format!("{run}_"), prefix.to_owned()];
    let shared = shared.iter().flat_map(|prefix| FOLLOWING.map(|rest| format!("/dev/shm/{prefix}{rest}")));
    for path in shared {
        seen.tried += 1;
        seen.taken += usize::from(File::create_new(&path).is_ok());
    }
    for path in [format!("/tmp/{run}"), format!("/tmp/.{run}")] {
        seen.tried += 1;
        let is_taken = if seen.tried.is_multiple_of(2) {
            std::fs::create_dir(&path).is_ok()
        } else {
            symlink("/etc", &path).is_ok()
        };
        seen.taken += usize::from(is_taken);
    }
}

/// Opens a file of another user for reading or writing.
fn open(path: &Path) -> Option<File> {
    let is_foreign = std::fs::symlink_metadata(path).is_ok_and(|found| found.uid() != uid());
    let mut file = is_foreign.then(|| OpenOptions::new().read(true).write(true).open(path).ok()).flatten();
    if let Some(file) = &mut file {
        let _ = file.write_all(&[0xAA; 16]);
    }
    let file = file.or_else(|| is_foreign.then(|| File::open(path).ok()).flatten());
    file.filter(|file| file.metadata().is_ok_and(|found| found.is_file()))
}

fn uid() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// Tries every file, socket and process of the run again and again.
fn intrude() -> Seen {
    begin();
    let mut seen = Seen::default();
    while !IS_OVER.load(Relaxed) {
        for folder in FOLDERS {
            for path in std::fs::read_dir(folder)
                .expect("everybody may list it")
                .filter_map(|entry| Some(entry.ok()?.path()))
            {
                let name = path.file_name().expect("it is in a folder").to_string_lossy().into_owned();
                if name.trim_start_matches('.').starts_with("stgdat_") {
                    intrude_file(&path, &mut seen);
                }
            }
        }
        intrude_processes(&mut seen);
        std::thread::sleep(Duration::from_millis(10));
    }
    seen
}

fn intrude_file(path: &Path, seen: &mut Seen) {
    seen.tried += 4;
    seen.try_open(path);
    if std::fs::read_dir(path).is_ok() || File::create_new(path.join("x")).is_ok() {
        seen.opened.push(path.to_owned());
    }
    let moved = path.with_file_name("taken");
    if std::fs::remove_file(path).is_ok() || std::fs::rename(path, moved).is_ok() {
        seen.removed.push(path.to_owned());
    }
    for socket in SOCKETS {
        if UnixStream::connect(path.join(socket)).is_ok() {
            seen.connected.push(path.join(socket));
        }
    }
}

fn intrude_processes(seen: &mut Seen) {
    for entry in std::fs::read_dir("/proc").expect("Linux has it").filter_map(Result::ok) {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let line = std::fs::read_to_string(entry.path().join("cmdline")).unwrap_or_default();
        let is_stage = line.starts_with("/tmp/stgdat\0") || line.starts_with("/proc/self/exe\0");
        if !is_stage || entry.metadata().is_ok_and(|found| found.uid() == uid()) {
            continue;
        }
        seen.tried += 3;
        let stop = rustix::process::Signal::STOP;
        let is_signalled = rustix::process::Pid::from_raw(pid)
            .is_some_and(|pid| rustix::process::kill_process(pid, stop).is_ok());
        let is_read = ["environ", "mem"].iter().any(|file| File::open(entry.path().join(file)).is_ok());
        if is_signalled || is_read {
            seen.touched.push(line.replace('\0', " "));
        }
    }
}

/// Fills a folder with files of `size` bytes, and holds it full.
fn fill(folder: &Path, size: usize) -> Seen {
    let mine = folder.join("mine");
    std::fs::create_dir(&mine).expect("the folder is for everybody");
    let (block, mut seen, mut has_begun) = (vec![1; size], Seen::default(), false);
    while !IS_OVER.load(Relaxed) {
        seen.tried += 1;
        let written = File::create(mine.join(seen.tried.to_string())).and_then(|mut file| {
            let written = file.write_all(&block);
            // Every byte counts.
            while size > 0 && written.is_err() && file.write_all(&[1]).is_ok() {}
            written
        });
        if written.is_err() {
            seen.taken += 1;
            if !has_begun {
                begin();
                has_begun = true;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    std::fs::remove_dir_all(mine).expect("it is ours");
    seen
}
