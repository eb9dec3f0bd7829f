//! What do the messages of a live stream say? Texts and bytes of Foxglove's protocol become cycles.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use anyhow::{Context, Result, bail};
use prost::Message as _;
use serde::{Deserialize, Serialize};

use super::parameters::{HISTORY, MESSAGE, NONCE};
use pipeline::log::read::{CycleAssembler, TopicKind};
use pipeline::log::schema::{ABOUT_TOPIC, CYCLE_TOPIC, IMAGE_TOPIC, wire};
use pipeline::log::{Header, LoggedCycle};

/// First byte of a binary message that carries data of a channel.
const MESSAGE_DATA: u8 = 1;

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
    /// Texts about the settings by their names (`NONCE`, `MESSAGE`, `HISTORY` of `parameters`).
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

impl StreamMessages {
    /// The request that subscribes to the topics of a cycle when the server advertises its channels, or texts about the
    /// settings.
    pub fn read_text(&mut self, text: &str) -> Result<Option<TextAnswer>> {
        let message: ServerMessage =
            serde_json::from_str(text).context("not a message of Foxglove's protocol")?;
        if message.op == "parameterValues" {
            let texts = message.parameters.into_iter().filter_map(|parameter| {
                let known = [NONCE, MESSAGE, HISTORY].contains(&parameter.name.as_str());
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
        // The header last: when it comes, the server has all subscriptions, and no cycle is missed.
        subscriptions.sort_by_key(|subscription| {
            matches!(
                self.topics.get(&subscription.id),
                Some(SubscribedTopic::About)
            )
        });
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
