//! Is the machine ready? Processor, disk, clock, priority, permissions, Python.

use std::path::Path;
use std::time::Instant;

use super::finding::Finding;

/// Disk space for a game's log, MB: two halves of 15 minutes at 4 MB/s.
const LOG_SPACE_MB: u64 = 7_200;
/// Disk space for its first minute, MB.
const LOG_SPACE_MIN_MB: u64 = 240;
/// Write rate of a log of JPEG images at 60 Hz, MB/s.
const WRITE_RATE_MIN_MB_S: f64 = 10.0;
/// Bytes written to measure the disk.
const PROBE_BYTES: usize = 32 << 20;
/// Start of 2025: earlier dates come from a clock without a battery.
const PLAUSIBLE_TIME_MIN_S: u64 = 1_735_689_600;

/// Checks the machine; `logs`: folder of the logs.
pub(super) fn check_machine(logs: &Path) -> Vec<Finding> {
    let mut findings = vec![check_processor(), check_python()];
    findings.extend(check_disk(logs));
    findings.push(check_clock());
    findings.push(check_governor());
    findings.push(check_realtime_priority());
    findings
}

fn check_processor() -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    match cores {
        0 | 1 => Finding::note(
            "processor",
            "one core",
            "log and vision share it: record without images (--images none)",
        ),
        cores => Finding::fine("processor", format!("{cores} cores")),
    }
}

#[cfg(feature = "python")]
fn check_python() -> Finding {
    match crate::python::check() {
        Ok(version) => Finding::fine("Python", version),
        Err(error) => Finding::note(
            "Python",
            format!("{error:#}"),
            "`run` works without it; `script` and `mirror` need the Python that mirrorball was built with",
        ),
    }
}

#[cfg(not(feature = "python"))]
fn check_python() -> Finding {
    Finding::fine("Python", "not in this build (`run` does not need it)")
}

fn check_disk(logs: &Path) -> Vec<Finding> {
    let subject = format!("disk at {}", logs.display());
    let space = match rustix::fs::statvfs(logs) {
        Ok(space) => space,
        Err(error) => {
            let remedy = "make the folder, or choose another with --logs";
            return vec![Finding::bad(&subject, error.to_string(), remedy)];
        }
    };
    let free_mb = space.f_bavail * space.f_frsize / 1_000_000;
    let found = format!("{free_mb} MB free");
    let remedy = format!("delete old logs: a game with images takes {LOG_SPACE_MB} MB");
    let space = if free_mb < LOG_SPACE_MIN_MB {
        Finding::bad(&subject, found, remedy)
    } else if free_mb < LOG_SPACE_MB {
        Finding::note(&subject, found, remedy)
    } else {
        Finding::fine(&subject, found)
    };
    let mut findings = vec![space];
    if free_mb >= LOG_SPACE_MIN_MB {
        findings.push(match write_rate_mb(logs) {
            Ok(rate) if rate < WRITE_RATE_MIN_MB_S => Finding::note(
                &subject,
                format!("writes {rate:.0} MB/s"),
                "images will be dropped from logs: use a faster disk, or --images none",
            ),
            Ok(rate) => Finding::fine(&subject, format!("writes {rate:.0} MB/s")),
            Err(error) => Finding::bad(
                &subject,
                format!("cannot write: {error}"),
                "give this user write permission, or choose another folder with --logs",
            ),
        });
    }
    findings
}

/// Write rate of the disk, measured with a temporary file.
fn write_rate_mb(folder: &Path) -> std::io::Result<f64> {
    let mut file = tempfile::tempfile_in(folder)?;
    let bytes = vec![0x5A; PROBE_BYTES];
    let began = Instant::now();
    std::io::Write::write_all(&mut file, &bytes)?;
    file.sync_data()?;
    Ok(PROBE_BYTES as f64 * 1e-6 / began.elapsed().as_secs_f64())
}

fn check_clock() -> Finding {
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |time| time.as_secs());
    if now < PLAUSIBLE_TIME_MIN_S {
        return Finding::note(
            "clock",
            "the date is before 2025",
            "set it (timedatectl set-ntp true): names and dates of logs are wrong; localization is not affected",
        );
    }
    Finding::fine("clock", "the date is plausible; `run` uses CLOCK_MONOTONIC")
}

fn check_governor() -> Finding {
    let path = "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor";
    match std::fs::read_to_string(path) {
        Ok(governor) if governor.trim() == "powersave" => Finding::note(
            "CPU frequency governor",
            "powersave",
            "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
        ),
        Ok(governor) => Finding::fine("CPU frequency governor", governor.trim().to_owned()),
        Err(_) => Finding::fine("CPU frequency governor", "cannot be set here"),
    }
}

fn check_realtime_priority() -> Finding {
    match hw::realtime::is_realtime_permitted(1) {
        true => Finding::fine("real-time priority", "permitted (run --realtime)"),
        false => Finding::note(
            "real-time priority",
            "not permitted for this user",
            "install the systemd unit (its LimitRTPRIO), or: sudo setcap cap_sys_nice,cap_ipc_lock+ep mirrorball",
        ),
    }
}
