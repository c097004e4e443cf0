//! Finds the dead processes of a run by the files of their nodes.
//!
//! Every process that joins a run has a *node*: files `NUMBER.node_monitor…` in the folder `nodes` of the
//! run, and a folder NUMBER that lists what the process has opened. The process keeps the first file locked
//! until it ends. When a process dies, the lock disappears and the files remain. The lock shows a death in
//! any container that sees the folder.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

use iceoryx2::node::{DeadNodeView, NodeState, NodeView};
use iceoryx2::prelude::{
    CallbackProgression, Config, FileName, Path as TransportPath, SemanticString, SemanticStringError, ipc,
};
use run::Run;
use rustix::process::{Flock, FlockType, fcntl_getlk};

use crate::half_made::is_older;

/// The folder of the nodes in a run's directory.
const NODES: &str = "nodes";
/// The part after the number in the names of a node's files.
const MONITOR: &str = ".node_monitor";
/// A node takes less than a millisecond from its first file to its lock.
const YOUNG: Duration = Duration::from_millis(100);
/// Files that are unlocked and unchanged for this time will not be finished.
const FRAGMENT_AGE: Duration = Duration::from_secs(2);

/// The number of a node.
pub type NodeNumber = u128;

/// The process of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeProcess {
    /// The node's name.
    pub name: String,
    /// The file name of the program.
    pub program: String,
    /// The process number.
    pub pid: u32,
}

/// Looks for the dead nodes of a run.
#[derive(Debug)]
pub struct NodeWatch {
    folder: PathBuf,
    prefix: String,
    config: Config,
}

impl NodeWatch {
    /// Creates a watch on the nodes of a run.
    ///
    /// # Errors
    /// [`PortError`](crate::PortError) if the run's paths can't be used.
    pub fn new(run: &Run) -> Result<Self, crate::PortError> {
        let config = transport_config(&run.prefix, &run.root)
            .map_err(crate::PortError::of_node("paths of the run"))?;
        Ok(Self { folder: run.root.join(NODES), prefix: run.prefix.clone(), config })
    }

    /// The nodes whose processes have died, and the remains of processes that were killed while they created
    /// their node. Takes three system calls for each node.
    #[must_use]
    pub fn dead(&self) -> Vec<NodeNumber> {
        let nodes = parts(&self.folder, &self.prefix);
        let is_dead = |(number, parts): &(NodeNumber, Parts)| {
            !is_own(*number)
                && match &parts.monitor {
                    Some(monitor) => parts.are_older(YOUNG) && !is_locked(monitor),
                    None => parts.are_older(FRAGMENT_AGE),
                }
        };
        nodes.into_iter().filter(is_dead).map(|(number, _)| number).collect()
    }

    /// The processes of dead nodes, if their files name them.
    #[must_use]
    pub fn processes(&self, dead: &[NodeNumber]) -> BTreeMap<NodeNumber, NodeProcess> {
        let mut processes = BTreeMap::new();
        let take = |state: NodeState<ipc::Service>| {
            let number = state.node_id().value();
            if let NodeState::Dead(node) = &state
                && dead.contains(&number)
            {
                processes.extend(process_of(node).map(|process| (number, process)));
            }
            CallbackProgression::Continue
        };
        // Fails while another process removes a node: the names are only for people.
        let _ = iceoryx2::node::Node::<ipc::Service>::list(&self.config, take);
        processes
    }
}

/// The transport's settings for a run: the run's own names and directory, and no clean-up by the stages. A
/// clean-up could block on a file that a killed process left half written.
pub(crate) fn transport_config(prefix: &str, root: &Path) -> Result<Config, SemanticStringError> {
    let mut config = Config::global_config().clone();
    config.global.prefix = FileName::new(prefix.as_bytes())?;
    config.global.set_root_path(&TransportPath::new(root.as_os_str().as_encoded_bytes())?);
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    Ok(config)
}

/// The process of a dead node, if the node's files name it.
fn process_of(node: &DeadNodeView<ipc::Service>) -> Option<NodeProcess> {
    let details = node.details().as_ref()?;
    let name = details.name().as_str().to_owned();
    let program = String::from_utf8_lossy(details.executable().as_bytes()).into_owned();
    Some(NodeProcess { name, program, pid: pid_of(node.id().value()) })
}

/// Frees the resources of dead nodes. Calls `found` with each node before its files are removed, if they name
/// its process. Returns the number of nodes that were cleaned, and the number that could not be.
pub(crate) fn clean(config: &Config, found: &mut impl FnMut(NodeNumber, &NodeProcess)) -> (u64, u64) {
    let (mut cleaned, mut failed) = (0, 0);
    let clean = |state: NodeState<ipc::Service>| {
        if let NodeState::Dead(node) = state {
            if let Some(process) = process_of(&node) {
                found(node.id().value(), &process);
            }
            match node.blocking_remove_stale_resources(Duration::ZERO) {
                Ok(()) => cleaned += 1,
                Err(_) => failed += 1,
            }
        }
        CallbackProgression::Continue
    };
    // Fails while another process removes a node: the next clean-up handles the rest.
    let _ = iceoryx2::node::Node::<ipc::Service>::list(config, clean);
    (cleaned, failed)
}

/// Removes the remains of nodes whose processes were killed while they created the nodes or cleaned up after
/// them. The transport takes these nodes for ones that are still being created. Returns the number of removed
/// nodes.
pub(crate) fn remove_fragments(run: &Run) -> usize {
    let folder = run.root.join(NODES);
    let nodes = parts(&folder, &run.prefix).into_iter().filter(|(number, parts)| {
        let is_locked = || parts.monitor.as_deref().is_some_and(is_locked);
        !is_own(*number) && parts.are_older(FRAGMENT_AGE) && !is_locked() && !parts.has_opened()
    });
    nodes.filter(|(_, parts)| parts.remove()).count()
}

/// The files of a node.
#[derive(Debug, Default)]
struct Parts {
    /// The file that the node's process keeps locked.
    monitor: Option<PathBuf>,
    /// Further files of that name.
    others: Vec<PathBuf>,
    /// Folder.
    folder: Option<PathBuf>,
}

impl Parts {
    /// Whether the node's folder lists ports or services: only the transport can free these places.
    fn has_opened(&self) -> bool {
        let entries = self.folder.as_ref().and_then(|folder| std::fs::read_dir(folder).ok());
        // The process's description is the only other file.
        entries.into_iter().flatten().filter_map(Result::ok).nth(1).is_some()
    }

    /// Whether all files are older than `age`; the folder changes when the process opens something.
    fn are_older(&self, age: Duration) -> bool {
        let files = self.monitor.iter().chain(&self.others);
        let folder = self.folder.iter().filter(|_| self.monitor.is_none());
        let is_older = |path: &PathBuf| std::fs::metadata(path).is_ok_and(|found| is_older(&found, age));
        files.chain(folder).all(is_older)
    }

    /// All files and then the folder.
    fn files(&self) -> impl Iterator<Item = &PathBuf> {
        self.monitor.iter().chain(&self.others).chain(&self.folder)
    }

    fn remove(&self) -> bool {
        let removed = |path: &PathBuf| match self.folder.as_ref() == Some(path) {
            true => std::fs::remove_dir_all(path).is_ok(),
            false => std::fs::remove_file(path).is_ok(),
        };
        self.files().filter(|path| removed(path)).count() > 0
    }
}

/// The nodes of a folder.
fn parts(folder: &Path, prefix: &str) -> BTreeMap<NodeNumber, Parts> {
    let mut nodes = BTreeMap::<NodeNumber, Parts>::new();
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    for path in entries.map(|entry| entry.path()) {
        let Some(name) = path.file_name().and_then(OsStr::to_str) else { continue };
        if let Ok(number) = name.parse() {
            nodes.entry(number).or_default().folder = Some(path);
        } else if let Some((number, rest)) =
            name.strip_prefix(prefix).and_then(|name| name.split_once(MONITOR))
            && let Ok(number) = number.parse()
        {
            let node = nodes.entry(number).or_default();
            if rest.is_empty() { node.monitor = Some(path) } else { node.others.push(path) }
        }
    }
    nodes
}

/// The number of the process that made a node: the transport numbers nodes by time, process and a counter.
fn pid_of(number: NodeNumber) -> u32 {
    (number >> 64) as u32
}

/// Whether this process created the node. Its files must not be opened here: closing one releases the lock.
fn is_own(number: NodeNumber) -> bool {
    pid_of(number) == std::process::id()
}

/// Whether another process keeps a file locked.
fn is_locked(path: &Path) -> bool {
    // A file that can't be opened is being removed, or belongs to another user.
    let Ok(file) = File::options().write(true).open(path) else { return true };
    fcntl_getlk(&file, &Flock::from(FlockType::WriteLock)).map_or(true, |found| found.is_some())
}
