//! How much freed memory does the process retain? The setting is one per process, and the larger request wins.

use std::sync::atomic::{AtomicI32, Ordering};

/// What a run retains for the next images, bytes: some images and a log's chunks.
pub(crate) const RUN_RETAINED_BYTES: i32 = 32 << 20;
/// What a window retains for the next frames, bytes: textures, meshes and a software renderer's buffers.
#[cfg(feature = "view")]
pub(crate) const WINDOW_RETAINED_BYTES: i32 = 64 << 20;

static RETAINED_BYTES: AtomicI32 = AtomicI32::new(0);

/// Retains freed memory up to `bytes`, or up to the largest earlier request.
pub(crate) fn retain_freed_memory(bytes: i32) {
    let largest = RETAINED_BYTES
        .fetch_max(bytes, Ordering::Relaxed)
        .max(bytes);
    hw::realtime::retain_freed_memory(largest);
}
