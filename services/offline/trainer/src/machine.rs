//! The machine and the memory use of a training, for the model card.

use std::fs;

/// The largest resident memory of this process since [`forget_peak`], MiB; `None` if the system does not
/// report it.
pub(crate) fn peak_rss_mib() -> Option<u64> {
    peak_of(&fs::read_to_string("/proc/self/status").ok()?)
}

/// Resets the peak that [`peak_rss_mib`] reports, if the system allows it.
pub(crate) fn forget_peak() {
    const PEAK: &str = "5";
    // If the reset fails, the peak covers the whole process and is an upper bound.
    let _ = fs::write("/proc/self/clear_refs", PEAK);
}

/// The system's name of the CPU model, or the architecture if there is none.
pub(crate) fn cpu() -> String {
    let cpuinfo = fs::read_to_string("/proc/cpuinfo").ok();
    cpuinfo.and_then(|text| model_of(&text)).unwrap_or_else(|| std::env::consts::ARCH.to_owned())
}

fn peak_of(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
    Some(kib.div_ceil(1024))
}

fn model_of(cpuinfo: &str) -> Option<String> {
    let lines = cpuinfo.lines().filter_map(|line| line.split_once(':'));
    let name = lines.filter(|(key, _)| key.trim() == "model name").map(|(_, value)| value.trim());
    name.map(str::to_owned).find(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn proc_files_are_parsed() {
        let status = "Name:\tstgdat\nVmPeak:\t  900000 kB\nVmHWM:\t  167957 kB\nVmRSS:\t     100 kB\n";
        assert_eq!(peak_of(status), Some(165));
        assert_eq!(peak_of("Name:\tstgdat\n"), None);
        assert_eq!(peak_of("VmHWM:\tmuch kB\n"), None);
        let cpuinfo = "processor\t: 0\nmodel\t\t: 207\nmodel name\t: Some CPU @ 2 GHz\nmodel name\t: Other\n";
        assert_eq!(model_of(cpuinfo).as_deref(), Some("Some CPU @ 2 GHz"));
        assert_eq!(model_of("processor\t: 0\n"), None);
    }

    #[test]
    fn the_peak_includes_freed_memory() {
        let Some(before) = peak_rss_mib() else { return };
        let filled = vec![1_u8; (before as usize + 64) << 20];
        assert!(filled.iter().all(|&byte| byte == 1));
        let peak = peak_rss_mib().unwrap();
        assert!(peak >= before + 64, "{peak} MiB, {before} before");
        drop(filled);
        forget_peak();
        assert!(peak_rss_mib().is_some_and(|after| after < peak), "{peak} MiB are remembered");
    }
}
