use super::*;

/// Files of a machine that is set up for real time: PREEMPT_RT, eight processors, six of them isolated.
const GOOD: [(&str, &str); 29] = [
    ("/proc/version", "Linux version 6.12.9-rt (gcc) #1 SMP PREEMPT_RT Debian\n"),
    ("/proc/cmdline", "BOOT_IMAGE=/vmlinuz isolcpus=2-7 nohz_full=2-7 rcu_nocbs=2-7\n"),
    ("/proc/swaps", "Filename\tType\tSize\tUsed\tPriority\n"),
    ("/proc/self/cgroup", "0::/system.slice/stgdat.service\n"),
    (
        "/proc/self/limits",
        "Limit Soft Hard Units\nMax locked memory         unlimited            unlimited            bytes\nMax realtime \
         priority     50                   50\n",
    ),
    ("/proc/self/status", "Name:\tstgdat\nCapEff:\t0000000000000000\n"),
    ("/proc/irq/1/smp_affinity", "00000003\n"),
    ("/proc/irq/24/smp_affinity", "1\n"),
    ("/proc/pressure/cpu", "some avg10=0.00 avg60=1.20 avg300=0.00 total=9\nfull avg10=0.00 avg60=90.00\n"),
    ("/proc/pressure/io", "some avg10=0.00 avg60=0.00 avg300=0.00 total=0\n"),
    ("/proc/pressure/memory", "some avg10=0.00 avg60=0.00 avg300=0.00 total=0\n"),
    ("/proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
    ("/proc/sys/kernel/sched_rt_period_us", "1000000\n"),
    ("/proc/sys/vm/swappiness", "60\n"),
    ("/sys/devices/system/clocksource/clocksource0/available_clocksource", "tsc hpet acpi_pm\n"),
    ("/sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc\n"),
    ("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance\n"),
    ("/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "performance\n"),
    ("/sys/devices/system/cpu/cpu0/cpuidle/state0/latency", "0\n"),
    ("/sys/devices/system/cpu/cpu0/cpuidle/state0/disable", "0\n"),
    ("/sys/devices/system/cpu/cpu0/cpuidle/state1/latency", "133\n"),
    ("/sys/devices/system/cpu/cpu0/cpuidle/state1/disable", "1\n"),
    ("/sys/devices/system/cpu/cpuidle/current_driver", "intel_idle\n"),
    ("/sys/devices/system/cpu/isolated", "2-7\n"),
    ("/sys/devices/system/cpu/nohz_full", "2-7\n"),
    ("/sys/devices/system/cpu/online", "0-7\n"),
    ("/sys/devices/system/cpu/smt/active", "0\n"),
    ("/sys/kernel/mm/transparent_hugepage/enabled", "always [madvise] never\n"),
    ("/sys/kernel/realtime", "1\n"),
];

/// A folder with the files of a machine.
struct Machine(tempfile::TempDir, Files);

impl Machine {
    fn new(files: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().to_owned();
        let machine = Self(folder, Files(root));
        files.iter().for_each(|(path, text)| machine.write(path, text));
        machine
    }

    fn path(&self, path: &str) -> std::path::PathBuf {
        self.0.path().join(path.trim_start_matches('/'))
    }

    fn write(&self, path: &str, text: &str) {
        let path = self.path(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
}

fn good_machine() -> Machine {
    Machine::new(&GOOD)
}

/// The good machine with other files.
fn machine(changed: &[(&str, &str)]) -> Machine {
    let machine = good_machine();
    changed.iter().for_each(|(path, text)| machine.write(path, text));
    machine
}

/// The lines of all checks that are not good.
fn bad(Machine(_, files): &Machine) -> Vec<String> {
    checks(files, false).iter().filter(|check| check.state != State::Good).map(line).collect()
}

#[test]
fn a_machine_for_real_time_needs_no_change() {
    assert_eq!(bad(&good_machine()), Vec::<String>::new());
}

#[test]
fn each_bad_setting_has_one_line_with_its_command() {
    let limits = "Max locked memory 8388608 8388608 bytes\nMax realtime priority 0 0\n";
    let some = "some avg10=0.00 avg60=41.50 avg300=0.00 total=0\n";
    for (path, text, expected) in [
        (
            "/sys/devices/system/clocksource/clocksource0/current_clocksource",
            "hpet\n",
            &[
                "fix  clock source     hpet: echo tsc > /sys/devices/system/clocksource/clocksource0/current_clocksource",
            ][..],
        ),
        (
            "/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor",
            "powersave\n",
            &["fix  governor         powersave: echo performance | tee \
               /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"],
        ),
        (
            "/sys/devices/system/cpu/cpu0/cpuidle/state1/disable",
            "0\n",
            &[
                "fix  idle states      intel_idle, up to 133 \u{b5}s to wake up: chown $USER /dev/cpu_dma_latency, and \
               `awake` in pipeline.toml",
            ],
        ),
        (
            "/sys/devices/system/cpu/isolated",
            "\n",
            &[
                "fix  isolated         none of 8: add isolcpus=managed_irq,domain,1-7 nohz_full=1-7 irqaffinity=0 to \
               GRUB_CMDLINE_LINUX in /etc/default/grub, update-grub, reboot",
            ],
        ),
        (
            "/sys/devices/system/cpu/nohz_full",
            "  (null)\n",
            &[
                "fix  tick of isolated on processors 2,3,4,5,6,7: add nohz_full=2,3,4,5,6,7 to GRUB_CMDLINE_LINUX in \
               /etc/default/grub, update-grub, reboot",
            ],
        ),
        (
            "/proc/cmdline",
            "isolcpus=2-7 rcu_nocbs=2-6\n",
            &[
                "fix  RCU of isolated  callbacks run on processors 7: add rcu_nocbs=2,3,4,5,6,7 to GRUB_CMDLINE_LINUX \
               in /etc/default/grub, update-grub, reboot",
            ],
        ),
        (
            "/proc/irq/24/smp_affinity",
            "00000000,00000084\n",
            &["fix  interrupts       1 of 2 may run on isolated processors: for i in 24; do echo 0,1 > \
               /proc/irq/$i/smp_affinity_list; done"],
        ),
        (
            "/sys/devices/system/cpu/smt/active",
            "1\n",
            &[
                "fix  SMT              two processors share a core: echo off > /sys/devices/system/cpu/smt/control",
            ],
        ),
        (
            "/proc/sys/kernel/sched_rt_runtime_us",
            "-1\n",
            &["fix  real-time share  no limit: a stage that hangs could stop its supervisor: sysctl -w \
               kernel.sched_rt_runtime_us=950000"],
        ),
        (
            "/proc/sys/kernel/sched_rt_runtime_us",
            "400000\n",
            &["fix  real-time share  40 %: sysctl -w kernel.sched_rt_runtime_us=950000"],
        ),
        (
            "/sys/kernel/mm/transparent_hugepage/enabled",
            "[always] madvise never\n",
            &["fix  huge pages       always, the kernel may stop a stage to make them: echo madvise > \
               /sys/kernel/mm/transparent_hugepage/enabled"],
        ),
        (
            "/proc/swaps",
            "Filename\n/dev/sda2 partition 1 0 -2\n",
            &["fix  swap             swappiness 60: sysctl -w vm.swappiness=1"],
        ),
        (
            "/proc/pressure/cpu",
            some,
            &["fix  pressure, cpu    programs waited 42 % of the last minute: systemd-cgtop --order=cpu"],
        ),
        (
            "/proc/pressure/memory",
            some,
            &["fix  pressure, memory programs waited 42 % of the last minute: systemd-cgtop --order=memory"],
        ),
        (
            "/proc/self/limits",
            limits,
            &[
                "fix  priority         at most 0: sudo prlimit --pid $$ --rtprio=36",
                "fix  locked memory    8192 KiB: sudo prlimit --pid $$ --memlock=unlimited",
            ],
        ),
    ] {
        assert_eq!(bad(&machine(&[(path, text)])), expected, "{path}");
    }
    let kernel =
        machine(&[("/sys/kernel/realtime", "0\n"), ("/proc/version", "Linux #1 SMP PREEMPT_DYNAMIC\n")]);
    assert!(
        bad(&kernel)[0]
            .starts_with("fix  kernel           PREEMPT, not PREEMPT_RT: apt install linux-image-rt-")
    );
}

#[test]
fn a_capability_replaces_a_limit() {
    let limits = "Max locked memory 8388608 8388608 bytes\nMax realtime priority 0 0\n";
    let status = "CapEff:\t0000000000804000\n";
    let files = machine(&[("/proc/self/limits", limits), ("/proc/self/status", status)]);
    assert_eq!(bad(&files), Vec::<String>::new());
}

#[test]
fn a_group_of_cgroup_v1_may_refuse_real_time() {
    let path = "/sys/fs/cgroup/cpu,cpuacct/a/cpu.rt_runtime_us";
    let group = ("/proc/self/cgroup", "3:cpu,cpuacct:/a\n");
    let expected = format!("fix  group's share    SCHED_FIFO is refused in this group: echo 950000 > {path}");
    assert_eq!(bad(&machine(&[group, (path, "0\n")])), [expected]);
    assert_eq!(bad(&machine(&[group, (path, "950000\n")])), Vec::<String>::new());
    assert_eq!(bad(&machine(&[group])), Vec::<String>::new(), "a kernel without such limits");
}

#[test]
fn few_processors_are_not_isolated() {
    let files = machine(&[
        ("/sys/devices/system/cpu/isolated", "\n"),
        ("/sys/devices/system/cpu/online", "0-1\n"),
        ("/sys/devices/system/cpu/nohz_full", "\n"),
        ("/proc/cmdline", "quiet\n"),
    ]);
    assert_eq!(bad(&files), Vec::<String>::new());
}

/// A missing or unreadable file is never good, whichever one it is.
#[test]
fn a_file_that_cannot_be_read_is_not_good() {
    // The kernel is known from its version, and `disable` may be missing in old kernels.
    let spare = ["/sys/kernel/realtime", "/disable"];
    for (path, _) in GOOD.iter().filter(|(path, _)| !spare.iter().any(|name| path.ends_with(name))) {
        for is_folder in [false, true] {
            let machine = good_machine();
            std::fs::remove_file(machine.path(path)).unwrap();
            if is_folder {
                std::fs::create_dir(machine.path(path)).unwrap();
            }
            let (before, lines) = (bad(&good_machine()), bad(&machine));
            let is_needed = !matches!(
                *path,
                "/proc/version" | "/sys/devices/system/clocksource/clocksource0/available_clocksource"
            );
            assert!(before.is_empty());
            assert_eq!(!lines.is_empty(), is_needed, "{path}: {lines:?}");
            for line in lines {
                assert!(line.starts_with("?    ") && line.contains(" is not readable: "), "{line}");
            }
        }
    }
    let nothing = checks(&Machine::new(&[]).1, true);
    assert!(nothing.iter().all(|check| check.state == State::Unread), "{nothing:?}");
}

#[test]
fn masks_of_interrupts_have_groups_of_digits() {
    assert_eq!(mask_cpus("3"), [0, 1]);
    assert_eq!(mask_cpus("00000001,00000000"), [32]);
    assert_eq!(mask_cpus("80000000"), [31]);
    assert_eq!(mask_cpus("0"), Vec::<u32>::new());
}
