//! How does the robot's process get the processor first? Real-time priority and locked memory.

#![expect(
    unsafe_code,
    reason = "scheduling and locking have no safe API; the calls take plain numbers and one structure"
)]

use rustix::io::Errno;

/// The shortest time slice that Linux accepts.
const SCHEDULER_SLICE_NS: u64 = 100_000;
/// Niceness added by [`lower_priority`]: a tenth of the usual weight (kernel/sched/core.c, sched_prio_to_weight).
const NICE_INCREMENT: libc::c_int = 10;

/// Gives the calling thread, and threads that it starts later, a real-time priority (SCHED_FIFO, 1 to 99).
///
/// The process needs CAP_SYS_NICE or an rtprio limit at least as high.
pub fn set_realtime_priority(priority: i32) -> Result<(), Errno> {
    // SAFETY: all zeros are a valid value of this structure of numbers.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = priority;
    // SAFETY: the structure outlives the call; 0 is the calling thread.
    errno_result(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) })
}

/// Locks all present and future memory of the process. It needs CAP_IPC_LOCK or a memlock limit.
pub fn lock_memory() -> Result<(), Errno> {
    // SAFETY: the call takes only flags.
    errno_result(unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) })
}

/// Keeps up to `bytes` of freed memory in the process.
///
/// glibc otherwise returns blocks of an image's size at once, and each page of the next image is a page fault.
pub fn retain_freed_memory(bytes: i32) {
    // SAFETY: the calls take only numbers. A setting that glibc refuses stays unchanged.
    #[cfg(target_env = "gnu")]
    unsafe {
        let _accepted = libc::mallopt(libc::M_MMAP_THRESHOLD, bytes);
        let _accepted = libc::mallopt(libc::M_TRIM_THRESHOLD, bytes);
    }
    #[cfg(not(target_env = "gnu"))]
    let _ = bytes;
}

/// Requests low wake-up latency with short time slices for the calling thread and those it starts.
///
/// Needs no permission. Among threads of equal niceness Linux (from 6.12) first runs the one with the shorter slice;
/// older kernels ignore it.
pub fn request_low_latency() {
    // SAFETY: all zeros are a valid value of this structure of numbers; the call reads it and its size from it; process 0
    // is the calling thread. If the call fails, the thread only wakes later.
    unsafe {
        let mut attributes: libc::sched_attr = std::mem::zeroed();
        attributes.size = size_of::<libc::sched_attr>() as u32;
        attributes.sched_policy = libc::SCHED_OTHER as u32;
        attributes.sched_nice = libc::getpriority(libc::PRIO_PROCESS, 0);
        attributes.sched_runtime = SCHEDULER_SLICE_NS;
        let _accepted = libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0);
    }
}

/// True if threads of this process may take a real-time priority. Tried in a thread that ends at once.
pub fn is_realtime_permitted(priority: i32) -> bool {
    let tried = std::thread::spawn(move || set_realtime_priority(priority)).join();
    matches!(tried, Ok(Ok(())))
}

/// Takes back a real-time priority, which a thread inherits, from the calling thread and those it starts.
pub fn usual_priority() {
    // SAFETY: all zeros are a valid value of this structure of numbers, which outlives the call; 0 is the calling thread.
    // Leaving needs no permission; if it fails all the same, the thread keeps its priority.
    let _accepted = unsafe {
        let parameters: libc::sched_param = std::mem::zeroed();
        libc::sched_setscheduler(0, libc::SCHED_OTHER, &raw const parameters)
    };
}

/// Lowers the priority of the calling thread and those it starts, for work that can wait.
pub fn lower_priority() {
    // No niceness lowers a real-time priority.
    usual_priority();
    // Lowering needs no permission; if it fails all the same, the thread keeps its priority.
    // SAFETY: the calls take only numbers; on Linux process 0 is the calling thread.
    let _accepted = unsafe {
        let niceness = libc::getpriority(libc::PRIO_PROCESS, 0);
        libc::setpriority(libc::PRIO_PROCESS, 0, niceness + NICE_INCREMENT)
    };
}

fn errno_result(result: libc::c_int) -> Result<(), Errno> {
    if result == 0 {
        return Ok(());
    }
    let error = std::io::Error::last_os_error();
    Err(Errno::from_io_error(&error).unwrap_or(Errno::PERM))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thread_for_work_that_can_wait_keeps_no_real_time_priority() {
        let scheduling = || {
            // SAFETY: the calls take only numbers; on Linux process 0 is the calling thread.
            unsafe {
                (
                    libc::sched_getscheduler(0),
                    libc::getpriority(libc::PRIO_PROCESS, 0),
                )
            }
        };
        let (_, niceness) = scheduling();
        let lowered = std::thread::spawn(move || {
            // Without the permission, the claim is about niceness alone.
            let _permitted = set_realtime_priority(1);
            lower_priority();
            scheduling()
        });
        let niceness = (niceness + NICE_INCREMENT).min(19);
        assert_eq!(
            lowered.join().expect("joined"),
            (libc::SCHED_OTHER, niceness)
        );
    }
}
