//! How is a serial device faked? A pseudo terminal under a name that stays, which can be pulled out and put in again.

use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// A serial line with this program as the device at its far end.
#[derive(Debug)]
pub(super) struct VirtualSerialPort {
    path: PathBuf,
    master: Option<OwnedFd>,
}

impl VirtualSerialPort {
    /// Plugs a device in at `path`.
    pub(super) fn connected(path: &Path) -> Result<Self> {
        let mut line = VirtualSerialPort {
            path: path.to_owned(),
            master: None,
        };
        line.connect()?;
        Ok(line)
    }

    /// Plugs it in, unless it is.
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

    /// Pulls it out: the name is gone, and whoever has it open hears of it.
    pub(super) fn disconnect(&mut self) -> Result<()> {
        self.master = None;
        remove(&self.path)
    }

    /// Sends bytes; what does not fit because nobody reads is lost, as on a wire.
    pub(super) fn send(&self, bytes: &[u8]) {
        if let Some(device) = &self.master {
            let _nobody_reads = rustix::io::write(device, bytes);
        }
    }

    /// What was sent to the device.
    pub(super) fn read(&self) -> Vec<u8> {
        let mut all = Vec::new();
        let Some(device) = &self.master else {
            return all;
        };
        let mut buffer = [0; 4096];
        // A line that nobody has open fails to be read: nothing was sent.
        while let Ok(count @ 1..) = rustix::io::read(device, &mut buffer[..]) {
            all.extend_from_slice(&buffer[..count]);
        }
        all
    }
}

impl Drop for VirtualSerialPort {
    fn drop(&mut self) {
        // The folder may be gone already.
        let _gone = self.disconnect();
    }
}

/// A pseudo terminal that carries every byte as it is, and the name to open it by.
fn pseudo_terminal() -> Result<(OwnedFd, PathBuf), Errno> {
    let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&device)?;
    unlockpt(&device)?;
    let name = ptsname(&device, Vec::new())?;
    // Without this what the device sends would come back to it as an echo until a driver opens the line.
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
