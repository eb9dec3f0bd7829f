//! Is the machine fit? Processor, disk, clock, priority, permissions, Python.

use std::path::Path;
use std::time::Instant;

use super::Finding;

/// Room for a game's log, MB: two halves of 15 minutes at 4 MB/s.
const LOG_SPACE_MB: u64 = 7_200;
/// Room for its first minute, MB.
const LOG_SPACE_MIN_MB: u64 = 240;
/// What a log of JPEG images needs at 60 Hz, MB/s.
const WRITE_RATE_MIN_MB_S: f64 = 10.0;
/// Bytes written to measure the disk.
const PROBE_BYTES: usize = 32 << 20;
/// 2025: an earlier date is that of a clock without a battery.
const PLAUSIBLE_TIME_MIN_S: u64 = 1_735_689_600;

/// What was found of the machine; `logs` is where logs are written.
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
            "log and eyes share it: record without images (--images none)",
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
            "`run` plays without it; `script` and `mirror` need the Python it was built with",
        ),
    }
}

#[cfg(not(feature = "python"))]
fn python() -> Finding {
    Finding::fine("Python", "none in this build, and none is needed to play")
}

fn check_disk(logs: &Path) -> Vec<Finding> {
    let what = format!("disk at {}", logs.display());
    let space = match rustix::fs::statvfs(logs) {
        Ok(space) => space,
        Err(error) => {
            let remedy = "make the folder, or name another with --logs";
            return vec![Finding::bad(&what, error.to_string(), remedy)];
        }
    };
    let free_mb = space.f_bavail * space.f_frsize / 1_000_000;
    let found = format!("{free_mb} MB free");
    let remedy = format!("delete old logs: a game with images takes {LOG_SPACE_MB} MB");
    let room = if free_mb < LOG_SPACE_MIN_MB {
        Finding::bad(&what, found, remedy)
    } else if free_mb < LOG_SPACE_MB {
        Finding::note(&what, found, remedy)
    } else {
        Finding::fine(&what, found)
    };
    let mut findings = vec![room];
    if free_mb >= LOG_SPACE_MIN_MB {
        findings.push(match write_rate_mb(logs) {
            Ok(rate) if rate < WRITE_RATE_MIN_MB_S => Finding::note(
                &what,
                format!("writes {rate:.0} MB/s"),
                "images will be dropped from logs: use a faster disk, or --images none",
            ),
            Ok(rate) => Finding::fine(&what, format!("writes {rate:.0} MB/s")),
            Err(error) => Finding::bad(
                &what,
                format!("cannot be written: {error}"),
                "give this user the right to write there, or name another folder with --logs",
            ),
        });
    }
    findings
}

/// Writes and syncs a file that is gone again afterwards.
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
            "the date is years behind",
            "set it (timedatectl set-ntp true): names and dates of logs are wrong, playing is not",
        );
    }
    Finding::fine(
        "clock",
        "the date may be right; playing goes by CLOCK_MONOTONIC",
    )
}

fn check_governor() -> Finding {
    let path = "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor";
    match std::fs::read_to_string(path) {
        Ok(governor) if governor.trim() == "powersave" => Finding::note(
            "processor's clock",
            "is saved power on",
            "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
        ),
        Ok(governor) => Finding::fine("processor's clock", governor.trim().to_owned()),
        Err(_) => Finding::fine("processor's clock", "not ours to set"),
    }
}

/// Tries it in a thread that ends at once, so that nothing keeps the priority.
fn check_realtime_priority() -> Finding {
    let tried = std::thread::spawn(|| hw::realtime::set_realtime_priority(1)).join();
    match tried {
        Ok(Ok(())) => Finding::fine("real-time priority", "may be set (run --realtime)"),
        _ => Finding::note(
            "real-time priority",
            "may not be set by this user",
            "install the systemd unit (its LimitRTPRIO), or: sudo setcap cap_sys_nice,cap_ipc_lock+ep mirrorball",
        ),
    }
}
