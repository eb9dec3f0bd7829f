//! Devices on the bench: pseudo terminals that a test plugs in, speaks through and unplugs again.

use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::time::Duration;

use hw::{Event, Inbox};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tempfile::TempDir;

/// Longest time that anything is waited for; nothing here takes a hundredth of it on an idle machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// A place where a serial device is plugged in, under a name that stays the same.
pub(crate) struct Socket {
    folder: TempDir,
    plugged: Option<OwnedFd>,
}

impl Socket {
    pub(crate) fn empty() -> Self {
        Socket {
            folder: tempfile::tempdir().expect("a folder"),
            plugged: None,
        }
    }

    pub(crate) fn plugged() -> Self {
        let mut socket = Socket::empty();
        socket.plug();
        socket
    }

    pub(crate) fn path(&self) -> PathBuf {
        self.folder.path().join("tty")
    }

    pub(crate) fn name(&self) -> String {
        self.path().to_str().expect("a name").to_owned()
    }

    pub(crate) fn plug(&mut self) {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags).expect("a pseudo terminal");
        grantpt(&master).expect("granted");
        unlockpt(&master).expect("unlocked");
        let name = ptsname(&master, Vec::new()).expect("a name");
        // An own slave keeps the line alive until the driver has opened it.
        std::os::unix::fs::symlink(name.to_str().expect("text"), self.path()).expect("linked");
        self.plugged = Some(master);
    }

    pub(crate) fn unplug(&mut self) {
        std::fs::remove_file(self.path()).expect("unlinked");
        self.plugged = None;
    }

    /// Sends bytes to the driver.
    pub(crate) fn send(&self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let written = rustix::io::write(self.plugged.as_ref().expect("plugged"), rest);
            rest = &rest[written.expect("written")..];
        }
    }

    /// What the driver has sent; waits a little if nothing is there.
    pub(crate) fn received(&self) -> Vec<u8> {
        let master = self.plugged.as_ref().expect("plugged");
        let wait = Timespec {
            tv_sec: 0,
            tv_nsec: 2_000_000,
        };
        let mut fds = [PollFd::new(master, PollFlags::IN)];
        let mut buffer = vec![0; 4096];
        if poll(&mut fds, Some(&wait)).expect("polled") == 0 {
            return Vec::new();
        }
        // A line that the driver has not opened yet (or has closed) fails to be read: nothing was sent.
        let bytes = rustix::io::read(master, &mut buffer[..]).unwrap_or(0);
        buffer.truncate(bytes);
        buffer
    }
}

/// Repeats `step` until it yields something.
pub(crate) fn until<T>(what: &str, mut step: impl FnMut() -> Option<T>) -> T {
    let began = hw::now();
    loop {
        if let Some(result) = step() {
            return result;
        }
        assert!(
            hw::now() - began < PATIENCE.as_secs_f64(),
            "waited for {what}"
        );
    }
}

/// Takes events until one is what is wanted.
pub(crate) fn event<T>(inbox: &Inbox, what: &str, mut wanted: impl FnMut(Event) -> Option<T>) -> T {
    until(what, || {
        inbox.take(Duration::from_millis(5)).and_then(&mut wanted)
    })
}
