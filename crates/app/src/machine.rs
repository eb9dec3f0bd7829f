//! Which machine is this? Its name in the results of `bench` and `eval`.

/// Processor, number of cores and operating system, as the system names them.
pub(crate) fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!(
        "{}, {cores} cores, {}",
        name.map_or("unknown processor", |(_, name)| name.trim()),
        std::env::consts::OS
    )
}
