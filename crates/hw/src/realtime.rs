//! How does the robot's process come before all others? Real-time priority, and memory that stays.

#![expect(
    unsafe_code,
    reason = "scheduling and locking have no safe form; the calls get plain numbers and one structure"
)]

use rustix::io::Errno;

/// The shortest slice that may be asked for.
const SCHEDULER_SLICE_NS: u64 = 100_000;
/// How much nicer a thread is that stands back: a tenth of the weight of the others (kernel/sched/core.c, sched_prio_to_weight).
const NICE_INCREMENT: libc::c_int = 10;

/// Gives the calling thread, and every thread that it starts from then on, this real-time priority (1 to 99, first in, first
/// out). The process needs CAP_SYS_NICE or a limit on rtprio as high.
pub fn set_realtime_priority(priority: i32) -> Result<(), Errno> {
    // SAFETY: all-zero is a value of this structure of numbers.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = priority;
    // SAFETY: the structure outlives the call; 0 is the calling thread.
    errno_result(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) })
}

/// Keeps all memory of the process, now and later, from being paged out. It needs CAP_IPC_LOCK or a limit on memlock.
pub fn lock_memory() -> Result<(), Errno> {
    // SAFETY: takes nothing but flags.
    errno_result(unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) })
}

/// Keeps freed memory up to so many bytes for what is allocated next; of an image's size glibc else gives it back at once,
/// and each page of the next image is a fault.
pub fn retain_freed_memory(bytes: i32) {
    // SAFETY: takes nothing but numbers. What glibc refuses stays as it was.
    #[cfg(target_env = "gnu")]
    unsafe {
        let _told = libc::mallopt(libc::M_MMAP_THRESHOLD, bytes);
        let _told = libc::mallopt(libc::M_TRIM_THRESHOLD, bytes);
    }
    #[cfg(not(target_env = "gnu"))]
    let _ = bytes;
}

/// Lets the calling thread, and those it starts, be taken up promptly when something arrives, for a short while each time.
///
/// Needs no permission. Among threads of equal niceness Linux (from 6.12) serves first whose slice is shorter; older ones
/// ignore it.
pub fn request_low_latency() {
    // SAFETY: all-zero is a value of this structure of numbers; the call reads it, and its size from it; process 0 is the
    // calling thread. One that is not taken up sooner works all the same.
    unsafe {
        let mut attributes: libc::sched_attr = std::mem::zeroed();
        attributes.size = size_of::<libc::sched_attr>() as u32;
        attributes.sched_policy = libc::SCHED_OTHER as u32;
        attributes.sched_nice = libc::getpriority(libc::PRIO_PROCESS, 0);
        attributes.sched_runtime = SCHEDULER_SLICE_NS;
        let _told = libc::syscall(libc::SYS_sched_setattr, 0, &raw const attributes, 0);
    }
}

/// Lets the calling thread, and those it starts, give way to the others of the process: what they do can wait.
pub fn lower_priority() {
    // A thread may always give way; one that cannot stays what it is.
    // SAFETY: takes nothing but numbers; on Linux process 0 is the calling thread.
    let _told = unsafe {
        let usual = libc::getpriority(libc::PRIO_PROCESS, 0);
        libc::setpriority(libc::PRIO_PROCESS, 0, usual + NICE_INCREMENT)
    };
}

fn errno_result(result: libc::c_int) -> Result<(), Errno> {
    if result == 0 {
        return Ok(());
    }
    let error = std::io::Error::last_os_error();
    Err(Errno::from_io_error(&error).unwrap_or(Errno::PERM))
}
