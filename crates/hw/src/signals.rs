//! Which signals end the process in order? SIGQUIT too, which a terminal sends at Ctrl-\ and which else ends it at once.

#![expect(
    unsafe_code,
    reason = "signals have no safe API; the handler makes two calls that are safe in one"
)]

use rustix::io::Errno;

/// Makes SIGQUIT the same as SIGTERM for this process.
pub fn treat_quit_as_termination() -> Result<(), Errno> {
    // SAFETY: all zeros are a valid value of this structure: no flags, an empty mask. It outlives the call, and the handler makes
    // only calls that are safe in a handler.
    let result = unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = terminate as extern "C" fn(libc::c_int) as libc::sighandler_t;
        action.sa_flags = libc::SA_RESTART;
        libc::sigaction(libc::SIGQUIT, &raw const action, std::ptr::null_mut())
    };
    if result == 0 {
        return Ok(());
    }
    let error = std::io::Error::last_os_error();
    Err(Errno::from_io_error(&error).unwrap_or(Errno::INVAL))
}

extern "C" fn terminate(_signal: libc::c_int) {
    // SAFETY: both calls are safe in a signal handler (signal-safety(7)) and take only numbers.
    unsafe {
        libc::kill(libc::getpid(), libc::SIGTERM);
    }
}
