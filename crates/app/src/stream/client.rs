//! How is another robot's live stream read? Messages of the stream become cycles.

use std::collections::{BTreeMap, HashMap};
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

use super::parameters::{MESSAGE, NONCE, OVERLAY, SEAL};
use pipeline::log::read::{CycleAssembler, TopicKind};
use pipeline::log::schema::{ABOUT_TOPIC, CYCLE_TOPIC, IMAGE_TOPIC, wire};
use pipeline::log::{Header, LoggedCycle};

/// The version of Foxglove's WebSocket protocol that the server uses.
const SUBPROTOCOL: &str = "foxglove.sdk.v1";
/// First byte of a binary message that carries data of a channel.
const MESSAGE_DATA: u8 = 1;

/// A connection to a live stream.
pub(crate) struct StreamClient {
    socket: WebSocket<TcpStream>,
    address: String,
    messages: StreamMessages,
}

/// The messages of a live stream, as a client reads them: which channels there are, and the cycles assembled from them.
#[derive(Default)]
pub struct StreamMessages {
    /// By subscription id.
    topics: HashMap<u32, SubscribedTopic>,
    assembler: CycleAssembler,
}

/// A received event.
#[derive(Debug)]
pub enum StreamEvent {
    /// The header of a log of this run. Comes first, and again whenever another viewer subscribes.
    Header(Box<Header>),
    /// A cycle, with its encoded image if the stream carries images.
    Cycle(Box<LoggedCycle>),
    /// Texts about the settings by their names (`NONCE`, `MESSAGE` of `parameters`).
    Settings(BTreeMap<String, String>),
}

/// What a text message of the server leads to.
#[derive(Debug)]
pub enum TextAnswer {
    /// A request to send.
    Request(String),
    /// A received event.
    Event(StreamEvent),
}

#[derive(Clone, Copy)]
enum SubscribedTopic {
    About,
    Log(TopicKind),
}

/// The part of the server's text messages that is read.
#[derive(Deserialize)]
struct ServerMessage {
    op: String,
    #[serde(default)]
    channels: Vec<AdvertisedChannel>,
    #[serde(default)]
    parameters: Vec<ParameterUpdate>,
}

#[derive(Deserialize)]
struct ParameterUpdate {
    name: String,
    #[serde(default)]
    value: serde_json::Value,
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
    /// Connects to `address` (`host:port`, with or without `ws://`) within `timeout`.
    pub(crate) fn connect(address: &str, timeout: Duration) -> Result<Self> {
        let host_port = address.trim_start_matches("ws://").trim_end_matches('/');
        let socket = connect_websocket(host_port, timeout)
            .with_context(|| format!("cannot connect to {host_port}"))?;
        Ok(StreamClient {
            socket,
            address: host_port.to_owned(),
            messages: StreamMessages::default(),
        })
    }

    /// The next event, received since the last call or within `timeout`. None after the timeout.
    ///
    /// An error ends the connection: the robot is gone, or has another version.
    pub(crate) fn next_event(&mut self, timeout: Duration) -> Result<Option<StreamEvent>> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            // For the system a timeout of zero means none.
            let left = left.max(Duration::from_millis(1));
            self.socket.get_ref().set_read_timeout(Some(left))?;
            let event = match self.socket.read() {
                Ok(Message::Text(text)) => self.handle_text(&text),
                Ok(Message::Binary(bytes)) => self.messages.read_binary(&bytes, &self.address),
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
            if Instant::now() >= deadline {
                return Ok(None);
            }
        }
    }

    /// Asks for the texts about the settings now, and whenever they change. A robot without tuning does not answer.
    pub(crate) fn request_settings(&mut self) -> Result<()> {
        for op in ["subscribeParameterUpdates", "getParameters"] {
            self.send_json(&serde_json::json!({
                "op": op,
                "parameterNames": [NONCE, MESSAGE],
                "id": "settings",
            }))?;
        }
        Ok(())
    }

    /// Requests changed settings (an overlay in TOML) with their seal, if the robot has a key.
    pub(crate) fn change_settings(&mut self, overlay: &str, seal: Option<&str>) -> Result<()> {
        let mut parameters = vec![serde_json::json!({ "name": OVERLAY, "value": overlay })];
        parameters.extend(seal.map(|seal| serde_json::json!({ "name": SEAL, "value": seal })));
        self.send_json(&serde_json::json!({
            "op": "setParameters",
            "parameters": parameters,
            "id": "settings",
        }))
    }

    fn send_json(&mut self, message: &serde_json::Value) -> Result<()> {
        Ok(self.socket.send(Message::text(message.to_string()))?)
    }

    fn handle_text(&mut self, text: &str) -> Result<Option<StreamEvent>> {
        match self.messages.read_text(text)? {
            Some(TextAnswer::Request(request)) => {
                self.socket.send(Message::text(request))?;
                Ok(None)
            }
            Some(TextAnswer::Event(event)) => Ok(Some(event)),
            None => Ok(None),
        }
    }
}

impl StreamMessages {
    /// The request that subscribes to the topics of a cycle when the server advertises its channels, or texts about the
    /// settings.
    pub fn read_text(&mut self, text: &str) -> Result<Option<TextAnswer>> {
        let message: ServerMessage =
            serde_json::from_str(text).context("not a message of Foxglove's protocol")?;
        if message.op == "parameterValues" {
            let texts = message.parameters.into_iter().filter_map(|parameter| {
                let known = [NONCE, MESSAGE].contains(&parameter.name.as_str());
                let text = parameter.value.as_str().filter(|_| known)?.to_owned();
                Some((parameter.name, text))
            });
            let event = StreamEvent::Settings(texts.collect());
            return Ok(Some(TextAnswer::Event(event)));
        }
        if message.op != "advertise" {
            return Ok(None);
        }
        let mut subscriptions = Vec::new();
        for AdvertisedChannel { id, topic } in message.channels {
            let subscribed = match topic.as_str() {
                ABOUT_TOPIC => SubscribedTopic::About,
                CYCLE_TOPIC | IMAGE_TOPIC => SubscribedTopic::Log(TopicKind::from_name(&topic)),
                _ => continue,
            };
            self.topics.insert(id, subscribed);
            subscriptions.push(ChannelSubscription { id, channel_id: id });
        }
        let subscribe = SubscribeRequest {
            op: "subscribe",
            subscriptions,
        };
        Ok(Some(TextAnswer::Request(serde_json::to_string(
            &subscribe,
        )?)))
    }

    /// The event of a binary message, if it completes one. `address` names the sender in errors.
    pub fn read_binary(&mut self, bytes: &[u8], address: &str) -> Result<Option<StreamEvent>> {
        let Some((&MESSAGE_DATA, rest)) = bytes.split_first() else {
            return Ok(None);
        };
        let parts = rest
            .split_first_chunk::<4>()
            .and_then(|(id, rest)| Some((id, rest.split_first_chunk::<8>()?)));
        let Some((id, (log_time, data))) = parts else {
            bail!("message too short: {} bytes", bytes.len());
        };
        Ok(match self.topics.get(&u32::from_le_bytes(*id)) {
            Some(SubscribedTopic::About) => {
                let about = wire::About::decode(data)?;
                let header = Header::from_message(about, Path::new(address))?;
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

fn connect_websocket(host_port: &str, timeout: Duration) -> Result<WebSocket<TcpStream>> {
    let mut last_error = None;
    for address in host_port.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, timeout) {
            Ok(stream) => return handshake(stream, host_port, timeout),
            Err(error) => last_error = Some(error),
        }
    }
    match last_error {
        Some(error) => Err(error.into()),
        None => bail!("unknown host"),
    }
}

fn handshake(
    stream: TcpStream,
    host_port: &str,
    timeout: Duration,
) -> Result<WebSocket<TcpStream>> {
    stream.set_read_timeout(Some(timeout))?;
    stream.set_write_timeout(Some(timeout))?;
    stream.set_nodelay(true)?;
    let mut request = format!("ws://{host_port}/").into_client_request()?;
    request.headers_mut().insert(
        "Sec-WebSocket-Protocol",
        HeaderValue::from_static(SUBPROTOCOL),
    );
    let (socket, response) = match tungstenite::client(request, stream) {
        Ok(done) => done,
        Err(HandshakeError::Interrupted(_)) => bail!("no answer"),
        Err(HandshakeError::Failure(error)) => return Err(error.into()),
    };
    let protocol = response.headers().get("Sec-WebSocket-Protocol");
    ensure!(
        protocol.is_some_and(|protocol| protocol == SUBPROTOCOL),
        "the server does not support {SUBPROTOCOL}"
    );
    Ok(socket)
}
