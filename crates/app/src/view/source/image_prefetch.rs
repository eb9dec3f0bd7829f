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
        if self.requested != Some(stamp) && self.jobs.try_send((stamp, image.clone())).is_ok() {
            self.requested = Some(stamp);
        }
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
