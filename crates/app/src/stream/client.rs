//! What does a robot elsewhere see? Its live stream, read back into cycles.
//!
//! ```no_run
//! # fn main() -> anyhow::Result<()> {
//! use app::stream::{Client, Event};
//! use std::time::Duration;
//!
//! let mut client = Client::connect("192.168.1.11:8765", Duration::from_secs(2))?;
//! loop {
//!     match client.next(Duration::from_millis(10))? {
//!         // Once at the start: robot.toml, field.toml, map.npz and spine.toml, as a log has them.
//!         Some(Event::Header(header)) => println!("{}", header.source),
//!         // `logged.cycle` as the robot had it; its image apart, packed: `image.decode()` unpacks it.
//!         Some(Event::Cycle(logged)) => println!("{:?}", logged.cycle.estimate.pose),
//!         // Nothing new: draw.
//!         None => {}
//!     }
//! }
//! # }
//! ```

use std::collections::HashMap;
use std::io::ErrorKind;
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail, ensure};
use prost::Message as _;
use serde::{Deserialize, Serialize};
use tungstenite::client::IntoClientRequest;
use tungstenite::handshake::HandshakeError;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

use pipeline::log::read::{CycleAssembler, TopicKind};
use pipeline::log::schema::{ABOUT_TOPIC, CYCLE_TOPIC, IMAGE_TOPIC, wire};
use pipeline::log::{Header, LoggedCycle};

/// The dialect of Foxglove's WebSocket protocol that the server speaks.
const SUBPROTOCOL: &str = "foxglove.sdk.v1";
/// First byte of a binary message that holds a message of a channel.
const MESSAGE_DATA: u8 = 1;

/// A connection to a live stream.
pub struct StreamClient {
    socket: WebSocket<TcpStream>,
    address: String,
    /// By the number under which we subscribed.
    topics: HashMap<u32, SubscribedTopic>,
    assembler: CycleAssembler,
}

/// What arrived.
#[derive(Debug)]
pub enum StreamEvent {
    /// What a log of this run starts with; comes first, and again whenever somebody else subscribes.
    Header(Box<Header>),
    /// A cycle, with its image beside it if the stream carries images.
    Cycle(Box<LoggedCycle>),
}

#[derive(Clone, Copy)]
enum SubscribedTopic {
    About,
    Log(TopicKind),
}

/// A text message of the server, as far as we read it.
#[derive(Deserialize)]
struct ServerMessage {
    op: String,
    #[serde(default)]
    channels: Vec<AdvertisedChannel>,
}

#[derive(Deserialize)]
struct AdvertisedChannel {
    id: u32,
    topic: String,
}

#[derive(Serialize)]
struct SubscribeRequest {
    op: &'static str,
    subscriptions: Vec<ChannelSubscription>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct ChannelSubscription {
    id: u32,
    channel_id: u32,
}

impl StreamClient {
    /// Connects to `address` (`host:port`, with or without `ws://`) within `patience`.
    pub fn connect(address: &str, patience: Duration) -> Result<Self> {
        let place = address.trim_start_matches("ws://").trim_end_matches('/');
        let socket =
            connect_websocket(place, patience).with_context(|| format!("cannot watch {place}"))?;
        Ok(StreamClient {
            socket,
            address: place.to_owned(),
            topics: HashMap::new(),
            assembler: CycleAssembler::default(),
        })
    }

    /// What came since the last call, or comes within `patience`; none if nothing does.
    ///
    /// An error ends the connection: the robot is gone, or speaks another version.
    pub fn next_event(&mut self, patience: Duration) -> Result<Option<StreamEvent>> {
        let until = Instant::now() + patience;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            // The system takes zero for "for ever".
            let left = left.max(Duration::from_millis(1));
            self.socket.get_ref().set_read_timeout(Some(left))?;
            let event = match self.socket.read() {
                Ok(Message::Text(text)) => self.handle_text(&text).map(|()| None),
                Ok(Message::Binary(bytes)) => self.handle_binary(&bytes),
                Ok(Message::Close(_)) => Err(anyhow!("the stream has ended")),
                Ok(_) => Ok(None),
                Err(tungstenite::Error::Io(error))
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                {
                    return Ok(None);
                }
                Err(error) => Err(error.into()),
            };
            if let Some(event) = event.with_context(|| format!("stream of {}", self.address))? {
                return Ok(Some(event));
            }
            if Instant::now() >= until {
                return Ok(None);
            }
        }
    }

    /// Subscribes to what a cycle is made of, when the server tells its channels.
    fn handle_text(&mut self, text: &str) -> Result<()> {
        let said: ServerMessage =
            serde_json::from_str(text).context("it does not speak Foxglove's words")?;
        if said.op != "advertise" {
            return Ok(());
        }
        let mut subscriptions = Vec::new();
        for AdvertisedChannel { id, topic } in said.channels {
            let wanted = match topic.as_str() {
                ABOUT_TOPIC => SubscribedTopic::About,
                CYCLE_TOPIC | IMAGE_TOPIC => SubscribedTopic::Log(TopicKind::from_name(&topic)),
                _ => continue,
            };
            self.topics.insert(id, wanted);
            subscriptions.push(ChannelSubscription { id, channel_id: id });
        }
        let subscribe = SubscribeRequest {
            op: "subscribe",
            subscriptions,
        };
        self.socket
            .send(Message::text(serde_json::to_string(&subscribe)?))?;
        Ok(())
    }

    fn handle_binary(&mut self, bytes: &[u8]) -> Result<Option<StreamEvent>> {
        let Some((&MESSAGE_DATA, rest)) = bytes.split_first() else {
            return Ok(None);
        };
        let parts = rest
            .split_first_chunk::<4>()
            .and_then(|(id, rest)| Some((id, rest.split_first_chunk::<8>()?)));
        let Some((id, (log_time, data))) = parts else {
            bail!("a message of {} bytes", bytes.len());
        };
        Ok(match self.topics.get(&u32::from_le_bytes(*id)) {
            Some(SubscribedTopic::About) => {
                let about = wire::About::decode(data)?;
                let header = Header::from_message(about, Path::new(&self.address))?;
                Some(StreamEvent::Header(Box::new(header)))
            }
            Some(SubscribedTopic::Log(topic)) => self
                .assembler
                .push_message(*topic, u64::from_le_bytes(*log_time), data)?
                .map(|logged| StreamEvent::Cycle(Box::new(logged))),
            None => None,
        })
    }
}

fn connect_websocket(place: &str, patience: Duration) -> Result<WebSocket<TcpStream>> {
    let mut refused = None;
    for address in place.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, patience) {
            Ok(stream) => return handshake(stream, place, patience),
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) => Err(error.into()),
        None => bail!("no such host"),
    }
}

fn handshake(stream: TcpStream, place: &str, patience: Duration) -> Result<WebSocket<TcpStream>> {
    stream.set_read_timeout(Some(patience))?;
    stream.set_write_timeout(Some(patience))?;
    stream.set_nodelay(true)?;
    let mut request = format!("ws://{place}/").into_client_request()?;
    request.headers_mut().insert(
        "Sec-WebSocket-Protocol",
        HeaderValue::from_static(SUBPROTOCOL),
    );
    let (socket, answer) = match tungstenite::client(request, stream) {
        Ok(done) => done,
        Err(HandshakeError::Interrupted(_)) => bail!("it does not answer"),
        Err(HandshakeError::Failure(error)) => return Err(error.into()),
    };
    let spoken = answer.headers().get("Sec-WebSocket-Protocol");
    ensure!(
        spoken.is_some_and(|spoken| spoken == SUBPROTOCOL),
        "it does not speak {SUBPROTOCOL}"
    );
    Ok(socket)
}
