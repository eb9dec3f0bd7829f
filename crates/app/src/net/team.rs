//! How are team messages sent and received? A multicast socket, a receiving thread, and a thread that sends the newest
//! cycle at the team's rate.

use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use hw::StampedSocket;
use localize::Stamp;
use localize::team::TeamReport;
use socket2::{Domain, Protocol, Socket, Type};

use super::polling::POLL_PERIOD;
use pipeline::datagram::{TeamClock, TeamLink, TeamLinkConfig};
use pipeline::feed::{Feed, RecvError, Subscription};

/// Capacity of the queue of reports for the pipeline: a second of five team-mates.
const MAX_PENDING_REPORTS: usize = 64;
/// A message has some hundred bytes; a longer datagram is cut and then rejected.
const MAX_DATAGRAM_BYTES: usize = 4096;

/// Sends and receives team messages. Dropping it ends the threads.
pub(crate) struct TeamTransport {
    reports: Receiver<TeamReport>,
    link: Arc<Mutex<TeamLink>>,
    stop_requested: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl TeamTransport {
    /// Joins the multicast group; sends the cycles of `feed` and receives the reports of team-mates.
    ///
    /// `clock`: current time in the clock of samples and cycles. `session`: must increase with each start.
    pub(crate) fn join(
        feed: &Feed,
        config: &TeamLinkConfig,
        session: u64,
        clock: impl Fn() -> Stamp + Clone + Send + 'static,
    ) -> Result<Self> {
        let group = config.address()?;
        let link = Arc::new(Mutex::new(TeamLink::new(config, session)?));
        let receiver = open_multicast_socket(group, config.interface)
            .with_context(|| format!("[team] cannot join {group} on {}", config.interface))?;
        let sender = TeamSender {
            socket: receiver.try_clone()?,
            group,
            period: Duration::from_secs_f64(1.0 / config.rate),
        };
        let stop_requested = Arc::new(AtomicBool::new(false));
        let (queue, reports) = sync_channel(MAX_PENDING_REPORTS);
        let mut transport = TeamTransport {
            reports,
            link: link.clone(),
            stop_requested: stop_requested.clone(),
            threads: Vec::new(),
        };
        let mut receiver = StampedSocket::new(receiver)?;
        let (receiving, stop, time) = (link.clone(), stop_requested.clone(), clock.clone());
        transport.spawn("team receive", move || {
            receive_loop(&mut receiver, &receiving, &queue, &stop, time);
        })?;
        let cycles = feed.subscribe(1);
        transport.spawn("team send", move || {
            sender.run(&cycles, &link, &stop_requested, clock);
        })?;
        Ok(transport)
    }

    fn spawn(&mut self, name: &str, run: impl FnOnce() + Send + 'static) -> Result<()> {
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(run)?;
        self.threads.push(thread);
        Ok(())
    }

    /// Reports of team-mates received since the last call; samples for the pipeline.
    pub(crate) fn received_reports(&self) -> impl Iterator<Item = TeamReport> {
        self.reports.try_iter()
    }

    /// The clocks of the team-mates. `now`: own clock.
    pub(crate) fn clocks(&self, now: Stamp) -> Vec<TeamClock> {
        lock(&self.link).team_clocks(now)
    }

    /// The next report; None after the timeout.
    #[cfg(test)]
    pub(crate) fn wait_for_report(&self, timeout: Duration) -> Option<TeamReport> {
        self.reports.recv_timeout(timeout).ok()
    }

    /// Numbers of accepted messages and rejected datagrams.
    #[cfg(test)]
    pub(crate) fn counts(&self) -> pipeline::datagram::TeamLinkCounts {
        lock(&self.link).counts().clone()
    }
}

impl Drop for TeamTransport {
    fn drop(&mut self) {
        self.stop_requested.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
    }
}

fn open_multicast_socket(group: SocketAddrV4, interface: Ipv4Addr) -> Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    // Several robots on one machine (a simulation) receive from the same group.
    socket.set_reuse_address(true)?;
    socket.bind(&SocketAddrV4::new(*group.ip(), group.port()).into())?;
    socket.join_multicast_v4(group.ip(), &interface)?;
    socket.set_multicast_if_v4(&interface)?;
    socket.set_multicast_loop_v4(true)?;
    socket.set_multicast_ttl_v4(1)?;
    Ok(socket.into())
}

fn receive_loop(
    socket: &mut StampedSocket,
    link: &Mutex<TeamLink>,
    reports: &SyncSender<TeamReport>,
    stop: &AtomicBool,
    clock: impl Fn() -> Stamp,
) {
    let mut datagram = [0; MAX_DATAGRAM_BYTES];
    while !stop.load(Ordering::Relaxed) {
        let Some(received) = socket.receive(&mut datagram, POLL_PERIOD) else {
            continue;
        };
        let age = hw::now() - received.arrival;
        let report = lock(link).receive(&datagram[..received.length], clock() + -age);
        if let Ok(report) = report {
            // If the pipeline does not take reports, new ones are dropped.
            let _ = reports.try_send(report);
        }
    }
}

/// Socket, address and period of the messages sent.
struct TeamSender {
    socket: UdpSocket,
    group: SocketAddrV4,
    period: Duration,
}

impl TeamSender {
    fn run(
        &self,
        cycles: &Subscription,
        link: &Mutex<TeamLink>,
        stop: &AtomicBool,
        clock: impl Fn() -> Stamp,
    ) {
        let mut due = Instant::now();
        while !stop.load(Ordering::Relaxed) {
            let cycle = match cycles.recv_timeout(POLL_PERIOD) {
                Ok(cycle) => cycle,
                Err(RecvError::Timeout) => continue,
                Err(RecvError::Closed) => return,
            };
            let now = Instant::now();
            if now < due {
                continue;
            }
            due = now + self.period;
            let message = lock(link).encode_message(&cycle, clock());
            // Without a network the message is lost; the next one is newer.
            let _ = self.socket.send_to(&message, self.group);
        }
    }
}

// Counts and clocks are valid even if a thread panicked with the lock.
fn lock(link: &Mutex<TeamLink>) -> MutexGuard<'_, TeamLink> {
    link.lock().unwrap_or_else(PoisonError::into_inner)
}
