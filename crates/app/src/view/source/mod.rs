//! Sources of cycles: a log, the view's own simulation, a run in this process, or a remote robot.

pub(crate) mod decoded_cycle;
pub(crate) mod field_reader;
mod image_prefetch;
pub(crate) mod inbox;
pub(crate) mod live;
pub(crate) mod log;
pub(crate) mod metrics_reader;
pub(crate) mod other_run;
pub(crate) mod recompute;
pub(crate) mod recording;
pub(crate) mod remote;
pub(crate) mod remote_settings;
pub(crate) mod sim_worker;
pub(crate) mod stop_guard;

use std::path::Path;
use std::sync::Arc;

use decoded_cycle::DecodedCycle;
use pipeline::Cycle;

/// True for `ws://…` and `host:port`, unless it is a file.
pub(crate) fn is_stream_address(path: &Path) -> bool {
    let text = path.to_string_lossy();
    let port = text.rsplit_once(':').map(|(_, port)| port.parse::<u16>());
    !path.exists() && (text.starts_with("ws://") || matches!(port, Some(Ok(_))))
}

/// The number after `host:` where it is no port, unless it is a file's name.
pub(crate) fn invalid_port(path: &Path) -> Option<String> {
    let text = path.to_string_lossy();
    let (_, port) = text.rsplit_once(':')?;
    let is_number = !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
    (is_number && !path.exists() && port.parse::<u16>().is_err()).then(|| port.to_owned())
}

/// A source of cycles.
pub(crate) enum Source {
    /// No source.
    Empty,
    /// A log.
    Log(Box<log::LogPlayer>),
    /// A live source, which runs on its own.
    Live(Box<live::LiveSource>),
}

impl Source {
    /// First and last time that can be shown, seconds.
    pub(crate) fn span(&self) -> Option<(f64, f64)> {
        match self {
            Source::Empty => None,
            Source::Log(player) => Some(player.span()),
            Source::Live(live) => live.span(),
        }
    }

    /// The cycle to show at a time: the last one at or before it, else the first.
    pub(crate) fn seek(&mut self, time: f64) -> anyhow::Result<Option<DecodedCycle>> {
        match self {
            Source::Empty => Ok(None),
            Source::Log(player) => player.seek(time),
            Source::Live(live) => Ok(live.seek(time)),
        }
    }

    /// The cycle `by` cycles after (negative: before) the one shown last.
    pub(crate) fn step(&mut self, by: i64) -> anyhow::Result<Option<DecodedCycle>> {
        match self {
            Source::Empty => Ok(None),
            Source::Log(player) => player.step(by),
            Source::Live(live) => Ok(live.step(by)),
        }
    }

    /// The last cycle at or before a time, without its image. The cycle that the source shows stays the same.
    pub(crate) fn cycle_at(&mut self, time: f64) -> Option<Arc<Cycle>> {
        match self {
            Source::Empty => None,
            // The player reports what cannot be read where it is the first run.
            Source::Log(player) => player.cycle_at(time).ok().flatten(),
            Source::Live(live) => live.cycle_at(time),
        }
    }

    /// Changes the settings of a connected robot.
    pub(crate) fn remote_settings(&self) -> Option<&remote_settings::RemoteSettings> {
        match self {
            Source::Live(live) => live.remote_settings.as_ref(),
            _ => None,
        }
    }

    /// The simulation, if the view owns it.
    pub(crate) fn simulation(&self) -> Option<&sim_worker::SimWorker> {
        match self {
            Source::Live(live) => live.worker(),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_that_is_no_port_is_named() {
        let port = |text: &str| invalid_port(Path::new(text));
        assert_eq!(port("127.0.0.1:99999").as_deref(), Some("99999"));
        assert_eq!(port("robot:8765"), None);
        assert_eq!(port("no/such/run.mcap"), None);
    }
}
