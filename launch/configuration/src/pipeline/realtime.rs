//! `[realtime]`, and the keys of a stage that override it.
//!
//! The settings apply to the stages on a tick's way. Each further stage has a higher priority, so a tick that
//! is on its way passes before the next one starts.

use console::mistake::Mistake;
use supervisor::Scheduling;
use toml::Spanned;

use super::Stage;
use super::file::{File, Profile, RealtimeTable, StageTable};
use crate::realtime::Realtime;

/// The label of a processor that this machine lacks.
pub(super) const MISSING: &str = "not one of this machine's, or not allowed";
/// The first priority of `profile = "vehicle"`. A PREEMPT_RT kernel handles interrupts at 50; even a long
/// chain stays below.
const VEHICLE_PRIORITY: u8 = 30;

/// The processors of the stages on a tick's way.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Cpus {
    /// All of them.
    All,
    /// The processors that the machine has set aside, found at the start.
    Auto,
    Listed(Vec<u32>),
}

/// The processors, the priority and the memory of a stage, by its own keys.
pub(super) fn of_stage(table: &StageTable) -> Result<Scheduling, Mistake> {
    let cpus = match &table.cpu {
        None => Vec::new(),
        Some(list) => {
            listed(list, list.get_ref().iter().map(|cpu| (Some(*cpu.get_ref()), cpu.span())).collect())?
        }
    };
    let priority = table.priority.as_ref().map(priority).transpose()?.filter(|&priority| priority > 0);
    let memory_mib = table.memory_mib.as_ref().map(memory_mib).transpose()?;
    Ok(Scheduling { cpus, priority, memory_mib, unlocked: false })
}

/// Least limit of a stage's memory, MiB: a stage with its weights needs about 50.
const MEMORY_MIN_MIB: u64 = 64;

fn memory_mib(set: &Spanned<u64>) -> Result<u64, Mistake> {
    let is_possible = *set.get_ref() >= MEMORY_MIN_MIB;
    let advice = || format!("expected at least {MEMORY_MIN_MIB} MiB");
    is_possible
        .then_some(*set.get_ref())
        .ok_or_else(|| Mistake::new(set.span(), "a limit of memory is out of range", advice()))
}

/// Applies `[realtime]` to stages without own keys. A stage has a rank if it is on a tick's way.
pub(super) fn apply(file: &File, ranks: &[Option<u8>], stages: &mut [Stage]) -> Result<Realtime, Mistake> {
    let none = RealtimeTable::default();
    let table = file.realtime.as_ref().unwrap_or(&none);
    let is_vehicle = table.profile.as_ref().is_some_and(|profile| *profile.get_ref() == Profile::Vehicle);
    let first = match &table.priority {
        Some(set) => chain_priority(set, ranks)?,
        None if is_vehicle => VEHICLE_PRIORITY,
        None => 0,
    };
    let cpus = match &table.cpu {
        Some(set) => cpus(set)?,
        None if is_vehicle => Cpus::Auto,
        None => Cpus::All,
    };
    if let (Some(above), Some(inside)) = (&file.awake, &table.awake)
        && above.get_ref() != inside.get_ref()
    {
        let label = format!("`awake` above the first table is {}", above.get_ref());
        return Err(Mistake::new(inside.span(), "`awake` has two values", label));
    }
    let awake = table.awake.as_ref().or(file.awake.as_ref()).map_or(is_vehicle, |awake| *awake.get_ref());
    let mut realtime = Realtime { awake, lock: table.lock.unwrap_or(is_vehicle), auto_cpu: Vec::new() };
    let memory_mib = file.memory_mib.as_ref().map(memory_mib).transpose()?;
    for ((stage, own), rank) in stages.iter_mut().zip(&file.stages).zip(ranks) {
        // Programs of others, such as a detector, may need much more than the built-in stages.
        if stage.command.is_none() {
            stage.scheduling.memory_mib = stage.scheduling.memory_mib.or(memory_mib);
        }
        stage.scheduling.unlocked = table.lock == Some(false);
        let (own, Some(rank)) = (own.get_ref(), rank) else { continue };
        if own.priority.is_none() && first > 0 {
            stage.scheduling.priority = Some(first.saturating_add(*rank).min(Scheduling::PRIORITY_MAX));
        }
        match &cpus {
            _ if own.cpu.is_some() => {}
            Cpus::All => {}
            Cpus::Auto => realtime.auto_cpu.push(stage.id),
            Cpus::Listed(cpus) => stage.scheduling.cpus.clone_from(cpus),
        }
    }
    Ok(realtime)
}

/// Refuses processors of `[realtime]` that this machine does not have.
pub(super) fn check_here(file: &File, has_cpu: &dyn Fn(u32) -> bool) -> Result<(), Mistake> {
    let Some(set) = file.realtime.as_ref().and_then(|table| table.cpu.as_ref()) else { return Ok(()) };
    let Cpus::Listed(listed) = cpus(set)? else { return Ok(()) };
    match listed.into_iter().find(|&cpu| !has_cpu(cpu)) {
        Some(cpu) => Err(Mistake::new(set.span(), format!("the stages can't have processor {cpu}"), MISSING)),
        None => Ok(()),
    }
}

/// The priority of the first stage. The last stage has its priority plus the length of the chain.
fn chain_priority(set: &Spanned<u64>, ranks: &[Option<u8>]) -> Result<u8, Mistake> {
    let first = priority(set)?;
    let last = ranks.iter().flatten().max().copied().unwrap_or(0);
    if u32::from(first) + u32::from(last) > u32::from(Scheduling::PRIORITY_MAX) {
        let message = format!("the last stage would have priority {}", u32::from(first) + u32::from(last));
        let most = Scheduling::PRIORITY_MAX.saturating_sub(last);
        return Err(Mistake::new(set.span(), message, format!("expected 0 to {most}"))
            .help("each stage on a tick's way has one more than the stage before it"));
    }
    Ok(first)
}

/// Parses `"all"`, `"auto"` or a list.
fn cpus(set: &Spanned<toml::Value>) -> Result<Cpus, Mistake> {
    let numbers = match set.get_ref() {
        toml::Value::String(word) if word == "all" => return Ok(Cpus::All),
        toml::Value::String(word) if word == "auto" => return Ok(Cpus::Auto),
        toml::Value::Array(list) => list,
        other => {
            let message = format!("`cpu` can't be {other}");
            return Err(Mistake::new(
                set.span(),
                message,
                "expected \"auto\", \"all\" or a list such as [0, 1]",
            ));
        }
    };
    let number = |value: &toml::Value| value.as_integer().and_then(|number| u64::try_from(number).ok());
    listed(set, numbers.iter().map(|value| (number(value), set.span())).collect()).map(Cpus::Listed)
}

/// The numbers of processors in increasing order, each with its place in the text.
fn listed<T>(
    list: &Spanned<T>,
    numbers: Vec<(Option<u64>, std::ops::Range<usize>)>,
) -> Result<Vec<u32>, Mistake> {
    if numbers.is_empty() {
        let advice = "expected numbers of processors such as [0, 1]";
        return Err(Mistake::new(list.span(), "`cpu` is empty", advice));
    }
    let mut cpus = Vec::new();
    for (number, span) in numbers {
        let is_held = |&cpu: &u32| cpu <= Scheduling::CPU_MAX;
        let Some(cpu) = number.and_then(|number| u32::try_from(number).ok()).filter(is_held) else {
            let advice = format!("expected 0 to {}", Scheduling::CPU_MAX);
            return Err(Mistake::new(span, "no processor has such a number", advice));
        };
        if cpus.contains(&cpu) {
            return Err(Mistake::new(span, format!("processor {cpu} is listed twice"), "again"));
        }
        cpus.push(cpu);
    }
    cpus.sort_unstable();
    Ok(cpus)
}

fn priority(set: &Spanned<u64>) -> Result<u8, Mistake> {
    let most = Scheduling::PRIORITY_MAX;
    let number = u8::try_from(*set.get_ref()).ok().filter(|&number| number <= most);
    let advice = || format!("expected 1 to {most}, or 0 for the normal class");
    number.ok_or_else(|| Mistake::new(set.span(), "a real-time priority is out of range", advice()))
}

#[cfg(test)]
mod tests {
    use wire::StageId;

    use super::*;
    use crate::pipeline::Pipeline;
    use crate::pipeline_file::SHIPPED;
    use crate::stages::{IN_PROCESS, declared};

    fn parse(text: &str) -> Result<Pipeline, String> {
        Pipeline::parse("p.toml", text, &declared()).map_err(|error| error.report(false, false))
    }

    /// The shipped pipeline with a table of real-time settings and keys of the decoder.
    fn with(realtime: &str, decoder: &str) -> Result<Pipeline, String> {
        let name = "name = \"decoder\"\n";
        parse(&format!("{realtime}\n{}", SHIPPED.replacen(name, &format!("{name}{decoder}\n"), 1)))
    }

    fn scheduling(pipeline: &Pipeline, id: StageId) -> &Scheduling {
        &pipeline.stages.iter().find(|stage| stage.id == id).unwrap().scheduling
    }

    const VEHICLE: &str = "[realtime]\nprofile = \"vehicle\"";
    #[test]
    fn one_word_sets_the_chain_and_leaves_the_recorder() {
        let none = parse(SHIPPED).unwrap();
        assert_eq!(none.realtime, Realtime::default());
        assert!(none.stages.iter().all(|stage| stage.scheduling.is_default()));
        let mut vehicle = with(VEHICLE, "").unwrap();
        let expected = Realtime { awake: true, lock: true, auto_cpu: IN_PROCESS.to_vec() };
        assert_eq!(vehicle.realtime, expected);
        vehicle.choose_cpus(&[2, 3]);
        for (id, priority) in IN_PROCESS.into_iter().zip(30..) {
            let expected = Scheduling { cpus: vec![2, 3], priority: Some(priority), ..Scheduling::default() };
            assert_eq!(*scheduling(&vehicle, id), expected, "{id:?}");
        }
        assert!(scheduling(&vehicle, StageId::Recorder).is_default());
    }

    #[test]
    fn every_setting_of_the_profile_can_be_overridden() {
        let of = |keys: &str, decoder: &str| with(&format!("{VEHICLE}\n{keys}"), decoder).unwrap();
        let priorities = of("priority = 60", "");
        assert_eq!(scheduling(&priorities, StageId::Source).priority, Some(60));
        assert_eq!(scheduling(&priorities, StageId::Sampler).priority, Some(66));
        let normal = of("priority = 0", "");
        assert!(normal.stages.iter().all(|stage| stage.scheduling.priority.is_none()));
        let cpus = of("cpu = [3, 1]", "");
        assert_eq!(scheduling(&cpus, StageId::Tracker).cpus, [1, 3]);
        assert!(cpus.realtime.auto_cpu.is_empty() && of("cpu = \"all\"", "").realtime.auto_cpu.is_empty());
        assert!(!of("awake = false", "").realtime.awake);
        let unlocked = of("lock = false", "");
        assert!(!unlocked.realtime.lock && unlocked.stages.iter().all(|stage| stage.scheduling.unlocked));
        let own = of("", "priority = 0\ncpu = [0]");
        let expected = Scheduling { cpus: vec![0], ..Scheduling::default() };
        assert_eq!(*scheduling(&own, StageId::Decoder), expected);
        assert!(!own.realtime.auto_cpu.contains(&StageId::Decoder));
        assert_eq!(scheduling(&own, StageId::Sampler).priority, Some(36), "the others keep their places");
        let above = parse(&format!("awake = false\n{VEHICLE}\n{SHIPPED}")).unwrap();
        assert!(!above.realtime.awake, "the key above the first table counts, too");
    }

    #[test]
    fn settings_work_without_a_profile() {
        let pipeline = with("[realtime]\npriority = 5\nlock = true", "").unwrap();
        assert_eq!(scheduling(&pipeline, StageId::Tracker).priority, Some(6));
        let expected = Realtime { awake: false, lock: true, auto_cpu: Vec::new() };
        assert_eq!(pipeline.realtime, expected);
    }

    #[test]
    fn an_added_stage_has_a_priority_if_a_tick_passes_it() {
        let topic = "[[topic]]\nname = \"limited\"\ntype_name = \"own.1\"\nelement_bytes = 24\n";
        let stage = |reads: &str, writes: &str| {
            let keys = format!("reads = [\"{reads}\"]\nwrites = [\"{writes}\"]");
            format!(
                "{VEHICLE}\n{SHIPPED}\n{topic}\n[[stage]]\nname = \"limiter\"\ncommand = [\"sh\"]\n{keys}\n"
            )
        };
        let limiter = |pipeline: &Pipeline| pipeline.stages.last().unwrap().scheduling.clone();
        let beside = parse(&stage("forecasts", "limited")).unwrap();
        assert!(limiter(&beside).is_default(), "no forecast waits for it");
        let reads = "name = \"localiser\"";
        let localiser =
            "name = \"localiser\"\ncommand = [\"sh\"]\nreads = [\"limited\"]\nwrites = [\"context\"]";
        let between = stage("tracks", "limited").replacen(reads, localiser, 1);
        let between = parse(&between).unwrap();
        assert_eq!(limiter(&between).priority, Some(32));
        assert_eq!(scheduling(&between, StageId::Tracker).priority, Some(31));
        assert_eq!(scheduling(&between, StageId::Localiser).priority, Some(33));
        assert_eq!(scheduling(&between, StageId::Sampler).priority, Some(37));
    }

    #[test]
    fn errors_show_line_and_value() {
        let refused = |keys: &str| with(&format!("[realtime]\n{keys}"), "").unwrap_err();
        for (keys, expected) in [
            ("profile = \"car\"", &["unknown variant `car`, expected `vehicle`", "p.toml:2:11"][..]),
            ("priority = 100", &["a real-time priority is out of range", "p.toml:2:12", "expected 1 to 99"]),
            ("priority = 94", &["the last stage would have priority 100", "expected 0 to 93"]),
            ("priority = -1", &["p.toml:2:12"]),
            ("cpu = \"some\"", &["`cpu` can't be \"some\"", "expected \"auto\", \"all\" or a list"]),
            ("cpu = [0, 4096]", &["no processor has such a number", "expected 0 to 1023"]),
            ("cpu = [0, \"1\"]", &["no processor has such a number"]),
            ("cpu = [1, 1]", &["processor 1 is listed twice"]),
            ("cpu = []", &["`cpu` is empty"]),
            ("awake = 1", &["p.toml:2:9"]),
            ("prio = 3", &["unknown field `prio`", "p.toml:2:1"]),
        ] {
            let error = refused(keys);
            assert!(expected.iter().all(|part| error.contains(part)), "{keys}: {error}");
        }
        let twice = parse(&format!("awake = true\n[realtime]\nawake = false\n{SHIPPED}")).unwrap_err();
        assert!(twice.contains("`awake` has two values") && twice.contains("p.toml:3:9"), "{twice}");
    }

    #[test]
    fn processors_of_another_machine_are_refused_here() {
        let here = |keys: &str| {
            let text = format!("[realtime]\n{keys}\n{SHIPPED}");
            Pipeline::check_here("p.toml", &text, &|_| Ok(()), &|cpu| cpu < 2)
                .map_err(|error| error.to_string())
        };
        assert_eq!(here("cpu = [0, 1]"), Ok(()));
        assert_eq!(here("cpu = \"auto\""), Ok(()));
        assert_eq!(here("cpu = [0, 7]"), Err("p.toml:2: the stages can't have processor 7".to_owned()));
    }
}
