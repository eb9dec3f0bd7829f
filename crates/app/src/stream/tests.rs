//! Claims about the live stream: what a viewer gets, and what a bad one costs.

use std::io::Write;
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{StreamClient, StreamConfig, StreamEvent, StreamServer};
use pipeline::feed::Feed;
use pipeline::log::{Header, ImageCompression};
use pipeline::testing::{field, random_cycle, random_image};
use pipeline::{Cycle, Inputs};

const PATIENCE: Duration = Duration::from_secs(20);

fn server(feed: &Feed) -> StreamServer {
    let config = StreamConfig {
        port: 0,
        images: ImageCompression::Png,
        ..StreamConfig::default()
    };
    let header = Header::new("test", Some(7)).with_file("robot.toml", "field = \"field.toml\"");
    StreamServer::start(feed, &header, &field(), &config).expect("a server")
}

fn client(server: &StreamServer) -> StreamClient {
    StreamClient::connect(&format!("ws://127.0.0.1:{}", server.port()), PATIENCE).expect("a client")
}

/// The client's next event; the server goes on publishing what is `due` meanwhile.
fn next(client: &mut StreamClient) -> StreamEvent {
    client
        .next_event(PATIENCE)
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
            // The header may come once more: it is told after each of the client's subscriptions.
            if let StreamEvent::Cycle(logged) = next(&mut client) {
                break logged;
            }
        };
        let wanted = random_cycle(number);
        let image = logged.image.as_ref().expect("an image").decode();
        assert_eq!(image.expect("whole"), random_image(number));
        let bare = Cycle {
            inputs: Inputs {
                image: None,
                ..wanted.inputs
            },
            ..wanted
        };
        assert_eq!(format!("{bare:?}"), format!("{:?}", logged.cycle));
        assert_eq!(logged.index, number);
    }
}

#[test]
fn misbehaving_clients_do_not_block_the_feed() {
    let feed = Feed::new();
    let server = server(&feed);
    let place = ("127.0.0.1", server.port());
    let mut babbler = TcpStream::connect(place).expect("connected");
    babbler.write_all(&[0xff; 4096]).expect("written");
    let mut vanishing = client(&server);
    next(&mut vanishing);
    drop(vanishing);
    let mut stalled = client(&server);
    next(&mut stalled);
    // 20 MB of images, far beyond what the system buffers: nothing of it may wait for the one who does not read.
    let cycle = Arc::new(random_cycle(0));
    let started = Instant::now();
    for _ in 0..1000 {
        feed.publish(&cycle);
    }
    assert!(started.elapsed() < PATIENCE);
    let mut late = client(&server);
    let got = std::iter::from_fn(|| {
        feed.publish(&cycle);
        Some(next(&mut late))
    })
    .take(50)
    .any(|event| matches!(event, StreamEvent::Cycle(_)));
    assert!(got, "who comes late and reads is served");
}

#[test]
fn the_end_of_the_run_ends_the_stream() {
    let feed = Feed::new();
    let server = server(&feed);
    let mut client = client(&server);
    next(&mut client);
    drop(server);
    let ended = (0..1000).any(|_| client.next_event(Duration::from_millis(20)).is_err());
    assert!(ended);
    let nobody = StreamClient::connect("127.0.0.1:1", PATIENCE)
        .err()
        .expect("an error");
    assert!(format!("{nobody:#}").contains("127.0.0.1:1"));
}
