//! How do words get on and off the network? A multicast socket, a thread that hears, and one that tells of the newest
//! cycle at the team's rate.

use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use localize::Stamp;
use localize::team::TeamReport;
use socket2::{Domain, Protocol, Socket, Type};

use pipeline::datagram::{TeamLink, TeamLinkConfig, TeamLinkCounts};
use pipeline::feed::{Feed, RecvError, Subscription};

/// The threads look this often whether they are to end.
const POLL_PERIOD: Duration = Duration::from_millis(50);
/// Reports that may wait for the spine: a second of five team-mates.
const MAX_PENDING_REPORTS: usize = 64;
/// A word has some hundred bytes; a longer datagram is cut and so refused.
const MAX_DATAGRAM_BYTES: usize = 4096;

/// Our place in the team's talk; dropping it ends it.
pub struct TeamTransport {
    reports: Receiver<TeamReport>,
    link: Arc<Mutex<TeamLink>>,
    stop_requested: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl TeamTransport {
    /// Joins the group; tells the cycles of `feed`, hears the others.
    ///
    /// `clock`: the time that stamps samples and cycles, now. `session`: larger for each start.
    pub fn join(
        feed: &Feed,
        config: &TeamLinkConfig,
        session: u64,
        clock: impl Fn() -> Stamp + Clone + Send + 'static,
    ) -> Result<Self> {
        let group = config.address()?;
        let talk = Arc::new(Mutex::new(TeamLink::new(config, session)?));
        let hearing = open_multicast_socket(group, config.interface)
            .with_context(|| format!("[team] cannot join {group} on {}", config.interface))?;
        hearing.set_read_timeout(Some(POLL_PERIOD))?;
        let telling = hearing.try_clone()?;
        let ending = Arc::new(AtomicBool::new(false));
        let (sender, reports) = sync_channel(MAX_PENDING_REPORTS);
        let mut link = TeamTransport {
            reports,
            link: talk.clone(),
            stop_requested: ending.clone(),
            threads: Vec::new(),
        };
        let (heard, stop, time) = (talk.clone(), ending.clone(), clock.clone());
        link.spawn("team hears", move || {
            receive_loop(&hearing, &heard, &sender, &stop, time);
        })?;
        let cycles = feed.subscribe(1);
        let period = Duration::from_secs_f64(1.0 / config.rate);
        link.spawn("team tells", move || {
            send_loop(&cycles, &talk, (&telling, group), period, &ending, clock);
        })?;
        Ok(link)
    }

    fn spawn(&mut self, name: &str, run: impl FnOnce() + Send + 'static) -> Result<()> {
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(run)?;
        self.threads.push(thread);
        Ok(())
    }

    /// What team-mates said since the last call; give it to the spine as samples.
    pub fn received_reports(&self) -> impl Iterator<Item = TeamReport> {
        self.reports.try_iter()
    }

    /// Words taken and datagrams refused.
    pub fn counts(&self) -> TeamLinkCounts {
        lock(&self.link).counts().clone()
    }
}

impl Drop for TeamTransport {
    fn drop(&mut self) {
        self.stop_requested.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // Its panic was told when it happened.
            let _ = thread.join();
        }
    }
}

fn open_multicast_socket(group: SocketAddrV4, interface: Ipv4Addr) -> Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    // Several robots of one machine (a simulation) hear the same group.
    socket.set_reuse_address(true)?;
    socket.bind(&SocketAddrV4::new(*group.ip(), group.port()).into())?;
    socket.join_multicast_v4(group.ip(), &interface)?;
    socket.set_multicast_if_v4(&interface)?;
    socket.set_multicast_loop_v4(true)?;
    socket.set_multicast_ttl_v4(1)?;
    Ok(socket.into())
}

fn receive_loop(
    socket: &UdpSocket,
    talk: &Mutex<TeamLink>,
    reports: &SyncSender<TeamReport>,
    ending: &AtomicBool,
    clock: impl Fn() -> Stamp,
) {
    let mut datagram = [0; MAX_DATAGRAM_BYTES];
    while !ending.load(Ordering::Relaxed) {
        // A timeout, or a network that is away for a while: neither ends listening.
        let Ok(length) = socket.recv(&mut datagram) else {
            continue;
        };
        let report = lock(talk).receive(&datagram[..length], clock());
        if let Ok(report) = report {
            // A spine that stands still has no use for what is said meanwhile.
            let _ = reports.try_send(report);
        }
    }
}

fn send_loop(
    cycles: &Subscription,
    talk: &Mutex<TeamLink>,
    (socket, group): (&UdpSocket, SocketAddrV4),
    period: Duration,
    ending: &AtomicBool,
    clock: impl Fn() -> Stamp,
) {
    let mut due = Instant::now();
    while !ending.load(Ordering::Relaxed) {
        let cycle = match cycles.recv_timeout(POLL_PERIOD) {
            Ok(cycle) => cycle,
            Err(RecvError::Timeout) => continue,
            Err(RecvError::Closed) => return,
        };
        let now = Instant::now();
        if now < due {
            continue;
        }
        due = now + period;
        let word = lock(talk).encode_message(&cycle, clock());
        // No network for a while: the next word is a new one.
        let _ = socket.send_to(&word, group);
    }
}

// A panic of the other side leaves counts and clocks that are still true.
fn lock(talk: &Mutex<TeamLink>) -> MutexGuard<'_, TeamLink> {
    talk.lock().unwrap_or_else(PoisonError::into_inner)
}
