//! Claims about the log as a whole: what goes in comes out, from whole, killed and damaged files.

mod broken;
mod index;
mod kept;
