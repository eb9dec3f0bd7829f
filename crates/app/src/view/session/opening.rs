//! How does a session begin? With a log, a recording folder, a scenario, or a connection to a robot.

use std::path::Path;
use std::sync::Arc;

use anyhow::Result;

use super::{Playback, Session, base_config_of};
use crate::view::curves::CurveStore;
use crate::view::settings_state::SettingsState;
use crate::view::source::field_reader::FieldReader;
use crate::view::source::inbox::CycleInbox;
use crate::view::source::live::LiveSource;
use crate::view::source::log::LogPlayer;
use crate::view::source::metrics_reader::MetricsReader;
use crate::view::source::recording::log_of_recording;
use crate::view::source::sim_worker::SimWorker;
use crate::view::source::{Source, is_stream_address, remote};
use crate::view::static_scene::StaticScene;
use pipeline::PipelineConfig;
use pipeline::config::PIPELINE_FILE;
use pipeline::log::LogIndex;
use pipeline::setup::Setup;

impl Session {
    /// Opens a log (`.mcap`) or a recording folder, plays a scenario (`.toml`), or connects to a robot's stream (`host:port`).
    pub(crate) fn open(path: &Path) -> Result<Self> {
        if is_stream_address(path) {
            return Session::connect(&path.to_string_lossy());
        }
        if path.is_dir() {
            Session::recording(path)
        } else if path.extension().is_some_and(|end| end == "toml") {
            Session::open_scenario(path, None, PipelineConfig::default())
        } else {
            Session::log(path)
        }
    }

    /// Computes and opens the poses of a recording folder.
    fn recording(folder: &Path) -> Result<Self> {
        let (place, log) = log_of_recording(folder)?;
        Ok(Session {
            title: format!("recording {}", folder.display()),
            _recording_log: Some(place),
            ..Session::log(&log)?
        })
    }

    /// Opens a log of any version.
    pub(crate) fn log(path: &Path) -> Result<Self> {
        let mut player = LogPlayer::new(LogIndex::open(path)?);
        let mut warnings = player.index().warnings().to_vec();
        let scene = match player.load_setup() {
            Ok(setup) => Some(Arc::new(StaticScene::new(setup))),
            Err(error) => {
                warnings.push(format!(
                    "cannot load the log's robot: {error:#}. Field and ground map are not shown"
                ));
                None
            }
        };
        let recorded_config = parse_config(
            player.index().header().files.get(PIPELINE_FILE),
            &mut warnings,
        );
        let base = base_config_of(scene.as_deref());
        let metrics_reader = MetricsReader::start(player.index().clone(), base)?;
        let clock_offset_ns = player.index().header().clock_offset_ns;
        let holds_poses = player.index().holds_poses();
        let fields = FieldReader::start(path, clock_offset_ns)?;
        let mut session = Session {
            title: format!("log {}", path.display()),
            playback: Playback {
                time: player.span().0,
                ..Playback::default()
            },
            source: Source::Log(Box::new(player)),
            scene,
            warnings,
            settings: SettingsState::new(recorded_config.clone()),
            source_config: recorded_config,
            metrics_reader: Some(metrics_reader),
            clock_offset_ns,
            holds_poses,
            curves: CurveStore::of_log(fields),
            ..Session::default()
        };
        session.step(1);
        if session.shown.is_none() {
            session.show_first_readable();
        }
        Ok(session)
    }

    /// Plays a scenario.
    pub(crate) fn open_scenario(
        path: &Path,
        seed: Option<u64>,
        config: PipelineConfig,
    ) -> Result<Self> {
        let inbox = CycleInbox::default();
        let (worker, setup) = SimWorker::start(path, seed, config.clone(), inbox.clone())?;
        let live = LiveSource::new(inbox, Some(worker));
        let name = format!("simulation {}", path.display());
        Session::from_live(name, live, setup, config)
    }

    /// Connects to a robot over the network.
    pub(crate) fn connect(address: &str) -> Result<Self> {
        let inbox = CycleInbox::default();
        let remote = remote::connect(address, inbox.clone())?;
        let mut warnings: Vec<String> = remote.header.version_mismatch().into_iter().collect();
        let recorded_config = parse_config(remote.header.files.get(PIPELINE_FILE), &mut warnings);
        let mut live = LiveSource::new(inbox, None).with_guard(remote.guard, Some(remote.folder));
        live.remote_settings = Some(remote.settings);
        let name = format!("{address}: {}", remote.header.source);
        Ok(Session {
            warnings,
            clock_offset_ns: remote.header.clock_offset_ns,
            ..Session::from_live(name, live, remote.setup, recorded_config)?
        })
    }

    /// Creates a session of a live source.
    pub(crate) fn from_live(
        name: String,
        live: LiveSource,
        setup: Setup,
        recorded_config: PipelineConfig,
    ) -> Result<Self> {
        Ok(Session {
            title: name,
            curves: CurveStore::of_live_run()?,
            source: Source::Live(Box::new(live)),
            scene: Some(Arc::new(StaticScene::new(setup))),
            playback: Playback {
                playing: true,
                ..Playback::default()
            },
            settings: SettingsState::new(recorded_config.clone()),
            source_config: recorded_config,
            ..Session::default()
        })
    }
}

/// Parses the settings of a log. Settings of an incompatible version become the defaults, with a warning.
fn parse_config(text: Option<&Vec<u8>>, warnings: &mut Vec<String>) -> PipelineConfig {
    let Some(text) = text else {
        return PipelineConfig::default();
    };
    let text = String::from_utf8_lossy(text);
    PipelineConfig::parse(&text).unwrap_or_else(|error| {
        warnings.push(format!(
            "cannot read the settings ({}): defaults are shown",
            error.message()
        ));
        PipelineConfig::default()
    })
}
