//! Tests of the log as a whole: complete, truncated and damaged files.

mod broken;
mod format;
mod index;
mod kept;
mod rewritten;
