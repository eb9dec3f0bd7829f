//! Which messages would a log hold of a cycle? For plots of a live run, by the code that writes logs.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;
use foxglove::{Context, FoxgloveError, Metadata, RawChannel, Sink, SinkId};

use super::columns::{RawMessage, Topic};
use super::encoded_image::ImageCompression;
use super::header::Header;
use super::publisher::CyclePublisher;
use super::schema::Topics;
use crate::cycle::Cycle;

/// Quality of images, which are not encoded here.
const UNUSED_QUALITY: u8 = 90;

/// Converts cycles of a live run to the messages of a log, without images.
pub struct LiveTopics {
    publisher: CyclePublisher,
    topics: BTreeMap<String, Topic>,
    sink: Arc<MessageSink>,
    /// Connects publisher and sink during its lifetime.
    _context: Arc<Context>,
}

impl LiveTopics {
    /// Opens all topics of a log.
    pub fn new() -> Result<Self> {
        let context = Context::new();
        let sink = Arc::new(MessageSink {
            id: SinkId::next(),
            state: Mutex::default(),
        });
        context.add_sink(sink.clone());
        let header = Header::new("", None);
        let topics = Topics::new(&context)?;
        let publisher =
            CyclePublisher::new(topics, ImageCompression::None, UNUSED_QUALITY, &header);
        let topics = std::mem::take(&mut sink.lock().topics);
        Ok(LiveTopics {
            publisher,
            topics,
            sink,
            _context: context,
        })
    }

    /// Every topic by its name.
    pub fn topics(&self) -> &BTreeMap<String, Topic> {
        &self.topics
    }

    /// The messages of a cycle; their log times are its stamps.
    pub fn messages(&mut self, index: u64, cycle: &Cycle) -> Result<Vec<RawMessage>> {
        self.publisher.publish_cycle(index, cycle)?;
        Ok(std::mem::take(&mut self.sink.lock().messages))
    }
}

/// Collects messages.
struct MessageSink {
    id: SinkId,
    state: Mutex<SinkState>,
}

#[derive(Default)]
struct SinkState {
    topics: BTreeMap<String, Topic>,
    messages: Vec<RawMessage>,
}

impl MessageSink {
    // Messages are whole even after a panic of another thread.
    fn lock(&self) -> std::sync::MutexGuard<'_, SinkState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Sink for MessageSink {
    fn id(&self) -> SinkId {
        self.id
    }

    fn log(
        &self,
        channel: &RawChannel,
        message: &[u8],
        metadata: &Metadata,
    ) -> Result<(), FoxgloveError> {
        let message = RawMessage::new(channel.topic(), metadata.log_time, message);
        self.lock().messages.push(message);
        Ok(())
    }

    fn add_channel(&self, channel: &Arc<RawChannel>) -> bool {
        let (name, data) = channel.schema().map_or(("", &[][..]), |schema| {
            (schema.name.as_str(), &schema.data[..])
        });
        let topic = Topic::new(name, data, channel.message_encoding());
        self.lock().topics.insert(channel.topic().to_owned(), topic);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::columns::{Field, FieldValue};
    use crate::testing::random_cycle;

    #[test]
    fn fields_of_a_live_cycle_are_read_as_from_a_log() {
        let mut live = LiveTopics::new().expect("topics");
        let error = Field::find(live.topics(), "/truth/error.distance").expect("a field");
        let x = Field::find(live.topics(), "/cycle.estimate.pose.x").expect("a field");
        let cycle = random_cycle(0);
        let messages = live.messages(0, &cycle).expect("messages");
        let value = |field: &Field| {
            let mut of_topic = messages.iter().filter(|m| m.topic == field.topic());
            of_topic.next_back().map(|message| {
                assert_eq!(
                    message.log_time,
                    crate::log::schema::log_time(cycle.stamp),
                    "{}",
                    message.topic
                );
                field.read(message).expect("a value")
            })
        };
        let pose = cycle.estimate.pose;
        let expected = pose.map_or(FieldValue::Absent, |pose| {
            FieldValue::Number(f64::from(pose.x))
        });
        assert_eq!(value(&x), Some(expected));
        let truth = cycle.inputs.truth.as_ref().zip(pose);
        let distance = truth.map(|(truth, pose)| {
            let distance = pose.origin().distance_to(truth.pose.origin());
            FieldValue::Number(f64::from(distance))
        });
        assert_eq!(value(&error), distance);
    }

    /// Texts under a key anywhere in a layout.
    fn texts_under<'a>(value: &'a serde_json::Value, key: &str, found: &mut Vec<&'a str>) {
        match value {
            serde_json::Value::Object(fields) => {
                for (name, value) in fields {
                    match value {
                        serde_json::Value::String(text) if name == key => found.push(text),
                        serde_json::Value::Object(topics) if name == key => {
                            found.extend(topics.keys().map(String::as_str));
                        }
                        value => texts_under(value, key, found),
                    }
                }
            }
            serde_json::Value::Array(list) => {
                list.iter().for_each(|value| texts_under(value, key, found));
            }
            _ => {}
        }
    }

    #[test]
    fn layout_for_other_viewers_names_topics_and_fields_of_a_log() {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../config/viewers/lichtblick.json"
        );
        let text = std::fs::read_to_string(path).expect("a layout");
        let layout: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let live = LiveTopics::new().expect("topics");
        let mut fields = Vec::new();
        texts_under(&layout, "value", &mut fields);
        assert!(fields.len() > 8, "{fields:?}");
        for field in fields {
            Field::find(live.topics(), field).unwrap_or_else(|error| panic!("{error:#}"));
        }
        let mut topics = Vec::new();
        for key in ["topics", "imageTopic", "annotations", "topicToRender"] {
            texts_under(&layout, key, &mut topics);
        }
        assert!(topics.len() > 8, "{topics:?}");
        for topic in topics {
            assert!(live.topics().contains_key(topic), "{topic}");
        }
    }
}
