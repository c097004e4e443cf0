//! The files of the kernel that `stgdat doctor --realtime` reads.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Files with settings of the kernel and of this process. A `*` stands for any part of a name.
const PATTERNS: [&str; 25] = [
    "/proc/version",
    "/proc/cmdline",
    "/proc/swaps",
    "/proc/self/cgroup",
    "/proc/self/limits",
    "/proc/self/status",
    "/proc/irq/*/smp_affinity",
    "/proc/pressure/cpu",
    "/proc/pressure/io",
    "/proc/pressure/memory",
    "/proc/sys/kernel/sched_rt_runtime_us",
    "/proc/sys/kernel/sched_rt_period_us",
    "/proc/sys/vm/swappiness",
    "/sys/devices/system/clocksource/clocksource0/available_clocksource",
    "/sys/devices/system/clocksource/clocksource0/current_clocksource",
    "/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
    "/sys/devices/system/cpu/cpu0/cpuidle/state*/disable",
    "/sys/devices/system/cpu/cpu0/cpuidle/state*/latency",
    "/sys/devices/system/cpu/cpuidle/current_driver",
    "/sys/devices/system/cpu/isolated",
    "/sys/devices/system/cpu/nohz_full",
    "/sys/devices/system/cpu/online",
    "/sys/devices/system/cpu/smt/active",
    "/sys/kernel/mm/transparent_hugepage/enabled",
    "/sys/kernel/realtime",
];

/// Why a file has no content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Unread {
    /// The kernel has no such file.
    Missing,
    /// It exists, but can't be read.
    Refused(String),
}

/// The contents of files by their paths.
#[derive(Clone, Debug, Default)]
pub struct Files(pub BTreeMap<String, Result<String, Unread>>);

impl Files {
    /// Reads the files of this machine.
    pub fn of_this_machine() -> Self {
        let mut files = Self(PATTERNS.iter().flat_map(|pattern| expand(pattern)).map(read).collect());
        // The group of this process may have its own limit.
        let group = files.get("/proc/self/cgroup").ok().and_then(cpu_group);
        files.0.extend(group.map(read));
        files
    }

    /// The content of a file without the final line break.
    ///
    /// # Errors
    /// The reason, with the path.
    pub fn get<'a>(&'a self, path: &'a str) -> Result<&'a str, (Unread, &'a str)> {
        match self.0.get(path) {
            Some(Ok(text)) => Ok(text.trim_end()),
            Some(Err(why)) => Err((why.clone(), path)),
            None => Err((Unread::Missing, path)),
        }
    }

    /// The files whose path begins and ends with these texts.
    pub fn matching<'a>(
        &'a self,
        start: &'a str,
        end: &'a str,
    ) -> impl Iterator<Item = (&'a str, Result<&'a str, &'a Unread>)> {
        let is_it = move |path: &&String| path.starts_with(start) && path.ends_with(end);
        let content = |(path, text): (&'a String, &'a Result<String, Unread>)| {
            (path.as_str(), text.as_ref().map(|text| text.trim_end()))
        };
        self.0.iter().filter(move |(path, _)| is_it(path)).map(content)
    }
}

/// The file with the real-time limit of a process's group, from /proc/self/cgroup; `None` with cgroup v2,
/// which has no such limit.
pub fn cpu_group(cgroup: &str) -> Option<String> {
    cgroup.lines().find_map(|line| {
        let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
        let is_cpu = controllers.split(',').any(|controller| controller == "cpu");
        let path = path.trim_end_matches('/');
        is_cpu.then(|| format!("/sys/fs/cgroup/{controllers}{path}/cpu.rt_runtime_us"))
    })
}

fn read(path: impl AsRef<Path>) -> (String, Result<String, Unread>) {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path).map_err(|error| match error.kind() {
        ErrorKind::NotFound => Unread::Missing,
        _ => Unread::Refused(error.to_string()),
    });
    (path.display().to_string(), text)
}

/// The paths of a pattern in which each part of the path has at most one `*`. Without a `*` that is the path,
/// whether or not it exists.
fn expand(pattern: &str) -> Vec<PathBuf> {
    let mut paths = vec![PathBuf::from("/")];
    for part in pattern.split('/').filter(|part| !part.is_empty()) {
        paths = match part.split_once('*') {
            None => paths.into_iter().map(|path| path.join(part)).collect(),
            Some((start, end)) => paths.iter().flat_map(|path| entries(path, start, end)).collect(),
        };
    }
    paths
}

fn entries(folder: &Path, start: &str, end: &str) -> Vec<PathBuf> {
    let names = std::fs::read_dir(folder).into_iter().flatten().filter_map(|entry| {
        let name = entry.ok()?.file_name().into_string().ok()?;
        (name.len() >= start.len() + end.len() && name.starts_with(start) && name.ends_with(end))
            .then_some(name)
    });
    let mut paths: Vec<PathBuf> = names.map(|name| folder.join(name)).collect();
    paths.sort();
    paths
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_finds_what_exists_and_a_missing_file_is_not_readable() {
        let folder = std::env::temp_dir().join(format!("stgdat-doctor-{}", std::process::id()));
        for name in ["cpu0", "cpu1", "cpufreq"] {
            std::fs::create_dir_all(folder.join(name)).unwrap();
        }
        std::fs::write(folder.join("cpu0/governor"), "powersave\n").unwrap();
        let pattern = folder.join("cpu*/governor").display().to_string();
        let files = Files(expand(&pattern).into_iter().map(read).collect());
        let path = folder.join("cpu0/governor").display().to_string();
        assert_eq!(files.get(&path), Ok("powersave"));
        let missing = folder.join("cpu1/governor").display().to_string();
        assert_eq!(files.get(&missing), Err((Unread::Missing, missing.as_str())));
        let (_, unread) = read(&folder);
        assert!(matches!(unread, Err(Unread::Refused(_))), "a folder is no text");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn only_cgroup_v1_has_a_limit_of_the_group() {
        let v1 = "4:memory:/user\n3:cpu,cpuacct:/system.slice/a.service\n0::/x\n";
        let path = "/sys/fs/cgroup/cpu,cpuacct/system.slice/a.service/cpu.rt_runtime_us";
        assert_eq!(cpu_group(v1).as_deref(), Some(path));
        assert_eq!(cpu_group("2:cpu:/\n").as_deref(), Some("/sys/fs/cgroup/cpu/cpu.rt_runtime_us"));
        assert_eq!(cpu_group("0::/user.slice\n"), None);
        assert_eq!(cpu_group("2:cpuset:/\n"), None);
    }
}
