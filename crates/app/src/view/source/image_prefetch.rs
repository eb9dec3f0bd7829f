//! Decodes the image of the next cycle in a thread while the present one is drawn.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use anyhow::Result;
use localize::Stamp;
use pipeline::log::EncodedImage;
use vision::image::Image;

/// A decoded image, and the stamp of its cycle.
type DecodedImage = (Stamp, Result<Image>);

/// The decoding thread; it ends when this is dropped.
pub(super) struct ImagePrefetch {
    jobs: SyncSender<(Stamp, EncodedImage)>,
    results: Receiver<DecodedImage>,
    requested: Option<Stamp>,
}

impl ImagePrefetch {
    /// Starts the thread.
    pub(super) fn start() -> std::io::Result<Self> {
        let (jobs, received) = sync_channel::<(Stamp, EncodedImage)>(1);
        let (sender, results) = sync_channel(2);
        std::thread::Builder::new()
            .name("images".to_owned())
            .spawn(move || {
                for (stamp, image) in received {
                    // The receiver is gone if the view opened another source.
                    if sender.send((stamp, image.decode())).is_err() {
                        return;
                    }
                }
            })?;
        Ok(ImagePrefetch {
            jobs,
            results,
            requested: None,
        })
    }

    /// Begins to decode the image of a cycle; not if the thread is busy.
    pub(super) fn request(&mut self, stamp: Stamp, image: &EncodedImage) {
        if self.requested == Some(stamp) {
            return;
        }
        // What was decoded for a skipped cycle would fill the queue and stop the thread.
        while self.results.try_recv().is_ok() {}
        let sent = self.jobs.try_send((stamp, image.clone()));
        self.requested = sent.is_ok().then_some(stamp);
    }

    /// The decoded image of a cycle, if it was requested.
    pub(super) fn take(&mut self, stamp: Stamp) -> Option<Result<Image>> {
        if self.requested != Some(stamp) {
            return None;
        }
        self.requested = None;
        // Results of skipped cycles come before.
        loop {
            let (of, image) = self.results.recv().ok()?;
            if of == stamp {
                return Some(image);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use pipeline::log::ImageCompression;

    use super::*;

    #[test]
    fn skipped_images_do_not_stop_the_thread() {
        let image = Image {
            width_px: 8,
            height_px: 8,
            rgb: (0..192).collect(),
        };
        let encoded = EncodedImage::new(&image, ImageCompression::Png, 90);
        let encoded = encoded.expect("encoded").expect("an image");
        let mut prefetch = ImagePrefetch::start().expect("a thread");
        for cycle in 0..50 {
            prefetch.request(Stamp(cycle), &encoded);
        }
        // The thread may be busy with a skipped one.
        let started = std::time::Instant::now();
        let taken = loop {
            prefetch.request(Stamp(99), &encoded);
            if let Some(taken) = prefetch.take(Stamp(99)) {
                break taken.expect("an image");
            }
            assert!(started.elapsed().as_secs() < 60, "the thread has stopped");
            std::thread::yield_now();
        };
        assert_eq!(taken.rgb, image.rgb);
        assert!(prefetch.take(Stamp(0)).is_none());
    }
}
