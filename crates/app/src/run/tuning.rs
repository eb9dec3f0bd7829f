//! How are settings changed while the robot plays? A thread builds the pipeline of the new settings, and the run takes it
//! between two cycles.

use std::collections::{BTreeMap, VecDeque};
use std::io::Read;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail, ensure};
use pipeline::config::apply_overlay;
#[cfg(any(test, feature = "view"))]
use pipeline::datagram::authentication::append_mac;
use pipeline::datagram::authentication::{MAC_BYTES, MacKey, verify_mac};
use pipeline::setup::Setup;
use pipeline::{Pipeline, PipelineConfig};

/// Key of an overlay that returns to the settings of the start, before its other values apply.
const REVOKE_KEY: &str = "revoke";
/// Key of an overlay that names who changes the settings.
pub(crate) const AUTHOR_KEY: &str = "by";
/// Longest name of an author, characters.
const AUTHOR_CHARS_MAX: usize = 64;
/// Changes that the history keeps.
const HISTORY_MAX: usize = 30;
/// Changes that are listed in a message.
const LISTED_CHANGES: usize = 8;

/// A pipeline with other settings, ready for the next cycle.
pub(crate) struct PreparedPipeline {
    pub(crate) pipeline: Pipeline,
    /// All its settings (TOML), for the log.
    pub(crate) settings: String,
    /// What has changed, for the operator.
    pub(crate) changes: String,
    /// The same settings.
    pub(crate) config: PipelineConfig,
}

/// The run's side of the tuning.
pub(crate) struct Tuning {
    desk: TuningHandle,
    prepared: Receiver<PreparedPipeline>,
}

/// The stream's side of the tuning; clones share it.
#[derive(Clone)]
pub(crate) struct TuningHandle {
    /// Wakes the thread that builds pipelines.
    wake: SyncSender<()>,
    shared: Arc<Mutex<TuningState>>,
    key: Option<MacKey>,
}

/// Accepted changes that wait for their pipeline.
struct RequestedChange {
    /// All settings after the last of them.
    config: PipelineConfig,
    authors: Vec<String>,
}

struct TuningState {
    /// Settings of the start.
    initial: PipelineConfig,
    /// Settings in use.
    current: PipelineConfig,
    /// Settings after all accepted changes. The next change applies to them.
    accepted: PipelineConfig,
    /// Changes that no pipeline is built for yet. A later one joins them, so that none is lost.
    waiting: Option<RequestedChange>,
    /// Number that the next sealed change must name.
    nonce: String,
    /// Result of the last change.
    message: String,
    /// Changes in use since when, by whom: a line each.
    history: VecDeque<String>,
    /// Number of changes of anything here.
    revision: u64,
}

/// What a client sees.
#[derive(Debug, Clone)]
pub(crate) struct TuningView {
    /// Settings in use.
    pub(crate) config: PipelineConfig,
    /// Number that the next sealed change must name.
    pub(crate) nonce: String,
    /// Result of the last change.
    pub(crate) message: String,
    /// Changes with time and author: a line each, the latest last.
    pub(crate) history: String,
    /// A change needs a seal.
    pub(crate) is_sealed: bool,
}

impl Tuning {
    /// Starts the thread that builds pipelines. `key`: the phrase under which changes are accepted; None accepts all.
    pub(crate) fn start(setup: Setup, config: &PipelineConfig, key: Option<&str>) -> Result<Self> {
        let shared = Arc::new(Mutex::new(TuningState::new(config)?));
        let (wake, woken) = sync_channel(1);
        let (sender, prepared) = sync_channel(1);
        let state = shared.clone();
        let mut previous = config.clone();
        let build = move || {
            hw::realtime::lower_priority();
            for () in woken {
                let Some(requested) = lock(&state).waiting.take() else {
                    continue;
                };
                match prepare(&setup, &previous, requested) {
                    Ok(prepared) => {
                        // The run takes every pipeline, in this order.
                        previous = prepared.config.clone();
                        if sender.send(prepared).is_err() {
                            return;
                        }
                    }
                    Err(error) => lock(&state).reject_prepared(&previous, &error),
                }
            }
        };
        std::thread::Builder::new()
            .name("tuning".to_owned())
            .spawn(build)?;
        Ok(Tuning {
            desk: TuningHandle {
                wake,
                shared,
                key: key.map(MacKey::new).transpose()?,
            },
            prepared,
        })
    }

    /// The stream's side.
    pub(crate) fn desk(&self) -> TuningHandle {
        self.desk.clone()
    }

    /// A pipeline with new settings, if one is ready. It counts as in use from now on.
    pub(crate) fn take_prepared(&self) -> Option<PreparedPipeline> {
        let prepared = self.prepared.try_recv().ok()?;
        let mut state = lock(&self.desk.shared);
        state.current = prepared.config.clone();
        let line = format!("{}  {}", utc_now(), prepared.changes);
        state.history.push_back(line);
        if state.history.len() > HISTORY_MAX {
            state.history.pop_front();
        }
        state.report(format!("changed: {}", prepared.changes));
        drop(state);
        Some(prepared)
    }
}

impl TuningHandle {
    /// What a client sees now.
    pub(crate) fn view(&self) -> TuningView {
        let state = lock(&self.shared);
        TuningView {
            config: state.current.clone(),
            nonce: state.nonce.clone(),
            message: state.message.clone(),
            history: state.history.iter().cloned().collect::<Vec<_>>().join("\n"),
            is_sealed: self.key.is_some(),
        }
    }

    /// The same without a key, for an interface that has its own rules who may change settings.
    #[cfg(feature = "ros2")]
    pub(crate) fn without_key(&self) -> Self {
        TuningHandle {
            key: None,
            ..self.clone()
        }
    }

    /// Increases with every change and every rejection.
    pub(crate) fn revision(&self) -> u64 {
        lock(&self.shared).revision
    }

    /// Requests a change by an overlay (TOML). `seal`: from [`seal`], if there is a key.
    ///
    /// The result comes later, in [`TuningView::message`].
    pub(crate) fn request(&self, overlay: &str, seal: Option<&str>) -> Result<()> {
        let result = self.try_request(overlay, seal);
        if let Err(error) = &result {
            lock(&self.shared).report(format!("rejected: {error:#}"));
        }
        result
    }

    fn try_request(&self, overlay: &str, seal: Option<&str>) -> Result<()> {
        let mut state = lock(&self.shared);
        if let Some(key) = &self.key {
            let seal =
                seal.context("the settings of this robot are under a key: the change has no seal")?;
            ensure!(
                is_sealed(key, &state.nonce, overlay, seal),
                "the change is not sealed under the key of this robot, or for an earlier nonce"
            );
            state.nonce = random_nonce()?;
        }
        let mut overlay: toml::Table = overlay.parse().context("invalid TOML")?;
        let author = match overlay.remove(AUTHOR_KEY) {
            Some(toml::Value::String(name)) => Some(printable(&name)),
            Some(_) => bail!("{AUTHOR_KEY}: expected a name"),
            None => None,
        };
        let base = match overlay.remove(REVOKE_KEY) {
            Some(toml::Value::Boolean(true)) => &state.initial,
            Some(_) => bail!("{REVOKE_KEY}: expected true"),
            None => &state.accepted,
        };
        let config = apply_overlay(base, overlay)?;
        ensure!(
            config.team.number == state.current.team.number,
            "team.number cannot change while the robot plays"
        );
        state.accept(config, author);
        match self.wake.try_send(()) {
            Err(TrySendError::Disconnected(())) => bail!("the run has ended"),
            // A full channel wakes the thread as well.
            Ok(()) | Err(TrySendError::Full(())) => Ok(()),
        }
    }
}

impl TuningState {
    fn new(config: &PipelineConfig) -> Result<Self> {
        Ok(TuningState {
            initial: config.clone(),
            current: config.clone(),
            accepted: config.clone(),
            waiting: None,
            nonce: random_nonce()?,
            message: String::new(),
            history: VecDeque::new(),
            revision: 0,
        })
    }

    fn accept(&mut self, config: PipelineConfig, author: Option<String>) {
        self.accepted = config.clone();
        let waiting = self.waiting.take();
        let mut authors = waiting.map_or_else(Vec::new, |waiting| waiting.authors);
        authors.extend(author.filter(|name| !authors.contains(name)));
        self.waiting = Some(RequestedChange { config, authors });
    }

    /// No pipeline has the accepted settings. `previous`: those of the last pipeline.
    fn reject_prepared(&mut self, previous: &PipelineConfig, error: &anyhow::Error) {
        if self.waiting.is_none() {
            self.accepted = previous.clone();
        }
        self.report(format!("rejected: {error:#}"));
    }

    fn report(&mut self, message: String) {
        self.message = message;
        self.revision += 1;
    }
}

/// The seal of a change under a phrase: hexadecimal digits.
#[cfg(any(test, feature = "view"))]
pub(crate) fn seal(phrase: &str, nonce: &str, overlay: &str) -> Result<String> {
    let key = MacKey::new(phrase)?;
    let sealed = append_mac(sealed_content(nonce, overlay), Some(&key));
    let code = &sealed[sealed.len() - MAC_BYTES..];
    Ok(code.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn is_sealed(key: &MacKey, nonce: &str, overlay: &str, seal: &str) -> bool {
    let digit = |byte: u8| (byte as char).to_digit(16);
    let code: Option<Vec<u8>> = seal
        .as_bytes()
        .chunks(2)
        .map(|pair| match pair {
            [high, low] => Some((digit(*high)? * 16 + digit(*low)?) as u8),
            _ => None,
        })
        .collect();
    let Some(code) = code.filter(|code| code.len() == MAC_BYTES) else {
        return false;
    };
    let sealed = [sealed_content(nonce, overlay), code].concat();
    verify_mac(&sealed, Some(key)).is_ok()
}

fn sealed_content(nonce: &str, overlay: &str) -> Vec<u8> {
    format!("mirrorball settings\n{nonce}\n{overlay}").into_bytes()
}

fn random_nonce() -> Result<String> {
    let mut bytes = [0; 16];
    std::fs::File::open("/dev/urandom")
        .and_then(|mut file| file.read_exact(&mut bytes))
        .context("cannot read /dev/urandom")?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn prepare(
    setup: &Setup,
    previous: &PipelineConfig,
    RequestedChange { config, authors }: RequestedChange,
) -> Result<PreparedPipeline> {
    let mut changes = describe_changes(previous, &config)?;
    if !authors.is_empty() {
        changes += &format!(" (by {})", authors.join(", "));
    }
    let pipeline = Pipeline::new(setup, &config)?;
    Ok(PreparedPipeline {
        pipeline,
        settings: toml::to_string(&config)?,
        changes,
        config,
    })
}

/// The printable part of a name, for lists and logs.
fn printable(name: &str) -> String {
    let shown = name.chars().filter(|letter| !letter.is_control());
    shown.take(AUTHOR_CHARS_MAX).collect()
}

/// Wall-clock time of day (UTC): hours, minutes, seconds.
fn utc_now() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let seconds = since.map_or(0, |since| since.as_secs()) % 86_400;
    format!(
        "{:02}:{:02}:{:02} UTC",
        seconds / 3600,
        seconds / 60 % 60,
        seconds % 60
    )
}

/// The changed settings: `vision.scan.range_max 9 → 7`.
pub(crate) fn describe_changes(before: &PipelineConfig, after: &PipelineConfig) -> Result<String> {
    let [before, after] = [before, after].map(PipelineConfig::to_table);
    let [before, after] = [flatten(&before?), flatten(&after?)];
    let names: std::collections::BTreeSet<&String> = before.keys().chain(after.keys()).collect();
    let text = |value: Option<&toml::Value>| match value {
        Some(toml::Value::Float(number)) => format!("{}", *number as f32),
        Some(value) => value.to_string(),
        None => "not set".to_owned(),
    };
    let changed = names
        .into_iter()
        .filter(|name| before.get(*name) != after.get(*name))
        .map(|name| {
            let [before, after] = [&before, &after].map(|values| text(values.get(name)));
            format!("{name} {before} → {after}")
        });
    let changed: Vec<String> = changed.collect();
    Ok(match changed.len() {
        0 => "no setting differs".to_owned(),
        1..=LISTED_CHANGES => changed.join(", "),
        count => format!(
            "{} and {} more",
            changed[..LISTED_CHANGES].join(", "),
            count - LISTED_CHANGES
        ),
    })
}

/// All values by their names: `vision.scan.range_max`.
pub(crate) fn flatten(table: &toml::Table) -> BTreeMap<String, toml::Value> {
    let mut values = BTreeMap::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => {
                let inner = flatten(inner).into_iter();
                values.extend(inner.map(|(name, value)| (format!("{key}.{name}"), value)));
            }
            value => drop(values.insert(key.clone(), value.clone())),
        }
    }
    values
}

// Settings and texts are valid even if a thread panicked with the lock.
fn lock(state: &Mutex<TuningState>) -> MutexGuard<'_, TuningState> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_need_the_seal_for_the_present_nonce() {
        let (wake, _woken) = sync_channel(1);
        let state = TuningState::new(&PipelineConfig::default()).expect("a state");
        let desk = TuningHandle {
            wake,
            shared: Arc::new(Mutex::new(state)),
            key: Some(MacKey::new("a shared phrase").expect("a key")),
        };
        let overlay = "vision.scan.range_max = 7.0";
        let nonce = desk.view().nonce;
        let good = seal("a shared phrase", &nonce, overlay).expect("sealed");
        let other = seal("another phrase", &nonce, overlay).expect("sealed");
        assert!(desk.request(overlay, None).is_err());
        for wrong in [&other, "", "zz", &good[..30]] {
            assert!(desk.request(overlay, Some(wrong)).is_err(), "{wrong}");
        }
        assert!(
            desk.request("vision.scan.range_max = 8.0", Some(&good))
                .is_err()
        );
        assert!(desk.request(overlay, Some(&good)).is_ok());
        assert!(desk.request(overlay, Some(&good)).is_err(), "a replay");
        let config = lock(&desk.shared).waiting.take().expect("a change");
        assert_eq!(config.config.vision.scan.range_max, 7.0);
        // A sealed change that is invalid is rejected with its reason.
        let invalid = "vision.scan.range_max = -1.0";
        let sealed = seal("a shared phrase", &desk.view().nonce, invalid).expect("sealed");
        assert!(desk.request(invalid, Some(&sealed)).is_err());
        assert!(
            desk.view().message.contains("must be between"),
            "{}",
            desk.view().message
        );
        assert!(lock(&desk.shared).waiting.is_none());
    }

    #[test]
    fn each_of_many_quick_changes_is_in_force_and_described_truly() {
        let robot = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../samples/sequence/robot.toml");
        let setup = Setup::load(&robot, None).expect("a set-up");
        let config = PipelineConfig::default();
        let tuning = Tuning::start(setup, &config, None).expect("started");
        let mut previous = config.localize.matching.steps_max;
        let requests = [
            "localize.matching.steps_max = 18",
            "vision.scan.range_max = 7.0",
            "localize.matching.steps_max = 11",
            "by = \"Eva\"\nlocalize.matching.steps_max = 12",
            "by = \"Ben\"\nlocalize.matching.steps_max = 21",
        ];
        for request in requests {
            tuning.desk().request(request, None).expect("accepted");
        }
        let mut seen = Vec::new();
        while tuning.desk().view().config.localize.matching.steps_max != 21 {
            let Some(prepared) = tuning.take_prepared() else {
                std::thread::sleep(std::time::Duration::from_millis(1));
                continue;
            };
            let steps = prepared.config.localize.matching.steps_max;
            if steps != previous {
                let change = format!("localize.matching.steps_max {previous} → {steps}");
                assert!(prepared.changes.contains(&change), "{}", prepared.changes);
            }
            previous = steps;
            seen.push(prepared.changes);
        }
        assert_eq!(tuning.desk().view().config.vision.scan.range_max, 7.0);
        assert!(seen.last().is_some_and(|last| last.contains("Ben")));
        let history = tuning.desk().view().history;
        assert_eq!(history.lines().count(), seen.len(), "{history}");
    }

    #[test]
    fn changes_are_described_by_name_and_values() {
        let before = PipelineConfig::default();
        let mut after = before.clone();
        after.vision.scan.range_max = 7.1;
        let text = describe_changes(&before, &after).expect("described");
        assert_eq!(text, "vision.scan.range_max 9 → 7.1");
    }
}
