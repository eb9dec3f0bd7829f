//! Claims about multicast: team-mates exchange reports. In a network namespace of the test's own, so that no message
//! leaves it and none of another test comes in.

use std::io::{Error, Result};
use std::net::UdpSocket;
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::time::{Duration, Instant};

use localize::Stamp;
use pipeline::datagram::authentication::RejectReason;
use pipeline::feed::Feed;

use super::tests::{link, localized_cycle};
use super::{TeamLinkConfig, TeamTransport};

const TIMEOUT: Duration = Duration::from_secs(60);

/// Moves this thread, and all threads that it starts from now on, into a new network namespace with nothing but a
/// loopback. Needs root.
#[expect(
    unsafe_code,
    reason = "neither call has a safe API in the standard library"
)]
fn enter_own_network() -> Result<()> {
    // SAFETY: the call takes no pointer, and this thread has no socket yet.
    if unsafe { libc::unshare(libc::CLONE_NEWNET) } != 0 {
        return Err(Error::last_os_error());
    }
    let any_socket = UdpSocket::bind("0.0.0.0:0")?;
    // SAFETY: all-zero bytes are a valid ifreq.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    for (letter, name) in b"lo".iter().zip(&mut request.ifr_name) {
        *name = *letter as libc::c_char;
    }
    request.ifr_ifru.ifru_flags = (libc::IFF_UP | libc::IFF_MULTICAST) as libc::c_short;
    // SAFETY: the request is a valid ifreq that outlives the call, and the socket is open.
    let result = unsafe {
        libc::ioctl(
            any_socket.as_raw_fd(),
            libc::SIOCSIFFLAGS,
            &raw const request,
        )
    };
    if result == 0 {
        Ok(())
    } else {
        Err(Error::last_os_error())
    }
}

#[test]
fn teammates_exchange_reports_over_udp_multicast() {
    if let Err(error) = enter_own_network() {
        assert!(
            std::env::var_os("MIRRORBALL_REQUIRE_TOOLS").is_none(),
            "no network namespace: {error}"
        );
        stderr_line!("skipped: no network namespace: {error} (expected root)");
        return;
    }
    let started = Instant::now();
    let clock = move || Stamp(started.elapsed().as_nanos() as i64);
    let config = |robot| TeamLinkConfig {
        group: "239.255.77.77:7072".to_owned(),
        rate: 200.0,
        ..link(robot)
    };
    let feeds = [Feed::new(), Feed::new()];
    let join =
        |i: usize| TeamTransport::join(&feeds[i], &config(i as u32 + 1), 1, clock).expect("joined");
    let links = [join(0), join(1)];
    let own_is_refused = || links[0].counts().refused.get(&RejectReason::Own) > Some(&0);
    let mut received = [false; 2];
    while (received != [true; 2] || !own_is_refused()) && started.elapsed() < TIMEOUT {
        for (feed, x) in feeds.iter().zip([0.0, 1.0]) {
            feed.publish(&Arc::new(localized_cycle(clock(), x, 0.0)));
        }
        for ((link, received), peer) in links.iter().zip(&mut received).zip([2, 1]) {
            let report = link.wait_for_report(Duration::from_millis(5));
            *received |= report.is_some_and(|report| report.robot == peer);
        }
    }
    assert_eq!(received, [true; 2]);
    assert!(own_is_refused());
    // Robots that were configured wrongly are named, each once.
    let wrong = [
        (
            TeamLinkConfig {
                key: Some("another phrase".to_owned()),
                ..config(3)
            },
            "not under our key",
        ),
        (
            TeamLinkConfig {
                team: 2,
                ..config(4)
            },
            "of another team",
        ),
        (config(1), "another robot sends under this robot's number"),
    ];
    for (config, reason) in wrong {
        let feed = Feed::new();
        let _other = TeamTransport::join(&feed, &config, 2, clock).expect("joined");
        let mut notices = Vec::new();
        let mut sent = 0;
        // Some more after the first notice.
        while (notices.is_empty() || sent < 50) && started.elapsed() < TIMEOUT {
            feed.publish(&Arc::new(localized_cycle(clock(), 0.0, 0.0)));
            std::thread::sleep(Duration::from_millis(5));
            sent += 1;
            notices.extend(links[0].take_notices());
        }
        assert_eq!(notices.len(), 1, "{notices:?}");
        assert!(notices[0].contains(reason), "{notices:?}");
        assert!(notices[0].contains("127.0.0.1:7072"), "{notices:?}");
    }
}
