//! On which threads does compiled code run? Beside Python's interpreter lock, and after a fork on threads of the new process.

use std::sync::{LazyLock, Mutex, PoisonError};

use pyo3::Python;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// The process that loaded the package: its threads are those of rayon.
static LOADED_BY: LazyLock<u32> = LazyLock::new(std::process::id);

/// Threads of a process that was forked from that one, and its number. A fork copies no threads, so work that waits for those of the
/// parent would wait for ever.
static FORKED: Mutex<Option<(u32, &'static ThreadPool)>> = Mutex::new(None);

/// Remembers the process that loads the package.
pub(crate) fn remember_process() {
    LazyLock::force(&LOADED_BY);
}

/// Runs work without Python's interpreter lock.
pub(crate) fn detached<R: Send>(py: Python<'_>, work: impl FnOnce() -> R + Send) -> R {
    py.detach(|| match forked_threads() {
        Some(threads) => threads.install(work),
        None => work(),
    })
}

/// None in the process that loaded the package, and where no threads can be started.
fn forked_threads() -> Option<&'static ThreadPool> {
    let process = std::process::id();
    if process == *LOADED_BY {
        return None;
    }
    let mut forked = FORKED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((owner, threads)) = *forked
        && owner == process
    {
        return Some(threads);
    }
    let threads = Box::leak(Box::new(ThreadPoolBuilder::new().build().ok()?));
    *forked = Some((process, threads));
    Some(threads)
}
