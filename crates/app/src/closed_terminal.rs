//! Was the terminal of standard output closed? Then nobody reads a report, and its absence is no failure of the command.

use rustix::io::Errno;
use rustix::termios::tcgetattr;

/// True if standard output is a terminal that has been closed. A closed pipe or a full disk is another matter.
pub(crate) fn is_stdout_hung_up() -> bool {
    matches!(tcgetattr(std::io::stdout()), Err(Errno::IO))
}
