//! What is known of a topic, and its encoded messages.

use anyhow::Result;

use super::layout::Schema;
use crate::log::encoded_image::EncodedImage;
use crate::log::schema::decode_compressed_image;

/// A topic of a log.
#[derive(Debug)]
pub struct Topic {
    /// Name of its message type.
    pub schema: String,
    /// Its messages.
    pub messages: u64,
    pub(super) layout: Result<Schema, String>,
    /// Its messages are JSON.
    pub(super) is_json: bool,
}

/// An encoded message.
pub struct RawMessage {
    /// Its topic.
    pub topic: String,
    /// Log time, nanoseconds.
    pub log_time: u64,
    pub(super) data: Vec<u8>,
}

impl Topic {
    /// A topic without messages so far. `descriptors`: the data of its schema. `encoding`: of its messages.
    pub(in crate::log) fn new(schema: &str, descriptors: &[u8], encoding: &str) -> Self {
        let is_json = encoding == "json";
        let layout = match encoding {
            // Logs of other writers may leave the encoding out.
            "protobuf" | "" => {
                Schema::parse(schema, descriptors).map_err(|error| format!("{error:#}"))
            }
            other => Err(format!("its messages are {other}, not protobuf")),
        };
        Topic {
            schema: schema.to_owned(),
            messages: 0,
            layout,
            is_json,
        }
    }
}

impl RawMessage {
    pub(in crate::log) fn new(topic: &str, log_time: u64, data: &[u8]) -> Self {
        RawMessage {
            topic: topic.to_owned(),
            log_time,
            data: data.to_vec(),
        }
    }

    /// The encoded image of a message of /camera/image.
    pub fn encoded_image(&self) -> Result<EncodedImage> {
        decode_compressed_image(&self.data)
    }
}
