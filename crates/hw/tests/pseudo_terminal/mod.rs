//! Simulated serial devices: pseudo terminals that a test connects, uses and disconnects.

use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::time::Duration;

use hw::{DeviceEvent, EventQueue};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use tempfile::TempDir;

/// Timeout of every wait; an idle machine needs less than a hundredth of it.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A serial port with a constant path, to which a device can be connected.
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
        let mut port = PseudoSerialPort::disconnected();
        port.connect();
        port
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
        // A terminal echoes until the driver has set it up: the test would take its own bytes for the driver's.
        let mut mode = tcgetattr(&master).expect("a mode");
        mode.make_raw();
        tcsetattr(&master, OptionalActions::Now, &mode).expect("set");
        let name = ptsname(&master, Vec::new()).expect("a name");
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
            let written = rustix::io::write(self.master.as_ref().expect("connected"), rest);
            rest = &rest[written.expect("written")..];
        }
    }

    /// The bytes that the driver has sent; waits 2 ms if there are none.
    pub(crate) fn read(&self) -> Vec<u8> {
        let master = self.master.as_ref().expect("connected");
        let wait = Timespec {
            tv_sec: 0,
            tv_nsec: 2_000_000,
        };
        let mut fds = [PollFd::new(master, PollFlags::IN)];
        let mut buffer = vec![0; 4096];
        if poll(&mut fds, Some(&wait)).expect("polled") == 0 {
            return Vec::new();
        }
        // Reading fails while the driver has the port closed; then it has sent nothing.
        let bytes = rustix::io::read(master, &mut buffer[..]).unwrap_or(0);
        buffer.truncate(bytes);
        buffer
    }
}

/// Repeats `step` until it returns a value.
pub(crate) fn wait_until<T>(what: &str, mut step: impl FnMut() -> Option<T>) -> T {
    let start = hw::now();
    loop {
        if let Some(result) = step() {
            return result;
        }
        assert!(
            hw::now() - start < TIMEOUT.as_secs_f64(),
            "timeout while waiting for {what}"
        );
    }
}

/// Takes events until `select` returns a value for one.
pub(crate) fn wait_for_event<T>(
    queue: &EventQueue,
    what: &str,
    mut select: impl FnMut(DeviceEvent) -> Option<T>,
) -> T {
    wait_until(what, || {
        queue
            .pop_timeout(Duration::from_millis(5))
            .and_then(&mut select)
    })
}
