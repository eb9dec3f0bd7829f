//! Checks a log's set-up in a separate thread: the trials take from seconds to a minute.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};

use anyhow::{Result, anyhow};
use pipeline::setup_check::{self, Effort, SetupReport};

/// The check of the shown log's set-up.
#[derive(Default)]
pub(crate) enum SetupCheck {
    /// Not started.
    #[default]
    Idle,
    /// In progress.
    Running(Receiver<Result<SetupReport>>),
    /// Its result.
    Done(Result<Box<SetupReport>>),
}

impl SetupCheck {
    /// Starts the check of a log.
    pub(crate) fn start(log: PathBuf) -> Self {
        let (sender, receiver) = sync_channel(1);
        let thread = std::thread::Builder::new()
            .name("setup check".to_owned())
            .spawn(move || {
                // The receiver is gone if the log was closed.
                let _ = sender.send(setup_check::check_log(&log, Effort::Full));
            });
        match thread {
            Ok(_) => SetupCheck::Running(receiver),
            Err(error) => SetupCheck::Done(Err(error.into())),
        }
    }

    /// Takes the result when the thread has ended.
    pub(crate) fn poll(&mut self) {
        let SetupCheck::Running(receiver) = self else {
            return;
        };
        match receiver.try_recv() {
            Ok(result) => *self = SetupCheck::Done(result.map(Box::new)),
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => {
                *self = SetupCheck::Done(Err(anyhow!("the check of the set-up panicked")));
            }
        }
    }
}
