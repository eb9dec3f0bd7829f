//! How is a serial device simulated? A pseudo terminal with a fixed name, which can be unplugged and plugged in again.

use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// A serial port with this program as its device.
#[derive(Debug)]
pub(super) struct VirtualSerialPort {
    path: PathBuf,
    master: Option<OwnedFd>,
}

impl VirtualSerialPort {
    /// A port plugged in at `path`.
    pub(super) fn connected(path: &Path) -> Result<Self> {
        let mut port = VirtualSerialPort {
            path: path.to_owned(),
            master: None,
        };
        port.connect()?;
        Ok(port)
    }

    /// Plugs it in, if it is not.
    pub(super) fn connect(&mut self) -> Result<()> {
        if self.master.is_some() {
            return Ok(());
        }
        let (device, name) = pseudo_terminal().context("cannot make a pseudo terminal")?;
        remove(&self.path)?;
        std::os::unix::fs::symlink(&name, &self.path)
            .with_context(|| format!("cannot link {}", self.path.display()))?;
        self.master = Some(device);
        Ok(())
    }

    /// Unplugs it: the name is removed, and open descriptors get a hang-up.
    pub(super) fn disconnect(&mut self) -> Result<()> {
        self.master = None;
        remove(&self.path)
    }

    /// Sends bytes. Without a reader, what exceeds the buffer is lost.
    pub(super) fn send(&self, bytes: &[u8]) {
        if let Some(device) = &self.master {
            let _nobody_reads = rustix::io::write(device, bytes);
        }
    }

    /// Reads the bytes sent to the device.
    pub(super) fn read(&self) -> Vec<u8> {
        let mut all = Vec::new();
        let Some(device) = &self.master else {
            return all;
        };
        let mut buffer = [0; 4096];
        // Reading fails while no program has the port open.
        while let Ok(count @ 1..) = rustix::io::read(device, &mut buffer[..]) {
            all.extend_from_slice(&buffer[..count]);
        }
        all
    }
}

impl Drop for VirtualSerialPort {
    fn drop(&mut self) {
        // The folder may have been removed.
        let _gone = self.disconnect();
    }
}

/// A pseudo terminal in raw mode, and its name.
fn pseudo_terminal() -> Result<(OwnedFd, PathBuf), Errno> {
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&device)?;
    unlockpt(&device)?;
    let name = ptsname(&device, Vec::new())?;
    // Without raw mode the terminal echoes the device's bytes until a driver opens it.
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let end = open(&name, flags, Mode::empty())?;
    let mut settings = tcgetattr(&end)?;
    settings.make_raw();
    tcsetattr(&end, OptionalActions::Now, &settings)?;
    fcntl_setfl(&device, OFlags::NONBLOCK)?;
    Ok((device, PathBuf::from(name.to_string_lossy().into_owned())))
}

/// Removes a link that may not be there.
fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}
