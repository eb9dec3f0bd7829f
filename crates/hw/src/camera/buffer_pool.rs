//! Where do the bytes of images lie? In buffers from a pool, which are allocated before they are needed.

use std::ops::Deref;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Images in flight beside those that consumers queue: one being filled, one queued, one being processed, one published.
const IMAGES_PROCESSED_MAX: usize = 8;
/// Most memory reserved for images, bytes. A sender on a socket chooses their size.
const RESERVED_BYTES_MAX: usize = 64 << 20;

/// Bytes of an image; the buffer returns to its pool when it is dropped.
#[derive(Debug, Default)]
pub struct PooledBytes {
    bytes: Vec<u8>,
    pool: Weak<Mutex<FreeBuffers>>,
}

impl Deref for PooledBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}

impl From<Vec<u8>> for PooledBytes {
    /// Bytes that belong to no pool.
    fn from(bytes: Vec<u8>) -> Self {
        PooledBytes {
            bytes,
            pool: Weak::new(),
        }
    }
}

impl PartialEq for PooledBytes {
    fn eq(&self, other: &Self) -> bool {
        self.bytes == other.bytes
    }
}

impl Drop for PooledBytes {
    fn drop(&mut self) {
        if let Some(pool) = self.pool.upgrade() {
            let bytes = std::mem::take(&mut self.bytes);
            let mut free = lock(&pool);
            if free.buffers.len() < free.kept_max {
                free.buffers.push(bytes);
            }
        }
    }
}

/// Buffers that no image uses.
#[derive(Debug, Default)]
struct FreeBuffers {
    buffers: Vec<Vec<u8>>,
    /// Most buffers kept; those beyond it are freed.
    kept_max: usize,
    /// Bytes of an image for which buffers are reserved.
    image_bytes: usize,
}

/// Reuses the buffers of dropped images.
#[derive(Debug)]
pub(crate) struct BufferPool {
    free: Arc<Mutex<FreeBuffers>>,
}

impl BufferPool {
    /// `queued_images`: images that consumers may queue at once, as a log does.
    pub(crate) fn new(queued_images: usize) -> Self {
        let free = FreeBuffers {
            kept_max: IMAGES_PROCESSED_MAX + queued_images,
            ..FreeBuffers::default()
        };
        BufferPool {
            free: Arc::new(Mutex::new(free)),
        }
    }

    /// Allocates the buffers of all images that may be in flight, once for a size. A run's memory then does not grow
    /// when the disk is slow for the first time, and no image waits for pages of the system.
    pub(crate) fn reserve(&self, image_bytes: usize) {
        let mut free = lock(&self.free);
        if image_bytes <= free.image_bytes {
            return;
        }
        free.image_bytes = image_bytes;
        let count = free.kept_max.min(RESERVED_BYTES_MAX / image_bytes);
        free.buffers.clear();
        free.buffers
            .resize_with(count, || written_buffer(image_bytes));
    }

    /// Takes a buffer and lets `fill` replace its content, the bytes of an earlier image.
    pub(crate) fn fill<E>(
        &self,
        fill: impl FnOnce(&mut Vec<u8>) -> Result<(), E>,
    ) -> Result<Arc<PooledBytes>, E> {
        let mut bytes = lock(&self.free).buffers.pop().unwrap_or_default();
        let result = fill(&mut bytes);
        let pool = Arc::downgrade(&self.free);
        let bytes = Arc::new(PooledBytes { bytes, pool });
        result.map(|()| bytes)
    }
}

/// A buffer whose pages are in memory: the system gives a page when it is first written.
#[expect(
    clippy::slow_vector_initialization,
    reason = "`vec![0; n]` takes pages that nobody has written"
)]
fn written_buffer(length: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(length);
    bytes.resize(length, 0);
    bytes
}

// The list of buffers is valid after a panic of another thread.
fn lock(free: &Mutex<FreeBuffers>) -> MutexGuard<'_, FreeBuffers> {
    free.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn take(pool: &BufferPool, length: usize) -> Arc<PooledBytes> {
        let filled = pool.fill(|bytes| {
            bytes.resize(length, 7);
            Ok::<(), ()>(())
        });
        filled.expect("filled")
    }

    fn free_addresses(pool: &BufferPool) -> Vec<*const u8> {
        let mut free: Vec<_> = lock(&pool.free)
            .buffers
            .iter()
            .map(|it| it.as_ptr())
            .collect();
        free.sort();
        free
    }

    #[test]
    fn images_in_flight_allocate_nothing_after_the_first() {
        let pool = BufferPool::new(5);
        pool.reserve(1000);
        let reserved = free_addresses(&pool);
        assert_eq!(reserved.len(), IMAGES_PROCESSED_MAX + 5);
        let images: Vec<_> = reserved.iter().map(|_| take(&pool, 1000)).collect();
        assert!(free_addresses(&pool).is_empty());
        drop(images);
        pool.reserve(900);
        assert_eq!(free_addresses(&pool), reserved);
    }

    #[test]
    fn buffers_beyond_the_reserve_are_freed() {
        let pool = BufferPool::new(0);
        drop([(); 20].map(|()| take(&pool, 10)));
        assert_eq!(free_addresses(&pool).len(), IMAGES_PROCESSED_MAX);
    }

    #[test]
    fn huge_images_reserve_a_bounded_memory() {
        let pool = BufferPool::new(30);
        pool.reserve(RESERVED_BYTES_MAX / 2);
        assert_eq!(free_addresses(&pool).len(), 2);
        pool.reserve(RESERVED_BYTES_MAX + 1);
        assert!(free_addresses(&pool).is_empty());
    }
}
