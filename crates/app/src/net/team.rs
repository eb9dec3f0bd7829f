//! How are team messages sent and received? A multicast socket, a receiving thread, and a thread that sends the newest
//! cycle at the team's rate.

use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use hw::StampedSocket;
use localize::Stamp;
use localize::team::TeamReport;
use socket2::{Domain, Protocol, Socket, Type};

use super::lock::lock;
use super::polling::POLL_PERIOD;
use super::rejection_notices::{self, RejectionNotices};
use super::send_schedule::SendSchedule;
use pipeline::datagram::authentication::RejectReason;
use pipeline::datagram::{TeamClock, TeamLink, TeamLinkConfig, TeamLinkCounts};
use pipeline::feed::{Feed, RecvError, Subscription};

/// Capacity of the queue of reports for the pipeline: a second of five team-mates.
const MAX_PENDING_REPORTS: usize = 64;
/// A message has some hundred bytes; a longer datagram is cut and then rejected.
const MAX_DATAGRAM_BYTES: usize = 4096;
/// Time between attempts to join the group.
const MEMBERSHIP_PERIOD: Duration = Duration::from_secs(1);

/// Sends and receives team messages. Dropping it ends the threads.
pub(crate) struct TeamTransport {
    reports: Receiver<TeamReport>,
    link: Arc<Mutex<TeamLink>>,
    notices: Arc<Mutex<Vec<String>>>,
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
        let receiver =
            open_multicast_socket(group).with_context(|| format!("[team] cannot open {group}"))?;
        let mut membership = Membership {
            socket: receiver.try_clone()?,
            group,
            interface: config.interface,
            is_member: true,
            renewed: None,
        };
        let notices = Arc::new(Mutex::new(Vec::new()));
        lock(&notices).extend(membership.renew());
        let sender = TeamSender {
            socket: receiver.try_clone()?.into(),
            group,
            rate: config.rate,
        };
        let stop_requested = Arc::new(AtomicBool::new(false));
        let (queue, reports) = sync_channel(MAX_PENDING_REPORTS);
        let mut transport = TeamTransport {
            reports,
            link: link.clone(),
            notices: notices.clone(),
            stop_requested: stop_requested.clone(),
            threads: Vec::new(),
        };
        let mut receiver = StampedSocket::new(receiver.into())?;
        let (receiving, stop, time) = (link.clone(), stop_requested.clone(), clock.clone());
        transport.spawn("team receive", move || {
            let mut rejections = RejectionNotices::new();
            while !stop.load(Ordering::Relaxed) {
                lock(&notices).extend(membership.renew());
                let notice = receive(&mut receiver, &receiving, &queue, &time, &mut rejections);
                lock(&notices).extend(notice);
            }
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

    /// Messages for the operator since the last call.
    pub(crate) fn take_notices(&self) -> Vec<String> {
        std::mem::take(&mut *lock(&self.notices))
    }

    /// The next report; None after the timeout.
    #[cfg(test)]
    pub(crate) fn wait_for_report(&self, timeout: Duration) -> Option<TeamReport> {
        self.reports.recv_timeout(timeout).ok()
    }

    /// Numbers of accepted messages and rejected datagrams.
    pub(crate) fn counts(&self) -> TeamLinkCounts {
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

fn open_multicast_socket(group: SocketAddrV4) -> Result<Socket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    // Several robots on one machine (a simulation) receive from the same group.
    socket.set_reuse_address(true)?;
    socket.bind(&SocketAddrV4::new(*group.ip(), group.port()).into())?;
    socket.set_multicast_loop_v4(true)?;
    socket.set_multicast_ttl_v4(1)?;
    Ok(socket)
}

/// Membership of the group on a network interface, which may come later, go and come back: a radio that is plugged in again.
struct Membership {
    socket: Socket,
    group: SocketAddrV4,
    interface: Ipv4Addr,
    /// As was told last.
    is_member: bool,
    renewed: Option<Instant>,
}

impl Membership {
    /// Joins, each second anew: an interface that went took its memberships along. A message for the operator if that changed.
    fn renew(&mut self) -> Option<String> {
        if self
            .renewed
            .is_some_and(|then| then.elapsed() < MEMBERSHIP_PERIOD)
        {
            return None;
        }
        self.renewed = Some(Instant::now());
        let joined = match self
            .socket
            .join_multicast_v4(self.group.ip(), &self.interface)
        {
            Ok(()) => self.socket.set_multicast_if_v4(&self.interface),
            // It still is a member.
            Err(error) if error.kind() == ErrorKind::AddrInUse => Ok(()),
            Err(error) => Err(error),
        };
        let (group, interface) = (self.group, self.interface);
        let was_member = std::mem::replace(&mut self.is_member, joined.is_ok());
        match joined {
            Ok(()) if !was_member => Some(format!("[team] joined {group} on {interface}")),
            Err(error) if was_member => Some(format!(
                "[team] cannot join {group} on {interface}: {error}. Team-mates are not heard until the interface is there"
            )),
            _ => None,
        }
    }
}

/// Receives one message, if one comes soon. A message for the operator if it is the first of its sender that is rejected.
fn receive(
    socket: &mut StampedSocket,
    link: &Mutex<TeamLink>,
    reports: &SyncSender<TeamReport>,
    clock: &impl Fn() -> Stamp,
    rejections: &mut RejectionNotices<RejectReason>,
) -> Option<String> {
    let mut datagram = [0; MAX_DATAGRAM_BYTES];
    let received = socket.receive(&mut datagram, POLL_PERIOD)?;
    let age = hw::now() - received.arrival;
    let report = lock(link).receive(&datagram[..received.length], clock() + -age);
    match report {
        Ok(report) => {
            // If the pipeline does not take reports, new ones are dropped.
            let _ = reports.try_send(report);
            None
        }
        // A radio repeats and reorders messages, and multicast returns our own.
        Err(RejectReason::Own | RejectReason::Old) => None,
        Err(reason) => {
            let is_due = rejections.is_due(received.source, reason, received.arrival);
            let name = rejection_notices::name(received.source);
            is_due.then(|| format!("[team] a message of {name} is rejected: {reason}"))
        }
    }
}

/// Socket, address and rate of the messages sent.
struct TeamSender {
    socket: UdpSocket,
    group: SocketAddrV4,
    /// Messages per second.
    rate: f64,
}

impl TeamSender {
    fn run(
        &self,
        cycles: &Subscription,
        link: &Mutex<TeamLink>,
        stop: &AtomicBool,
        clock: impl Fn() -> Stamp,
    ) {
        let started = Instant::now();
        let mut schedule = SendSchedule::new(self.rate);
        while !stop.load(Ordering::Relaxed) {
            let cycle = match cycles.recv_timeout(POLL_PERIOD) {
                Ok(cycle) => cycle,
                Err(RecvError::Timeout) => continue,
                Err(RecvError::Closed) => return,
            };
            if !schedule.is_due(started.elapsed().as_secs_f64()) {
                continue;
            }
            let message = lock(link).encode_message(&cycle, clock());
            // Without a network the message is lost; the next one is newer.
            let _ = self.socket.send_to(&message, self.group);
        }
    }
}
