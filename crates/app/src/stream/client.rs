//! How is another robot's live stream read? A WebSocket that yields its events.

use std::io::ErrorKind;
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail, ensure};
use tungstenite::client::IntoClientRequest;
use tungstenite::handshake::HandshakeError;
use tungstenite::http::HeaderValue;
use tungstenite::{Message, WebSocket};

use super::messages::{StreamEvent, StreamMessages, TextAnswer};
use super::parameters::{HISTORY, MESSAGE, NONCE, OVERLAY, SEAL};

/// The version of Foxglove's WebSocket protocol that the server uses.
const SUBPROTOCOL: &str = "foxglove.sdk.v1";

/// A connection to a live stream.
pub(crate) struct StreamClient {
    socket: WebSocket<TcpStream>,
    address: String,
    messages: StreamMessages,
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
                "parameterNames": [NONCE, MESSAGE, HISTORY],
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
