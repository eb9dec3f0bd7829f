//! Membership in a domain of DDS: participant, node, topics and services. After an outage it is built anew.

use std::collections::BTreeSet;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, Result, anyhow};
use futures::channel::oneshot;
use futures::executor::block_on;
use ros2_client::dds::rustdds::{DomainParticipant, DomainParticipantBuilder};
use ros2_client::{Context, Node, NodeName};

use super::super::config::Ros2Config;
use super::outage::{Announcements, OutageDetector, ParticipantId};
use super::parameters;
use super::publish::Publishers;
use super::shared::Shared;
use super::subscriptions::{Joined, Subscriptions};
use crate::run::tuning::TuningHandle;

/// Time between two observations of the other participants.
const OBSERVATION_PERIOD: Duration = Duration::from_millis(500);

/// Where the topics of a new membership go.
pub(super) struct Topics {
    pub(super) publishers: SyncSender<Publishers>,
    pub(super) subscriptions: SyncSender<Joined>,
}

/// Joins the domain again when an outage has cut the node off.
pub(super) struct MembershipKeeper {
    config: Ros2Config,
    tuning: Option<TuningHandle>,
    topics: Topics,
    membership: Membership,
    announcements: Announcements,
}

/// Dropping it leaves the domain.
struct Membership {
    participant: DomainParticipant,
    /// Its services end with it.
    _node: Node,
    /// Ends receiving when it is dropped.
    _receiving: oneshot::Sender<()>,
}

impl MembershipKeeper {
    /// Joins the domain, and starts the thread that keeps the node connected.
    pub(super) fn start(
        config: Ros2Config,
        tuning: Option<TuningHandle>,
        topics: Topics,
        shared: Arc<Shared>,
    ) -> Result<JoinHandle<()>> {
        let (report, joined) = sync_channel(1);
        let run = move || {
            // The threads of DDS inherit it: the robot's own cycle comes first.
            hw::realtime::lower_priority();
            let keeper =
                Membership::join(&config, tuning.as_ref(), &topics).and_then(|membership| {
                    Ok(MembershipKeeper {
                        announcements: Announcements::listen(config.domain, config.interface)?,
                        config,
                        tuning,
                        topics,
                        membership,
                    })
                });
            // The other end waits for it.
            match keeper {
                Ok(keeper) => {
                    let _received = report.send(Ok(()));
                    keeper.run(&shared);
                }
                Err(error) => drop(report.send(Err(error))),
            }
        };
        let thread = std::thread::Builder::new()
            .name("ros2 membership".to_owned())
            .spawn(run)?;
        joined
            .recv()
            .context("[ros2] the thread that joins the domain broke off")??;
        Ok(thread)
    }

    fn run(mut self, shared: &Shared) {
        let mut detector = OutageDetector::default();
        let mut is_cut_off = false;
        while !shared.stop_requested.load(Ordering::Relaxed) {
            std::thread::park_timeout(OBSERVATION_PERIOD);
            let announced = self.announcements.senders();
            is_cut_off |= detector.observe(self.membership.participants(), &announced);
            if !is_cut_off {
                continue;
            }
            match Membership::join(&self.config, self.tuning.as_ref(), &self.topics) {
                Ok(membership) => {
                    self.membership = membership;
                    detector = OutageDetector::default();
                    is_cut_off = false;
                    shared.notice("[ros2] joined the domain anew after an outage".to_owned());
                }
                Err(error) => shared.notice(format!("{error:#}")),
            }
        }
    }
}

impl Membership {
    fn join(config: &Ros2Config, tuning: Option<&TuningHandle>, topics: &Topics) -> Result<Self> {
        let participant = DomainParticipantBuilder::new(config.domain)
            .with_only_networks([IpAddr::V4(config.interface)])
            .build()
            .map_err(|error| anyhow!("{error}"))
            .with_context(|| format!("[ros2] cannot join domain {}", config.domain))?;
        let context = Context::from_domain_participant(participant.clone())
            .map_err(|error| anyhow!("[ros2] {error}"))?;
        let name = NodeName::new(&config.namespace, &config.node)
            .map_err(|error| anyhow!("[ros2] invalid node: {error:?}"))?;
        let is_started = Arc::new(AtomicBool::new(false));
        let options = parameters::options(config, tuning, is_started.clone());
        let mut node = context
            .new_node(name, options)
            .map_err(|error| anyhow!("[ros2] {error}"))?;
        is_started.store(true, Ordering::Relaxed);
        let publishers = Publishers::create(&mut node, config)?;
        let subscriptions = Subscriptions::create(&mut node, config)?;
        let spinner = node.spinner().map_err(|error| anyhow!("[ros2] {error}"))?;
        // Ends when the node is dropped.
        std::thread::Builder::new()
            .name("ros2 services".to_owned())
            .spawn(move || drop(block_on(spinner.spin())))?;
        let (receiving, left) = oneshot::channel();
        // A thread that ended by a panic takes nothing; the panic was reported.
        let _ended = topics.publishers.send(publishers);
        let _ended = topics.subscriptions.send((subscriptions, left));
        Ok(Membership {
            participant,
            _node: node,
            _receiving: receiving,
        })
    }

    /// Identities of the other participants that have topics.
    fn participants(&self) -> BTreeSet<ParticipantId> {
        let readers = self.participant.discovered_readers().into_iter();
        let writers = self.participant.discovered_writers().into_iter();
        let endpoints = readers
            .map(|reader| reader.reader_proxy.remote_reader_guid)
            .chain(writers.map(|writer| writer.writer_proxy.remote_writer_guid));
        endpoints
            .filter_map(|endpoint| endpoint.to_bytes().first_chunk().copied())
            .collect()
    }
}
