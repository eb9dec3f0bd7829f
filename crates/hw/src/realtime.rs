//! How does the robot's process come before all others? Real-time priority, and memory that is never paged out.

#![expect(
    unsafe_code,
    reason = "scheduling and locking have no safe form; the calls get plain numbers and one structure"
)]

use rustix::io::Errno;

/// Gives the calling thread, and every thread that it starts from then on, this real-time priority (1 to 99, first in, first
/// out). The process needs CAP_SYS_NICE or a limit on rtprio as high.
pub fn set_priority(priority: i32) -> Result<(), Errno> {
    // SAFETY: all-zero is a value of this structure of numbers.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = priority;
    // SAFETY: the structure outlives the call; 0 is the calling thread.
    done(unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) })
}

/// Keeps all memory of the process, now and later, from being paged out. It needs CAP_IPC_LOCK or a limit on memlock.
pub fn lock_memory() -> Result<(), Errno> {
    // SAFETY: takes nothing but flags.
    done(unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) })
}

fn done(result: libc::c_int) -> Result<(), Errno> {
    if result == 0 {
        return Ok(());
    }
    let error = std::io::Error::last_os_error();
    Err(Errno::from_io_error(&error).unwrap_or(Errno::PERM))
}
