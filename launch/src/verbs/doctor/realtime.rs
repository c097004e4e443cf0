//! `stgdat doctor --realtime`: what the kernel does to the time of a tick, and the command of each change.
//!
//! Each check is a function of the contents of files. A file that can't be read is never good.

use std::io::Error;

use console::failure::Failure;
use console::say;
use run::Exit;
use supervisor::scheduling::cpu_list;

use super::files::{Files, Unread, cpu_group};
use crate::awake;

/// The highest priority of `profile = "vehicle"`.
const PRIORITY: u64 = 36;
/// Number of processors from which on some should be isolated.
const ISOLATE_MIN: usize = 4;
/// Wake-up latency of an idle state from which on it delays a tick, µs.
const LATENCY_MAX_US: u64 = 10;
/// Share of the time that programs wait for a resource, from which on the machine is too busy, %.
const PRESSURE_MAX: f64 = 10.0;
/// Numbers of the capabilities in /proc/self/status.
const IPC_LOCK: u32 = 14;
const SYS_NICE: u32 = 23;

const CPU: &str = "/sys/devices/system/cpu";
const CLOCK: &str = "/sys/devices/system/clocksource/clocksource0";

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
enum State {
    Good,
    /// The command that makes the change.
    Change(String),
    Unread,
}

/// One check.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Check {
    what: &'static str,
    found: String,
    state: State,
}

type Found = (String, State);

/// Checks this machine and prints one line for each check.
pub fn execute() -> Result<Exit, Failure> {
    let may_hold = rustix::fs::access(awake::LATENCY, rustix::fs::Access::WRITE_OK).is_ok();
    let checks = checks(&Files("/".into()), may_hold);
    checks.iter().for_each(|check| say!("{}", line(check)));
    let count = |is_it: fn(&State) -> bool| checks.iter().filter(|check| is_it(&check.state)).count();
    let changes = count(|state| matches!(state, State::Change(_)));
    let unread = count(|state| *state == State::Unread);
    say!("{changes} changes needed, {unread} not readable");
    if changes == 0 {
        return Ok(Exit::Done);
    }
    Err(Failure::unavailable("this machine delays ticks, see above"))
}

fn line(Check { what, found, state }: &Check) -> String {
    match state {
        State::Good => format!("ok   {what:<16} {found}"),
        State::Change(command) => format!("fix  {what:<16} {found}: {command}"),
        State::Unread => format!("?    {what:<16} {found}"),
    }
}

/// All checks. `may_hold` is whether `awake` can keep the processors awake.
fn checks(files: &Files, may_hold: bool) -> Vec<Check> {
    let check = |what, found: Result<Found, Unread>| match found {
        Ok((found, state)) => Check { what, found, state },
        Err(unread) => {
            let why = if unread.is_missing() { "there is no such file".into() } else { unread.1.to_string() };
            let found = format!("{} is not readable: {why}", unread.0);
            Check { what, found, state: State::Unread }
        }
    };
    vec![
        check("kernel", kernel(files)),
        check("clock source", clock_source(files)),
        check("governor", governor(files)),
        check("idle states", idle_states(files, may_hold)),
        check("isolated", isolated(files)),
        check("tick of isolated", nohz_full(files)),
        check("RCU of isolated", rcu(files)),
        check("interrupts", interrupts(files)),
        check("SMT", smt(files)),
        check("real-time share", throttling(files)),
        check("group's share", group(files)),
        check("huge pages", huge_pages(files)),
        check("swap", swap(files)),
        check("pressure, cpu", pressure(files, "/proc/pressure/cpu")),
        check("pressure, memory", pressure(files, "/proc/pressure/memory")),
        check("pressure, io", pressure(files, "/proc/pressure/io")),
        check("priority", priority(files)),
        check("locked memory", locked_memory(files)),
    ]
}

fn good(found: impl Into<String>) -> Found {
    (found.into(), State::Good)
}

fn change(found: impl Into<String>, command: impl Into<String>) -> Found {
    (found.into(), State::Change(command.into()))
}

fn is_one(files: &Files, path: &str) -> bool {
    files.get(path).is_ok_and(|text| text == "1")
}

fn kernel(files: &Files) -> Result<Found, Unread> {
    let version = files.get("/proc/version");
    if is_one(files, "/sys/kernel/realtime") || version.as_ref().is_ok_and(|v| v.contains("PREEMPT_RT")) {
        return Ok(good("PREEMPT_RT"));
    }
    let found = if version?.contains("PREEMPT") { "PREEMPT, not PREEMPT_RT" } else { "no preemption" };
    let machine = if cfg!(target_arch = "aarch64") { "arm64" } else { "amd64" };
    Ok(change(found, format!("apt install linux-image-rt-{machine}")))
}

fn clock_source(files: &Files) -> Result<Found, Unread> {
    const FAST: [&str; 4] = ["tsc", "arch_sys_counter", "kvm-clock", "hyperv_clocksource_tsc_page"];
    let current = files.get("/sys/devices/system/clocksource/clocksource0/current_clocksource")?;
    if FAST.contains(&current.as_str()) {
        return Ok(good(current));
    }
    let available = files.get("/sys/devices/system/clocksource/clocksource0/available_clocksource")?;
    match available.split_whitespace().find(|name| FAST.contains(name)) {
        Some(name) => Ok(change(current, format!("echo {name} > {CLOCK}/current_clocksource"))),
        None => Ok(change(current, boot("tsc=reliable"))),
    }
}

/// The command that adds parameters to the kernel's command line.
fn boot(parameters: &str) -> String {
    format!("add {parameters} to GRUB_CMDLINE_LINUX in /etc/default/grub, update-grub, reboot")
}

fn governor(files: &Files) -> Result<Found, Unread> {
    let cpus = files.matching("/sys/devices/system/cpu/cpu*/cpufreq/scaling_governor");
    let mut others: Vec<String> = Vec::new();
    for path in &cpus {
        let governor = files.get(path)?;
        if governor != "performance" && !others.contains(&governor) {
            others.push(governor);
        }
    }
    match others[..] {
        _ if cpus.is_empty() => Err(Unread::missing(&format!("{CPU}/cpu0/cpufreq/scaling_governor"))),
        [] => Ok(good("performance")),
        _ => {
            let command = format!("echo performance | tee {CPU}/cpu*/cpufreq/scaling_governor");
            Ok(change(others.join(", "), command))
        }
    }
}

fn idle_states(files: &Files, may_hold: bool) -> Result<Found, Unread> {
    let driver = files.get("/sys/devices/system/cpu/cpuidle/current_driver")?;
    let mut latency_us = 0;
    for path in files.matching("/sys/devices/system/cpu/cpu0/cpuidle/state*/latency") {
        let text = files.get(&path)?;
        let is_disabled = is_one(files, &path.replace("/latency", "/disable"));
        let state_us = if is_disabled { 0 } else { text.parse().unwrap_or(u64::MAX) };
        latency_us = latency_us.max(state_us);
    }
    let found = format!("{driver}, up to {latency_us} \u{b5}s to wake up");
    Ok(match latency_us <= LATENCY_MAX_US {
        true => good(found),
        false if may_hold => good(format!("{found}; `awake` prevents them during a run")),
        false => change(found, format!("chown $USER {}, and `awake` in pipeline.toml", awake::LATENCY)),
    })
}

/// The isolated processors.
fn isolated_cpus(files: &Files) -> Result<Vec<u32>, Unread> {
    Ok(cpu_list(&files.get("/sys/devices/system/cpu/isolated")?))
}

fn isolated(files: &Files) -> Result<Found, Unread> {
    let online = cpu_list(&files.get("/sys/devices/system/cpu/online")?);
    let isolated = isolated_cpus(files)?;
    Ok(match isolated.len() {
        0 if online.len() < ISOLATE_MIN => good(format!("none; {} processors are too few", online.len())),
        0 => {
            let set = format!("1-{}", online.last().copied().unwrap_or(0));
            let parameters = format!("isolcpus=managed_irq,domain,{set} nohz_full={set} irqaffinity=0");
            change(format!("none of {}", online.len()), boot(&parameters))
        }
        count => good(format!("{count} of {}", online.len())),
    })
}

/// Texts of processors as the kernel prints them.
fn text(cpus: &[u32]) -> String {
    cpus.iter().map(u32::to_string).collect::<Vec<_>>().join(",")
}

fn nohz_full(files: &Files) -> Result<Found, Unread> {
    let isolated = isolated_cpus(files)?;
    if isolated.is_empty() {
        return Ok(good("none are isolated"));
    }
    let without = cpu_list(&files.get("/sys/devices/system/cpu/nohz_full")?);
    let ticking: Vec<u32> = isolated.iter().copied().filter(|cpu| !without.contains(cpu)).collect();
    Ok(match ticking[..] {
        [] => good("off"),
        _ => change(
            format!("on processors {}", text(&ticking)),
            boot(&format!("nohz_full={}", text(&isolated))),
        ),
    })
}

fn rcu(files: &Files) -> Result<Found, Unread> {
    let isolated = isolated_cpus(files)?;
    if isolated.is_empty() {
        return Ok(good("none are isolated"));
    }
    let line = files.get("/proc/cmdline")?;
    let value = |key: &str| line.split_whitespace().filter_map(|word| word.strip_prefix(key)).next_back();
    // nohz_full moves the callbacks of its processors, too.
    let moved: Vec<u32> =
        ["rcu_nocbs=", "nohz_full="].iter().filter_map(|key| value(key)).flat_map(cpu_list).collect();
    let is_all = value("rcu_nocbs=") == Some("all");
    let own: Vec<u32> = isolated.iter().copied().filter(|cpu| !is_all && !moved.contains(cpu)).collect();
    Ok(match own[..] {
        [] => good("its callbacks run elsewhere"),
        _ => {
            let found = format!("callbacks run on processors {}", text(&own));
            change(found, boot(&format!("rcu_nocbs={}", text(&isolated))))
        }
    })
}

fn interrupts(files: &Files) -> Result<Found, Unread> {
    let isolated = isolated_cpus(files)?;
    if isolated.is_empty() {
        return Ok(good("no processors are isolated"));
    }
    let irqs = files.matching("/proc/irq/*/smp_affinity");
    let (count, mut there) = (irqs.len(), Vec::new());
    for path in &irqs {
        if mask_cpus(&files.get(path)?).iter().any(|cpu| isolated.contains(cpu)) {
            there.push(path.trim_start_matches("/proc/irq/").trim_end_matches("/smp_affinity"));
        }
    }
    let online = cpu_list(&files.get("/sys/devices/system/cpu/online")?);
    let others: Vec<u32> = online.into_iter().filter(|cpu| !isolated.contains(cpu)).collect();
    Ok(match there[..] {
        _ if count == 0 => return Err(Unread::missing("/proc/irq/*/smp_affinity")),
        [] => good(format!("none of {count} on isolated processors")),
        _ => {
            let irqs = there.join(" ");
            let found = format!("{} of {count} may run on isolated processors", there.len());
            let others = text(&others);
            change(found, format!("for i in {irqs}; do echo {others} > /proc/irq/$i/smp_affinity_list; done"))
        }
    })
}

/// The processors of a mask in hexadecimal digits, with a comma after each group of eight.
fn mask_cpus(mask: &str) -> Vec<u32> {
    let digits = mask.chars().filter(|&digit| digit != ',').rev();
    let digits = (0..).zip(digits.filter_map(|digit| digit.to_digit(16)));
    digits
        .flat_map(|(place, bits)| {
            (0..4).filter(move |bit| bits >> bit & 1 == 1).map(move |bit| 4 * place + bit)
        })
        .collect()
}

fn smt(files: &Files) -> Result<Found, Unread> {
    Ok(match files.get("/sys/devices/system/cpu/smt/active")?.as_str() {
        "0" => good("off"),
        _ => change("two processors share a core", format!("echo off > {CPU}/smt/control")),
    })
}

fn throttling(files: &Files) -> Result<Found, Unread> {
    let period: i64 = files.get("/proc/sys/kernel/sched_rt_period_us")?.parse().unwrap_or(1_000_000);
    let runtime: i64 = files.get("/proc/sys/kernel/sched_rt_runtime_us")?.parse().unwrap_or(0);
    let command = format!("sysctl -w kernel.sched_rt_runtime_us={}", period / 100 * 95);
    let percent = runtime * 100 / period.max(1);
    Ok(match percent {
        _ if runtime < 0 => change("no limit: a stage that hangs could stop its supervisor", command),
        0..90 => change(format!("{percent} %"), command),
        _ => good(format!("{percent} %")),
    })
}

fn group(files: &Files) -> Result<Found, Unread> {
    let Some(path) = cpu_group(&files.get("/proc/self/cgroup")?) else {
        return Ok(good("cgroup v2 has no limit"));
    };
    match files.get(&path) {
        Ok(text) if text == "0" => {
            Ok(change("SCHED_FIFO is refused in this group", format!("echo 950000 > {path}")))
        }
        Ok(text) => Ok(good(format!("{text} \u{b5}s"))),
        Err(unread) if unread.is_missing() => Ok(good("this kernel has no limit")),
        Err(Unread(_, why)) => Err(Unread("cpu.rt_runtime_us".to_owned(), why)),
    }
}

fn huge_pages(files: &Files) -> Result<Found, Unread> {
    let path = "/sys/kernel/mm/transparent_hugepage/enabled";
    let setting = files.get(path)?;
    let active = setting.split_once('[').and_then(|(_, rest)| rest.split_once(']'));
    let active = active.map_or(setting.as_str(), |(active, _)| active);
    Ok(match active {
        "always" => {
            change("always, the kernel may stop a stage to make them", format!("echo madvise > {path}"))
        }
        other => good(other),
    })
}

fn swap(files: &Files) -> Result<Found, Unread> {
    let has_swap = files.get("/proc/swaps")?.lines().count() > 1;
    let swappiness: u64 = files.get("/proc/sys/vm/swappiness")?.parse().unwrap_or(u64::MAX);
    Ok(match has_swap {
        false => good("none"),
        true if swappiness <= 10 => good(format!("swappiness {swappiness}")),
        true => change(format!("swappiness {swappiness}"), "sysctl -w vm.swappiness=1"),
    })
}

/// The share of the last minute in which a program waited for a resource.
fn pressure(files: &Files, path: &str) -> Result<Found, Unread> {
    let text = files.get(path)?;
    let some = text.lines().find(|line| line.starts_with("some "));
    let average = some.and_then(|line| line.split_whitespace().find_map(|word| word.strip_prefix("avg60=")));
    let Some(percent) = average.and_then(|number| number.parse::<f64>().ok()) else {
        return Err(Unread(path.to_owned(), Error::other("it has no avg60")));
    };
    let found = format!("programs waited {percent:.0} % of the last minute");
    let order = path.trim_start_matches("/proc/pressure/");
    Ok(if percent > PRESSURE_MAX {
        change(found, format!("systemd-cgtop --order={order}"))
    } else {
        good(found)
    })
}

/// The soft limit of a resource in /proc/self/limits; without a limit the largest number.
fn soft_limit(files: &Files, name: &str) -> Result<u64, Unread> {
    let path = "/proc/self/limits";
    let text = files.get(path)?;
    let line = text.lines().find_map(|line| line.strip_prefix(name));
    match line.and_then(|line| line.split_whitespace().next()) {
        Some("unlimited") => Ok(u64::MAX),
        limit => limit
            .and_then(|limit| limit.parse().ok())
            .ok_or_else(|| Unread(path.to_owned(), Error::other(format!("it has no {name}")))),
    }
}

/// Whether the process has a capability, by /proc/self/status.
fn has_capability(status: &str, number: u32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask >> number & 1 == 1)
}

fn priority(files: &Files) -> Result<Found, Unread> {
    if has_capability(&files.get("/proc/self/status")?, SYS_NICE) {
        return Ok(good("any"));
    }
    Ok(match soft_limit(files, "Max realtime priority")? {
        most if most < PRIORITY => {
            change(format!("at most {most}"), format!("sudo prlimit --pid $$ --rtprio={PRIORITY}"))
        }
        most => good(format!("at most {}", most.min(99))),
    })
}

fn locked_memory(files: &Files) -> Result<Found, Unread> {
    if has_capability(&files.get("/proc/self/status")?, IPC_LOCK) {
        return Ok(good("no limit"));
    }
    Ok(match soft_limit(files, "Max locked memory")? {
        u64::MAX => good("no limit"),
        bytes => change(format!("{} KiB", bytes >> 10), "sudo prlimit --pid $$ --memlock=unlimited"),
    })
}

#[cfg(test)]
mod tests;
