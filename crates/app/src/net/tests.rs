//! Claims about the network: the messages, and the rejection of malformed or unauthenticated datagrams.

use std::collections::{BTreeMap, BTreeSet};
use std::net::UdpSocket;
use std::sync::Arc;
use std::time::Duration;

use foxglove::Encode;
use foxglove::prost_types::FileDescriptorSet;
use localize::Stamp;
use localize::frames::{At, Pose};
use localize::world::FieldState;
use nalgebra::Matrix4;
use proptest::prelude::*;
use prost::Message;

use super::commands::{CommandCounts, CommandFilter};
use super::{
    CommandConfig, CommandListener, NetworkConfig, OutputConfig, RemoteCommand, RobotIdentity,
    StateSender, TeamLinkConfig,
};
use pipeline::Cycle;
use pipeline::datagram::TeamLink;
use pipeline::datagram::authentication::{MAC_BYTES, MacKey, RejectReason, append_mac};
use pipeline::datagram::message::{
    AirborneBall, BallRay, Command, Drive, Echo, Health, Kick, ObjectReport, ObjectState, State,
    TeamMessage, VERSION,
};
use pipeline::feed::Feed;
use pipeline::testing::random_cycle;

const TIMEOUT: Duration = Duration::from_secs(60);
const IDENTITY: RobotIdentity = RobotIdentity { robot: 4, boot: 77 };
const SHARED_KEY: &str = "a shared phrase";

/// A cycle of a localized robot that detects a ball.
pub(super) fn localized_cycle(stamp: Stamp, x: f32, y: f32) -> Cycle {
    let mut cycle = random_cycle(2);
    cycle.stamp = stamp;
    cycle.estimate.pose = Some(Pose::new(1.0, 2.0, 0.5));
    cycle.estimate.covariance = nalgebra::Matrix3::from_diagonal_element(1e-3);
    let ball = cycle.world.ball.as_mut().expect("a ball");
    ball.last_seen = stamp;
    ball.on_field = Some(FieldState {
        at: At::new(x, y),
        velocity: [0.5, 0.0],
        covariance: Matrix4::from_diagonal_element(0.01),
    });
    for robot in &mut cycle.world.robots {
        robot.on_field = Some(FieldState {
            at: At::new(0.0, 1.0),
            velocity: [0.0; 2],
            covariance: Matrix4::from_diagonal_element(0.01),
        });
    }
    cycle
}

pub(super) fn link(robot: u32) -> TeamLinkConfig {
    TeamLinkConfig {
        robot,
        key: Some(SHARED_KEY.to_owned()),
        ..TeamLinkConfig::default()
    }
}

fn team_link(robot: u32) -> TeamLink {
    TeamLink::new(&link(robot), 1).expect("a link")
}

fn command(sequence: u64) -> Command {
    Command {
        version: VERSION,
        session: 5,
        sequence,
        valid_ms: 80.0,
        drive: Some(Drive {
            x: 0.5,
            y: -0.25,
            theta: 1.0,
        }),
        kick: None,
        needs_pose: false,
        boot: IDENTITY.boot,
        robot: IDENTITY.robot,
        state_ns: 0,
    }
}

#[test]
fn network_proto_matches_the_rust_messages() {
    let document = include_str!("../../../../docs/network.proto");
    let mut documented = BTreeSet::new();
    let mut message = "";
    for line in document
        .lines()
        .map(|line| line.split("//").next().unwrap_or("").trim())
    {
        if let Some(name) = line.strip_prefix("message ") {
            message = name.trim_end_matches([' ', '{']);
        } else if let Some((field, number)) = line.trim_end_matches(';').split_once(" = ")
            && !line.starts_with("syntax")
        {
            documented.insert(format!("{message} {field} {number}"));
        }
    }
    let mut ours = BTreeSet::new();
    let mut add = |schema: Option<foxglove::Schema>| {
        let data = schema.expect("a schema").data;
        for file in FileDescriptorSet::decode(&data[..]).expect("decoded").file {
            for message in file.message_type {
                for field in &message.field {
                    let kind = match field.type_name() {
                        "" => format!("{:?}", field.r#type()).to_lowercase(),
                        name => name.rsplit('.').next().unwrap_or(name).to_owned(),
                    };
                    let repeated = field.label()
                        == foxglove::prost_types::field_descriptor_proto::Label::Repeated;
                    let repeated = if repeated { "repeated " } else { "" };
                    let (name, number) = (field.name(), field.number());
                    ours.insert(format!(
                        "{} {repeated}{kind} {name} {number}",
                        message.name()
                    ));
                }
            }
        }
    };
    for schema in [
        State::get_schema(),
        pipeline::datagram::message::Pose::get_schema(),
        ObjectState::get_schema(),
        ObjectReport::get_schema(),
        Health::get_schema(),
        Command::get_schema(),
        Drive::get_schema(),
        Kick::get_schema(),
        TeamMessage::get_schema(),
        Echo::get_schema(),
        AirborneBall::get_schema(),
        BallRay::get_schema(),
    ] {
        add(schema);
    }
    // The derived schema has one kind of signed integer and does not mark optional fields; prost writes the declared ones.
    let plain = |names: BTreeSet<String>| -> BTreeSet<String> {
        names
            .into_iter()
            .map(|name| {
                name.replace(" sint64 ", " int64 ")
                    .replace(" optional ", " ")
            })
            .collect()
    };
    assert_eq!(plain(ours), plain(documented));
}

#[test]
fn state_is_sent_as_json_and_protobuf() {
    let feed = Feed::new();
    let receivers: Vec<UdpSocket> = (0..2)
        .map(|_| UdpSocket::bind("127.0.0.1:0").expect("a socket"))
        .collect();
    let configs = ["json", "protobuf"]
        .iter()
        .zip(&receivers)
        .map(|(format, socket)| {
            socket.set_read_timeout(Some(TIMEOUT)).expect("set");
            let to = socket.local_addr().expect("an address");
            let text = format!("to = \"{to}\"\nformat = \"{format}\"\nrobot = 4\n");
            toml::from_str::<OutputConfig>(&text).expect("a configuration")
        });
    let _sender = StateSender::start(&feed, &configs.collect::<Vec<_>>(), None).expect("a sender");
    let cycle = localized_cycle(Stamp(7), 3.0, 1.0);
    feed.publish(&Arc::new(cycle.clone()));
    let mut datagram = [0; 65_536];
    let states = receivers.iter().enumerate().map(|(i, socket)| {
        let length = socket.recv(&mut datagram).expect("a datagram");
        let content = &datagram[..length];
        if i == 0 {
            serde_json::from_slice(content).expect("JSON")
        } else {
            State::decode(content).expect("protobuf")
        }
    });
    for state in states.collect::<Vec<State>>() {
        assert_eq!((state.version, state.robot, state.stamp_ns), (1, 4, 7));
        let ball = state.ball.expect("a ball");
        assert_eq!(ball.on_field.expect("placed").x, 3.0);
        assert_eq!(state.robots.len(), cycle.world.robots.len());
        assert_eq!(state.pose.expect("a pose").y, 2.0);
    }
}

#[test]
fn command_is_delivered_once_and_its_validity_is_capped() {
    // Far longer than a loaded machine delays a thread: a command that expires before it is read is late.
    let config = CommandConfig {
        bind: "127.0.0.1:0".to_owned(),
        valid_max_ms: 60_000.0,
        ..CommandConfig::default()
    };
    assert_eq!(CommandConfig::default().valid_max_ms, 100.0);
    let (sender, received) = std::sync::mpsc::sync_channel(8);
    let execute = move |command: RemoteCommand| {
        let kicks = command.kick.is_some();
        sender.send(command).expect("received");
        kicks
    };
    let commands = CommandListener::listen(&config, IDENTITY, execute).expect("listening");
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    let send = |content: &[u8]| socket.send_to(content, commands.address()).expect("sent");
    let long = Command {
        valid_ms: 1e9,
        needs_pose: true,
        kick: Some(Kick {
            speed: 3.0,
            lofted: true,
        }),
        ..command(1)
    };
    send(&serde_json::to_vec(&long).expect("JSON"));
    send(b"not a command");
    send(&long.encode_to_vec());
    let next = Command {
        valid_ms: 50_000.0,
        ..command(2)
    };
    send(&next.encode_to_vec());
    let first = received.recv_timeout(TIMEOUT).expect("a command");
    assert_eq!(first.valid_for, Duration::from_secs(60));
    assert_eq!(
        first.drive.map(|drive| (drive.x, drive.theta)),
        Some((0.5, 1.0))
    );
    assert!(first.needs_pose && first.kick.is_some_and(|kick| kick.lofted));
    let second = received.recv_timeout(TIMEOUT).expect("a command");
    assert_eq!(second.valid_for, Duration::from_secs(50));
    assert!(!second.needs_pose && second.kick.is_none());
    let counts = CommandCounts {
        accepted: 1,
        sent: 0,
        obeyed: 0,
        overruled: 1,
        refused: BTreeMap::from([(RejectReason::Foreign, 1), (RejectReason::Old, 1)]),
    };
    assert_eq!(commands.finish(), counts);
}

#[test]
fn second_sender_with_the_session_of_the_first_does_not_drive_and_is_named() {
    let config = CommandConfig {
        bind: "127.0.0.1:0".to_owned(),
        silence: 1e4,
        ..CommandConfig::default()
    };
    let (executed, received) = std::sync::mpsc::sync_channel(16);
    let execute = move |command: RemoteCommand| executed.send(command).is_ok();
    let commands = CommandListener::listen(&config, IDENTITY, execute).expect("listening");
    let [first, second] = [0, 1].map(|_| UdpSocket::bind("127.0.0.1:0").expect("a socket"));
    let send = |socket: &UdpSocket, sequence, x| {
        let drive = Some(Drive {
            x,
            y: 0.0,
            theta: 0.0,
        });
        let command = Command {
            valid_ms: 100.0,
            drive,
            ..command(sequence)
        };
        let sent = socket.send_to(&command.encode_to_vec(), commands.address());
        sent.expect("sent");
    };
    for turn in 0..10 {
        send(&first, 2 * turn, 0.5);
        let driven = received.recv_timeout(TIMEOUT).expect("a command").drive;
        assert_eq!(driven.map(|drive| drive.x), Some(0.5), "{turn}");
        send(&second, 2 * turn + 1, -0.5);
    }
    let fault = commands.shared();
    send(&first, 100, 0.5);
    received.recv_timeout(TIMEOUT).expect("a command");
    send(&second, 101, -0.5);
    let start = std::time::Instant::now();
    while fault.fault().is_empty() && start.elapsed() < TIMEOUT {
        std::thread::yield_now();
    }
    let [first, second] = [first, second].map(|socket| socket.local_addr().expect("an address"));
    assert!(fault.fault().ends_with(&format!("It is {first}")));
    let notices = commands.take_notices();
    assert!(
        notices.len() == 1
            && notices[0].starts_with(&format!("a remote command of {second} is rejected"))
            && notices[0].contains("the same session"),
        "{notices:?}"
    );
    let counts = commands.finish();
    assert_eq!(counts.refused, BTreeMap::from([(RejectReason::Shared, 11)]));
    assert_eq!(counts.accepted, 11);
}

#[test]
fn empty_datagram_is_no_message() {
    let mut filter = CommandFilter::new(&CommandConfig::default(), IDENTITY).expect("a filter");
    let refused = filter.accept(&[], None, Stamp(0)).map(|_| ());
    assert_eq!(refused, Err(RejectReason::Foreign));
}

#[test]
fn json_of_protobuf_libraries_is_a_command_and_one_without_a_version_is_named() {
    let mut filter = CommandFilter::new(&CommandConfig::default(), IDENTITY).expect("a filter");
    let mut accept = |text: &str| filter.accept(text.as_bytes(), None, Stamp(0)).map(|_| ());
    let session = r#""session": "1790000000000000000", "validMs": 100.0, "drive": {"x": 0.5}"#;
    let first = format!(r#"{{"version": 1, {session}}}"#);
    assert_eq!(accept(&first), Ok(()));
    let later = format!(
        r#"{{"version": 1, {session}, "sequence": "1", "kick": null, "note": "to the left"}}"#
    );
    assert_eq!(accept(&later), Ok(()));
    let unversioned = format!(r#"{{{session}, "sequence": "2"}}"#);
    assert_eq!(accept(&unversioned), Err(RejectReason::Unversioned));
    assert_eq!(accept("{"), Err(RejectReason::Foreign));
    assert_eq!(accept(r#"{"version": 2}"#), Err(RejectReason::Version));
}

#[test]
fn stray_command_of_another_program_interrupts_the_controller_for_the_silence_alone() {
    let mut filter = CommandFilter::new(&CommandConfig::default(), IDENTITY).expect("a filter");
    let mut accept = |session, sequence, milliseconds: i64| {
        let command = Command {
            session,
            ..command(sequence)
        };
        let arrival = Stamp(milliseconds * 1_000_000);
        let accepted = filter.accept(&command.encode_to_vec(), None, arrival);
        accepted.map(|_| ())
    };
    assert_eq!(accept(5, 1, 0), Ok(()));
    assert_eq!(accept(6, 1, 30), Ok(()));
    let accepted = (2..100).map(|k| accept(5, k, k as i64 * 30).is_ok());
    // From 1030 ms on: the silence is a second.
    assert_eq!(accepted.filter(|accepted| *accepted).count(), 65);
}

#[test]
fn remote_commands_require_a_key() {
    let mut config = CommandConfig {
        bind: "0.0.0.0:0".to_owned(),
        ..CommandConfig::default()
    };
    let error = CommandListener::listen(&config, IDENTITY, |_| true)
        .err()
        .expect("rejected");
    assert!(error.to_string().contains("set a key"), "{error:#}");
    config.key = Some("short".to_owned());
    assert!(CommandListener::listen(&config, IDENTITY, |_| true).is_err());
    assert!(toml::from_str::<NetworkConfig>("[comands]\n").is_err());
    let longer = NetworkConfig {
        commands: Some(CommandConfig {
            valid_max_ms: 1000.0,
            ..CommandConfig::default()
        }),
        ..NetworkConfig::default()
    };
    let error = longer.check().expect_err("rejected");
    assert!(error.to_string().contains("at most 100"), "{error:#}");
    let key_without_outputs = NetworkConfig {
        commands: Some(CommandConfig {
            key: Some(SHARED_KEY.to_owned()),
            ..CommandConfig::default()
        }),
        ..NetworkConfig::default()
    };
    let error = key_without_outputs.check().expect_err("rejected");
    assert!(error.to_string().contains("Add [[outputs]]"), "{error:#}");
    let misspelt = NetworkConfig {
        outputs: vec![OutputConfig {
            to: "coach.local".to_owned(),
            ..OutputConfig::default()
        }],
        ..NetworkConfig::default()
    };
    let error = format!("{:#}", misspelt.check().expect_err("rejected"));
    assert!(error.contains("expected host:port"), "{error}");
    let published = NetworkConfig {
        outputs: vec![OutputConfig::default()],
        ..key_without_outputs
    };
    published.check().expect("accepted");
    let document = include_str!("../../../../docs/network.md");
    let example = document
        .split("```toml")
        .nth(1)
        .and_then(|rest| rest.split("```").next());
    let example: NetworkConfig = toml::from_str(example.expect("an example")).expect("read");
    example.check().expect("accepted");
    assert_eq!(example.commands, Some(CommandConfig::default()));
    assert_eq!(example.team, Some(TeamLinkConfig::default()));
    assert_eq!(example.stream, Some(crate::stream::StreamConfig::default()));
}

#[test]
fn speed_over_the_ground_is_bounded_in_every_direction() {
    let config = CommandConfig {
        speed_max: 1.0,
        ..CommandConfig::default()
    };
    let mut filter = CommandFilter::new(&config, IDENTITY).expect("a filter");
    let mut accept = |sequence, [x, y, theta]: [f32; 3]| {
        let command = Command {
            drive: Some(Drive { x, y, theta }),
            ..command(sequence)
        };
        filter
            .accept(&command.encode_to_vec(), None, Stamp(0))
            .map(|_| ())
    };
    assert_eq!(accept(1, [0.6, -0.7, 1.0]), Ok(()));
    for fast in [[0.9, 0.9, 0.0], [-0.8, 0.7, 0.0], [0.0, 0.0, -1.1]] {
        assert_eq!(accept(2, fast), Err(RejectReason::Senseless), "{fast:?}");
    }
}

#[test]
fn command_under_a_key_names_this_start_of_this_robot() {
    let config = CommandConfig {
        key: Some(SHARED_KEY.to_owned()),
        ..CommandConfig::default()
    };
    let key = MacKey::new(SHARED_KEY).expect("a key");
    let mut filter = CommandFilter::new(&config, IDENTITY).expect("a filter");
    let mut accept = |command: Command, milliseconds: i64| {
        let datagram = append_mac(command.encode_to_vec(), Some(&key));
        let accepted = filter.accept(&datagram, None, Stamp(milliseconds * 1_000_000));
        accepted.map(|_| ())
    };
    let unbound = Command {
        boot: 0,
        robot: 0,
        ..command(1)
    };
    assert_eq!(accept(unbound, 0), Err(RejectReason::Unbound));
    let other = Command {
        robot: 5,
        ..command(1)
    };
    assert_eq!(accept(other, 0), Err(RejectReason::Robot));
    let before = Command {
        boot: 76,
        ..command(1)
    };
    assert_eq!(accept(before, 0), Err(RejectReason::Boot));
    // What was rejected has not used up its sequence number.
    assert_eq!(accept(command(1), 0), Ok(()));
    let on_state = |sequence| Command {
        state_ns: 1_000_000,
        ..command(sequence)
    };
    assert_eq!(accept(on_state(2), 400), Ok(()));
    assert_eq!(accept(on_state(3), 502), Err(RejectReason::Late));
    let other_clock = |state_ns| Command {
        state_ns,
        ..command(3)
    };
    let wall_clock = 1_790_000_000_000_000_000;
    assert_eq!(
        accept(other_clock(wall_clock), 400),
        Err(RejectReason::Future)
    );
    assert_eq!(
        accept(other_clock(i64::MAX), 400),
        Err(RejectReason::Future)
    );
    assert_eq!(accept(other_clock(i64::MIN), 400), Err(RejectReason::Late));
    // Without a key, a sender that names neither is accepted, but not one that names another robot.
    let open = CommandConfig::default();
    let mut filter = CommandFilter::new(&open, IDENTITY).expect("a filter");
    let mut accept = |command: Command| {
        filter
            .accept(&command.encode_to_vec(), None, Stamp(0))
            .map(|_| ())
    };
    assert_eq!(
        accept(Command {
            boot: 0,
            robot: 0,
            ..command(1)
        }),
        Ok(())
    );
    let other = Command {
        boot: 0,
        robot: 5,
        ..command(2)
    };
    assert_eq!(accept(other), Err(RejectReason::Robot));
}

#[test]
fn team_on_a_real_interface_requires_a_key() {
    let mut config = TeamLinkConfig {
        interface: std::net::Ipv4Addr::new(192, 168, 1, 20),
        ..TeamLinkConfig::default()
    };
    let error = config.address().expect_err("rejected").to_string();
    assert!(error.contains("set a key"), "{error}");
    config.interface = std::net::Ipv4Addr::UNSPECIFIED;
    assert!(config.address().is_err());
    config.key = Some(SHARED_KEY.to_owned());
    assert!(config.address().is_ok());
}

#[test]
fn team_messages_are_received_with_times_in_our_clock_by_the_team_only() {
    let (mut a, mut b) = (team_link(1), team_link(2));
    let ahead = Stamp::from_seconds(1e6).0;
    let mut last = None;
    // The clock of b is 1e6 s ahead; messages take 4 ms to b and 2 ms to a.
    for k in 0..20_i64 {
        let now = k * 100_000_000;
        let message = a.encode_message(&localized_cycle(Stamp(now), 1.0, 0.0), Stamp(now));
        b.receive(&message, Stamp(now + 4_000_000 + ahead))
            .expect("received by b");
        assert_eq!(
            b.receive(&message, Stamp(now + 5_000_000 + ahead)),
            Err(RejectReason::Old)
        );
        assert_eq!(a.receive(&message, Stamp(now)), Err(RejectReason::Own));
        let sent = now + 50_000_000;
        let message = b.encode_message(
            &localized_cycle(Stamp(sent - 10_000_000 + ahead), 3.0, 1.0),
            Stamp(sent + ahead),
        );
        last = Some((
            a.receive(&message, Stamp(sent + 2_000_000))
                .expect("received by a"),
            sent,
        ));
    }
    let (report, sent) = last.expect("a report");
    let error_ns = report.stamp.0 - (sent - 10_000_000);
    assert!(error_ns.abs() <= 3_000_000, "{error_ns}");
    assert_eq!(report.ball.expect("a ball").at.x, 3.0);
    assert_eq!(report.obstacles.len(), 2);
    assert!(report.half_known);
    let strangers = TeamLinkConfig {
        key: Some("another phrase".to_owned()),
        ..link(3)
    };
    let mut stranger = TeamLink::new(&strangers, 1).expect("a link");
    let message = stranger.encode_message(&localized_cycle(Stamp(0), 0.0, 0.0), Stamp(0));
    assert_eq!(a.receive(&message, Stamp(0)), Err(RejectReason::Unsealed));
    let mut others = TeamLink::new(&TeamLinkConfig { team: 2, ..link(3) }, 1).expect("a link");
    let message = others.encode_message(&localized_cycle(Stamp(0), 0.0, 0.0), Stamp(0));
    assert_eq!(a.receive(&message, Stamp(0)), Err(RejectReason::Team));
}

proptest! {
    #[test]
    fn only_authenticated_fresh_commands_are_accepted(
        cuts in prop::collection::vec((0_usize..60, 0_usize..400, 1_u8..=255), 0..60),
        noise in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let config = CommandConfig {
            key: Some(SHARED_KEY.to_owned()),
            ..CommandConfig::default()
        };
        let mut filter = CommandFilter::new(&config, IDENTITY).expect("a filter");
        let key = MacKey::new(SHARED_KEY).expect("a key");
        prop_assert!(filter.accept(&noise, None, Stamp(0)).is_err());
        let mut newest = None;
        // Commands in any order, repeated, and with a wrong byte.
        for (sequence, place, flip) in cuts {
            let sequence = sequence as u64;
            let whole = append_mac(command(sequence).encode_to_vec(), Some(&key));
            let mut broken = whole.clone();
            if let Some(byte) = broken.get_mut(place) {
                *byte ^= flip;
                prop_assert!(filter.accept(&broken, None, Stamp(0)).is_err());
                prop_assert!(filter.accept(&whole[..place], None, Stamp(0)).is_err());
            }
            let result = filter.accept(&whole, None, Stamp(0));
            let fresh = newest.is_none_or(|newest| sequence > newest);
            prop_assert_eq!(result.is_ok(), fresh);
            newest = newest.max(Some(sequence));
        }
    }

    #[test]
    fn malformed_datagrams_are_rejected_and_each_message_is_accepted_once(
        deliveries in prop::collection::vec((0_u64..30, any::<bool>()), 0..60),
        noise in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..120), 0..20),
    ) {
        let open = TeamLinkConfig { key: None, ..link(1) };
        let mut receiver = TeamLink::new(&open, 1).expect("a link");
        for datagram in &noise {
            // Without a key a message of another sender may be accepted, but not with our own number.
            if let Ok(report) = receiver.receive(datagram, Stamp(0)) {
                prop_assert!(report.robot != 1);
            }
        }
        let mut receiver = team_link(1);
        let mut sender = team_link(2);
        let messages: Vec<_> = (0..30)
            .map(|k| sender.encode_message(&localized_cycle(Stamp(k), 1.0, 1.0), Stamp(k)))
            .collect();
        let mut newest = None;
        for (k, truncated) in deliveries {
            let message = &messages[k as usize];
            if truncated {
                let short = message.len() - 1 - k as usize % (MAC_BYTES + 4);
                prop_assert_eq!(receiver.receive(&message[..short], Stamp(100)), Err(RejectReason::Unsealed));
                continue;
            }
            let result = receiver.receive(message, Stamp(100));
            prop_assert_eq!(result.is_ok(), newest.is_none_or(|newest| k > newest));
            newest = newest.max(Some(k));
        }
    }
}
