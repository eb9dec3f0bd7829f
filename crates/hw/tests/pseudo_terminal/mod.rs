//! Devices on the bench: pseudo terminals that a test plugs in, speaks through and unplugs again.

use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::time::Duration;

use hw::{DeviceEvent, EventQueue};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use tempfile::TempDir;

/// Longest time that anything is waited for; nothing here takes a hundredth of it on an idle machine.
const TIMEOUT: Duration = Duration::from_secs(20);

/// A place where a serial device is plugged in, under a name that stays the same.
pub(crate) struct PseudoSerialPort {
    folder: TempDir,
    master: Option<OwnedFd>,
}

impl PseudoSerialPort {
    pub(crate) fn disconnected() -> Self {
        PseudoSerialPort {
            folder: tempfile::tempdir().expect("a folder"),
            master: None,
        }
    }

    pub(crate) fn connected() -> Self {
        let mut socket = PseudoSerialPort::disconnected();
        socket.connect();
        socket
    }

    pub(crate) fn path(&self) -> PathBuf {
        self.folder.path().join("tty")
    }

    pub(crate) fn path_string(&self) -> String {
        self.path().to_str().expect("a name").to_owned()
    }

    pub(crate) fn connect(&mut self) {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags).expect("a pseudo terminal");
        grantpt(&master).expect("granted");
        unlockpt(&master).expect("unlocked");
        let name = ptsname(&master, Vec::new()).expect("a name");
        // An own slave keeps the line alive until the driver has opened it.
        std::os::unix::fs::symlink(name.to_str().expect("text"), self.path()).expect("linked");
        self.master = Some(master);
    }

    pub(crate) fn disconnect(&mut self) {
        std::fs::remove_file(self.path()).expect("unlinked");
        self.master = None;
    }

    /// Sends bytes to the driver.
    pub(crate) fn send(&self, bytes: &[u8]) {
        let mut rest = bytes;
        while !rest.is_empty() {
            let written = rustix::io::write(self.master.as_ref().expect("plugged"), rest);
            rest = &rest[written.expect("written")..];
        }
    }

    /// What the driver has sent; waits a little if nothing is there.
    pub(crate) fn read(&self) -> Vec<u8> {
        let master = self.master.as_ref().expect("plugged");
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
pub(crate) fn wait_until<T>(what: &str, mut step: impl FnMut() -> Option<T>) -> T {
    let began = hw::now();
    loop {
        if let Some(result) = step() {
            return result;
        }
        assert!(
            hw::now() - began < TIMEOUT.as_secs_f64(),
            "waited for {what}"
        );
    }
}

/// Takes events until one is what is wanted.
pub(crate) fn wait_for_event<T>(
    inbox: &EventQueue,
    what: &str,
    mut wanted: impl FnMut(DeviceEvent) -> Option<T>,
) -> T {
    wait_until(what, || {
        inbox
            .pop_timeout(Duration::from_millis(5))
            .and_then(&mut wanted)
    })
}
