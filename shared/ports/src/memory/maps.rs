//! The mappings of a process, as /proc/self/maps and smaps list them.

use std::fs::File;
use std::io::Read as _;
use std::ops::Range;

/// What a mapping is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Private writable memory of the process: heap, stacks and other memory.
    Own,
    /// Shared memory.
    Segment {
        /// Whether this process may write it.
        writable: bool,
    },
    /// Programs, libraries, files and reserved addresses.
    Other,
}

/// A range of addresses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Mapping {
    pub start: usize,
    pub len: usize,
    pub kind: Kind,
    pub path: String,
    /// Offset in the mapped file.
    pub offset: u64,
    /// Bytes used since [`forget_use`], if read from smaps; 0 if read from maps.
    pub used: usize,
}

impl Mapping {
    pub fn range(&self) -> Range<usize> {
        self.start..self.start + self.len
    }

    /// `START-END PERMISSIONS OFFSET DEVICE INODE  PATH`.
    fn parse(line: &str) -> Option<Self> {
        let mut fields = line.split_ascii_whitespace();
        let (start, end) = fields.next()?.split_once('-')?;
        let [start, end] = [start, end].map(|address| usize::from_str_radix(address, 16).ok());
        let (start, end, rights) = (start?, end?, fields.next()?);
        let offset = u64::from_str_radix(fields.next()?, 16).ok()?;
        let path = fields.nth(2).unwrap_or_default();
        let (readable, writable) = (rights.starts_with('r'), rights[1..].starts_with('w'));
        let (shared, named) = (rights.ends_with('s'), path.starts_with('/'));
        let kind = match path {
            _ if shared && readable && path.starts_with("/dev/shm/") => Kind::Segment { writable },
            // Special areas of the kernel (such as [vvar]) can't be written.
            _ if !shared && !named && readable && writable => Kind::Own,
            _ => Kind::Other,
        };
        let len = end.checked_sub(start)?;
        Some(Self { start, len, kind, path: path.to_owned(), offset, used: 0 })
    }
}

/// The mappings that a file of /proc lists.
pub(super) fn read(path: &str) -> Vec<Mapping> {
    parse(&text_of(path))
}

fn parse(text: &str) -> Vec<Mapping> {
    let mut mappings: Vec<Mapping> = Vec::new();
    for line in text.lines() {
        match line.split_once(':') {
            // A line of smaps about the previous mapping.
            Some((key, value)) if !key.contains(' ') => {
                if let Some(mapping) = mappings.last_mut().filter(|_| key == "Referenced") {
                    let kib = value.split_ascii_whitespace().next().and_then(|kib| kib.parse::<usize>().ok());
                    mapping.used = kib.unwrap_or(0) << 10;
                }
            }
            _ => mappings.extend(Mapping::parse(line)),
        }
    }
    mappings
}

/// Makes the kernel reset its marks of used pages; `false` if it does not.
pub(super) fn forget_use() -> bool {
    std::fs::write("/proc/self/clear_refs", "1").is_ok()
}

/// Calls `lock` for mappings until `limit` bytes are reached, in descending order of their used share.
/// Returns the used bytes that are locked, and the used bytes that are not.
pub(super) fn within(
    mut used: Vec<Mapping>,
    limit: usize,
    mut lock: impl FnMut(&Mapping) -> bool,
) -> (usize, usize) {
    let share = |mapping: &Mapping| mapping.used as f64 / mapping.len.max(1) as f64;
    used.sort_by(|a, b| share(b).total_cmp(&share(a)));
    let (mut room, mut locked, mut left) = (limit, 0, 0);
    for mapping in &used {
        if mapping.len <= room && lock(mapping) {
            room -= mapping.len;
            locked += mapping.used;
        } else {
            left += mapping.used;
        }
    }
    (locked, left)
}

/// The whole content of a file of /proc; empty if it can't be read.
pub(super) fn text_of(path: &str) -> String {
    let mut text = String::new();
    // A text with an odd path is discarded as a whole: then nothing is populated.
    let _ = File::open(path).and_then(|mut file| file.read_to_string(&mut text));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMAPS: &str = "\
5606d22d1000-5606d2376000 rw-p 00000000 00:00 0                          [heap]
Size:                660 kB
Rss:                 592 kB
Referenced:          300 kB
VmFlags: rd wr mr mw me ac
7feeb2ec4000-7feeb40c8000 rw-p 00000000 00:00 0
Referenced:           64 kB
7feeb0b6e000-7feeb206f000 rw-s 00001000 00:1b 207                        /dev/shm/stgdat_2a1c731f_0354__1.data
Referenced:            0 kB
7feeb207f000-7feeb24cc000 r--s 00000000 00:1b 128                        /dev/shm/stgdat_2a1c731f_0354__0.data
7f4808021000-7f480c000000 ---p 00000000 00:00 0
5606c828a000-5606c97cc000 r-xp 0096f000 fe:00 10035204                   /usr/bin/a program
7ffe0ece0000-7ffe0ece4000 r--p 00000000 00:00 0                          [vvar]
";

    #[test]
    fn mappings_are_what_they_are_for() {
        let mappings = parse(SMAPS);
        let kinds: Vec<Kind> = mappings.iter().map(|mapping| mapping.kind).collect();
        let (own, other) = (Kind::Own, Kind::Other);
        let segments = [true, false].map(|writable| Kind::Segment { writable });
        assert_eq!(kinds, [own, own, segments[0], segments[1], other, other, other]);
        assert_eq!(mappings[0].range(), 0x5606_d22d_1000..0x5606_d237_6000);
        assert_eq!((mappings[0].used, mappings[1].used, mappings[2].used), (300 << 10, 64 << 10, 0));
        assert_eq!((mappings[2].offset, &*mappings[3].path), (4096, "/dev/shm/stgdat_2a1c731f_0354__0.data"));
    }

    #[test]
    fn the_most_used_mappings_are_locked_within_the_limit() {
        let mapping =
            |start, len, used| Mapping { start, len, used, kind: Kind::Own, path: String::new(), offset: 0 };
        let used = vec![mapping(1, 80, 8), mapping(2, 40, 40), mapping(3, 40, 30), mapping(4, 10, 5)];
        let mut order = Vec::new();
        let result = within(used.clone(), 60, |mapping| {
            order.push(mapping.start);
            true
        });
        assert_eq!((result, order), ((45, 38), vec![2, 4]));
        assert_eq!(within(used, 60, |_| false), (0, 83), "what the kernel refuses is left");
    }

    #[test]
    fn this_process_has_memory_of_its_own() {
        let mappings = read("/proc/self/maps");
        let here = std::ptr::from_ref(&mappings).addr();
        let stack = mappings.iter().find(|mapping| mapping.range().contains(&here)).expect("a stack");
        assert_eq!(stack.kind, Kind::Own);
    }
}
