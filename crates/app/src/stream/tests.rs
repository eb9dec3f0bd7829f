//! Claims about the live stream: what a viewer gets, and what a misbehaving one costs.

use std::io::Write;
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{StreamClient, StreamConfig, StreamEvent, StreamPreamble, StreamServer};
use crate::run::tuning::{Tuning, seal};
use pipeline::cycle::{Cycle, Inputs};
use pipeline::feed::Feed;
use pipeline::log::{Header, ImageCompression};
use pipeline::testing::{field, random_cycle, random_image};

const TIMEOUT: Duration = Duration::from_secs(60);

fn server(feed: &Feed) -> StreamServer {
    let config = StreamConfig {
        port: 0,
        images: ImageCompression::Png,
        ..StreamConfig::default()
    };
    let header = Header::new("test", Some(7)).with_file("robot.toml", "field = \"field.toml\"");
    let preamble = StreamPreamble {
        header: &header,
        field: &field(),
    };
    StreamServer::start(feed, preamble, None, &config).expect("a server")
}

fn client(server: &StreamServer) -> StreamClient {
    StreamClient::connect(&format!("ws://127.0.0.1:{}", server.port()), TIMEOUT).expect("a client")
}

/// The client's next event.
fn next(client: &mut StreamClient) -> StreamEvent {
    client
        .next_event(TIMEOUT)
        .expect("connected")
        .expect("an event")
}

#[test]
fn client_receives_the_header_then_cycles_bit_for_bit() {
    let feed = Feed::new();
    let server = server(&feed);
    let mut client = client(&server);
    let StreamEvent::Header(header) = next(&mut client) else {
        panic!("a cycle before the header");
    };
    assert_eq!((header.seed, header.source.as_str()), (Some(7), "test"));
    assert!(header.files.contains_key("robot.toml"));
    for number in 0..5 {
        feed.publish(&Arc::new(random_cycle(number)));
        let logged = loop {
            // The header may come again: it is sent after each of the client's subscriptions.
            if let StreamEvent::Cycle(logged) = next(&mut client) {
                break logged;
            }
        };
        let expected = random_cycle(number);
        let image = logged.image.as_ref().expect("an image").decode();
        assert_eq!(image.expect("whole"), random_image(number));
        let without_image = Cycle {
            inputs: Inputs {
                image: None,
                ..expected.inputs
            },
            ..expected
        };
        assert_eq!(format!("{without_image:?}"), format!("{:?}", logged.cycle));
        assert_eq!(logged.index, number);
    }
}

#[test]
fn misbehaving_clients_do_not_block_the_feed() {
    let feed = Feed::new();
    let server = server(&feed);
    let address = ("127.0.0.1", server.port());
    let mut malformed = TcpStream::connect(address).expect("connected");
    malformed.write_all(&[0xff; 4096]).expect("written");
    let mut vanishing = client(&server);
    next(&mut vanishing);
    drop(vanishing);
    let mut stalled = client(&server);
    next(&mut stalled);
    // 20 MB of images, far beyond the system's buffers: the feed must not wait for the stalled client.
    let cycle = Arc::new(random_cycle(0));
    let started = Instant::now();
    for _ in 0..1000 {
        feed.publish(&cycle);
    }
    assert!(started.elapsed() < TIMEOUT);
    let mut late = client(&server);
    let received = std::iter::from_fn(|| {
        feed.publish(&cycle);
        Some(next(&mut late))
    })
    .take(50)
    .any(|event| matches!(event, StreamEvent::Cycle(_)));
    assert!(received, "a client that connects later gets cycles");
}

#[test]
fn client_changes_settings_under_the_key() {
    let key = "a phrase of the team";
    let robot =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence/robot.toml");
    let setup = pipeline::setup::Setup::load(&robot, None).expect("a setup");
    let config = pipeline::PipelineConfig::default();
    let tuning = Tuning::start(setup, &config, Some(key)).expect("started");
    let header = Header::new("test", Some(7));
    let preamble = StreamPreamble {
        header: &header,
        field: &field(),
    };
    let stream = StreamConfig {
        port: 0,
        ..StreamConfig::default()
    };
    // The stream ends with its feed.
    let feed = Feed::new();
    let server = StreamServer::start(&feed, preamble, Some(tuning.desk()), &stream);
    let server = server.expect("a server");
    let mut client = client(&server);
    let texts = |client: &mut StreamClient| loop {
        if let StreamEvent::Settings(texts) = next(client) {
            break texts;
        }
    };
    client.request_settings().expect("sent");
    let nonce = texts(&mut client).remove(super::NONCE).expect("a nonce");
    let overlay = "by = \"operator\"\nvision.scan.range_max = 7.0\n";
    client.change_settings(overlay, None).expect("sent");
    while !texts(&mut client)
        .get(super::MESSAGE)
        .is_some_and(|text| text.contains("no seal"))
    {}
    let seal = seal(key, &nonce, overlay).expect("sealed");
    client.change_settings(overlay, Some(&seal)).expect("sent");
    let started = Instant::now();
    let prepared = loop {
        if let Some(prepared) = tuning.take_prepared() {
            break prepared;
        }
        assert!(started.elapsed() < TIMEOUT, "no pipeline");
        std::thread::sleep(Duration::from_millis(5));
    };
    let changes = "vision.scan.range_max 9 → 7 (by operator)";
    assert_eq!(prepared.changes, changes);
    assert!(prepared.settings.contains("range_max = 7.0"));
    while !texts(&mut client)
        .get(super::MESSAGE)
        .is_some_and(|text| text.starts_with("changed"))
    {}
    client.request_settings().expect("sent");
    let history = texts(&mut client).remove(super::HISTORY);
    assert!(
        history
            .as_ref()
            .is_some_and(|lines| lines.ends_with(changes)),
        "{history:?}"
    );
}

#[test]
fn the_end_of_the_run_ends_the_stream() {
    let feed = Feed::new();
    let server = server(&feed);
    let mut client = client(&server);
    next(&mut client);
    drop(server);
    let ended = (0..3000).any(|_| client.next_event(Duration::from_millis(20)).is_err());
    assert!(ended);
    let error = StreamClient::connect("127.0.0.1:1", TIMEOUT)
        .err()
        .expect("an error");
    assert!(format!("{error:#}").contains("127.0.0.1:1"));
}
