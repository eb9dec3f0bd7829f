//! How is a line printed to a standard error that may be gone? A closed terminal or pipe ends neither a run nor a command.

use std::fmt::Arguments;
use std::io::Write;

/// Prints a line on standard error. Unlike `eprintln!` it does not panic if nobody can read it: a panic while the terminal is
/// closed would abort the process.
pub fn print_stderr(line: Arguments<'_>) {
    let mut out = std::io::stderr().lock();
    // There is nobody to tell.
    let _gone = writeln!(out, "{line}");
}

/// [`print_stderr`] with the arguments of `format!`.
macro_rules! stderr_line {
    ($($argument:tt)*) => {
        $crate::print_stderr(format_args!($($argument)*))
    };
}
