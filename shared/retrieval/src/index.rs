//! Keys by bucket, in runs of adjacent keys. A search reads one run at a time; a list of entries would wait
//! for memory at each entry.

use std::collections::{HashMap, VecDeque};

use crate::{Bucket, Key};

/// Number of keys in a run.
pub(crate) const RUN_LEN: usize = 8;

/// The keys of a memory's entries, by bucket and by number.
#[derive(Clone, Debug)]
pub(crate) struct KeyIndex {
    /// The newest run of each bucket.
    buckets: HashMap<Bucket, u32>,
    runs: Vec<Run>,
    /// Runs without stored entries.
    free: Vec<u32>,
    /// The run of each entry, oldest first.
    run_of: VecDeque<u32>,
}

/// Successive entries of a bucket, oldest first. Only a bucket's newest run may be partly filled.
#[derive(Clone, Debug)]
struct Run {
    numbers: [u64; RUN_LEN],
    keys: [Key; RUN_LEN],
    len: usize,
    /// The previous run, and the number of its first entry. If that run was reused since, its number differs.
    before: Option<(u32, u64)>,
}

impl Run {
    fn newest(&self) -> u64 {
        self.numbers[self.len - 1]
    }
}

impl KeyIndex {
    /// An empty index with space for `entries_max` entries, each in its own bucket.
    pub(crate) fn with_room(entries_max: usize) -> Self {
        Self {
            // If a table is at most half full, it replaces buckets without allocating.
            buckets: HashMap::with_capacity(2 * entries_max),
            runs: Vec::with_capacity(entries_max),
            free: Vec::with_capacity(entries_max),
            run_of: VecDeque::with_capacity(entries_max),
        }
    }

    /// Adds the key of the next entry.
    pub(crate) fn push(&mut self, number: u64, key: Key) {
        let bucket = key.bucket();
        let newest = self.buckets.get(&bucket).copied();
        if let Some(index) = newest {
            let run = &mut self.runs[index as usize];
            if run.len < RUN_LEN {
                (run.numbers[run.len], run.keys[run.len]) = (number, key);
                run.len += 1;
                self.run_of.push_back(index);
                return;
            }
        }
        let before = newest.map(|index| (index, self.runs[index as usize].numbers[0]));
        let run = Run { numbers: [number; RUN_LEN], keys: [key; RUN_LEN], len: 1, before };
        let index = match self.free.pop() {
            Some(index) => {
                self.runs[index as usize] = run;
                index
            }
            None => {
                self.runs.push(run);
                (self.runs.len() - 1) as u32
            }
        };
        self.buckets.insert(bucket, index);
        self.run_of.push_back(index);
    }

    /// Removes the oldest entry, which has this number.
    pub(crate) fn drop_oldest(&mut self, number: u64) {
        let Some(index) = self.run_of.pop_front() else { return };
        let run = &self.runs[index as usize];
        if run.newest() == number {
            let bucket = run.keys[0].bucket();
            if self.buckets.get(&bucket) == Some(&index) {
                self.buckets.remove(&bucket);
            }
            self.free.push(index);
        }
    }

    /// The key of an entry by its place and number; `None` if there is no such entry.
    pub(crate) fn key(&self, place: usize, number: u64) -> Option<&Key> {
        let run = &self.runs[*self.run_of.get(place)? as usize];
        let at = run.numbers[..run.len].iter().position(|&own| own == number)?;
        Some(&run.keys[at])
    }

    /// The buckets that have entries.
    pub(crate) fn buckets(&self) -> impl Iterator<Item = &Bucket> {
        self.buckets.keys()
    }

    /// The runs of a bucket, newest first, as numbers and keys, oldest first. Entries before the number
    /// `oldest` are left out.
    pub(crate) fn runs(&self, bucket: &Bucket, oldest: u64) -> impl Iterator<Item = (&[u64], &[Key])> {
        let newest = self.buckets.get(bucket).map(|&index| &self.runs[index as usize]);
        let before = move |run: &&Run| {
            let (index, first) = run.before?;
            let run = &self.runs[index as usize];
            (run.numbers[0] == first && run.newest() >= oldest).then_some(run)
        };
        std::iter::successors(newest, before).map(move |run| {
            let numbers = &run.numbers[..run.len];
            let from = numbers.partition_point(|&number| number < oldest);
            (&numbers[from..], &run.keys[from..run.len])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DisplacementKey;

    fn key(cell: u64, number: u64) -> Key {
        Key::Displacement(DisplacementKey {
            position_m: [5.0 * cell as f32, 1.0],
            velocity_mps: [number as f32, 0.0],
        })
    }

    #[test]
    fn buckets_hold_what_a_plain_list_would() {
        // Three buckets, one of them rarely used; 40 entries at a time, and then fewer and fewer.
        let cell_of = |number: u64| match number * 7 % 31 {
            0 => 2,
            draw => draw % 2,
        };
        let mut index = KeyIndex::with_room(40);
        let (mut oldest, mut next) = (0_u64, 0_u64);
        for turn in 0..2_000 {
            let wanted = if turn < 1_000 { 40 } else { 40 - 40 * (turn - 1_000) / 1_000 };
            while next - oldest >= wanted.max(1) {
                index.drop_oldest(oldest);
                oldest += 1;
            }
            index.push(next, key(cell_of(next), next));
            next += 1;
            for cell in 0..3 {
                let plain: Vec<u64> =
                    (oldest..next).rev().filter(|&number| cell_of(number) == cell).collect();
                let bucket = key(cell, 0).bucket();
                let found: Vec<u64> = index
                    .runs(&bucket, oldest)
                    .flat_map(|(numbers, _)| numbers.iter().rev().copied())
                    .collect();
                assert_eq!(found, plain, "bucket {cell} after {next} entries");
            }
            let keys = (oldest..next).map(|number| index.key((number - oldest) as usize, number).copied());
            assert!(keys.eq((oldest..next).map(|number| Some(key(cell_of(number), number)))));
        }
        assert!(index.runs.len() <= 40, "{} runs for 40 entries", index.runs.len());
    }
}
