//! The files of the kernel that `stgdat doctor --realtime` reads.

use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};

/// The files of a machine, below the root of its file system.
#[derive(Debug)]
pub struct Files(pub PathBuf);

/// A file that has no content: its path, and why.
#[derive(Debug)]
pub struct Unread(pub String, pub Error);

impl Unread {
    /// The kernel has no such file.
    pub fn missing(path: &str) -> Self {
        Self(path.to_owned(), ErrorKind::NotFound.into())
    }

    /// Whether the kernel has no such file.
    pub fn is_missing(&self) -> bool {
        self.1.kind() == ErrorKind::NotFound
    }
}

impl Files {
    /// The content of a file without the final line break.
    pub fn get(&self, path: &str) -> Result<String, Unread> {
        match std::fs::read_to_string(self.path(path)) {
            Ok(text) => Ok(text.trim_end().to_owned()),
            Err(error) => Err(Unread(path.to_owned(), error)),
        }
    }

    /// The paths that match a pattern and whose folder exists, in order. A `*` stands for any part of a name;
    /// each name has at most one.
    pub fn matching(&self, pattern: &str) -> Vec<String> {
        let mut paths = vec![String::new()];
        for part in pattern.split('/').skip(1) {
            paths = match part.split_once('*') {
                None => paths.into_iter().map(|path| format!("{path}/{part}")).collect(),
                Some((start, end)) => paths.iter().flat_map(|path| self.entries(path, start, end)).collect(),
            };
        }
        paths.retain(|path| self.path(path).parent().is_some_and(Path::is_dir));
        paths
    }

    fn path(&self, path: &str) -> PathBuf {
        self.0.join(path.trim_start_matches('/'))
    }

    fn entries(&self, folder: &str, start: &str, end: &str) -> Vec<String> {
        let names = std::fs::read_dir(self.path(folder)).into_iter().flatten().filter_map(|entry| {
            let name = entry.ok()?.file_name().into_string().ok()?;
            (name.len() >= start.len() + end.len() && name.starts_with(start) && name.ends_with(end))
                .then_some(name)
        });
        let mut paths: Vec<String> = names.map(|name| format!("{folder}/{name}")).collect();
        paths.sort();
        paths
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_finds_what_exists_and_a_missing_file_is_not_readable() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["cpu0/cpufreq", "cpu1/cpufreq", "cpufreq"] {
            std::fs::create_dir_all(folder.path().join("sys").join(name)).unwrap();
        }
        std::fs::write(folder.path().join("sys/cpu0/cpufreq/governor"), "powersave\n").unwrap();
        std::fs::write(folder.path().join("sys/cpu_default"), "").unwrap();
        let files = Files(folder.path().to_owned());
        let [cpu0, cpu1] = ["/sys/cpu0/cpufreq/governor", "/sys/cpu1/cpufreq/governor"];
        assert_eq!(
            files.matching("/sys/cpu*/cpufreq/governor"),
            [cpu0, cpu1],
            "other names are no processors"
        );
        assert_eq!(files.get(cpu0).unwrap(), "powersave");
        let missing = files.get(cpu1).unwrap_err();
        assert!(missing.is_missing() && missing.0 == cpu1, "{missing:?}");
        assert!(!files.get("/sys/cpu0").unwrap_err().is_missing(), "a folder is no text");
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
