//! Tests of a log's bytes by an independent reader, the crate mcap: checksums, indexes and summary.

use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::log::LogConfig;
use crate::testing::record;

fn logged() -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    record(&path, 40, &LogConfig::default());
    std::fs::read(&path).expect("bytes")
}

#[test]
fn checksums_of_a_log_are_right() {
    let bytes = logged();
    let options = LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true);
    let mut reader = LinearReader::new_with_options(options);
    let (mut rest, mut sums) = (&bytes[..], Vec::new());
    while let Some(event) = reader.next_event() {
        match event.expect("valid") {
            LinearReadEvent::ReadRequest(wanted) => {
                let (read, behind) = rest.split_at(wanted.min(rest.len()));
                reader.insert(read.len()).copy_from_slice(read);
                reader.notify_read(read.len());
                rest = behind;
            }
            LinearReadEvent::Record { opcode, data } => {
                match mcap::read::parse_record(opcode, data).expect("a record") {
                    Record::DataEnd(end) => sums.push(end.data_section_crc),
                    Record::Footer(footer) => sums.push(footer.summary_crc),
                    _ => {}
                }
            }
        }
    }
    // Zero would mean that there is none to check.
    assert!(sums.len() == 2 && !sums.contains(&0), "{sums:?}");
}

#[test]
fn indexes_of_a_log_lead_to_every_message() {
    let bytes = logged();
    let read = mcap::Summary::read(&bytes).expect("readable");
    let summary = read.expect("a summary");
    let statistics = summary.stats.clone().expect("statistics");
    assert!(summary.chunk_indexes.len() > 1);
    assert_eq!(statistics.chunk_count as usize, summary.chunk_indexes.len());
    let mut messages = 0;
    for chunk in &summary.chunk_indexes {
        let indexes = summary.read_message_indexes(&bytes, chunk);
        let mut indexes: Vec<_> = indexes.expect("an index").into_iter().collect();
        indexes.sort_by_key(|(channel, _)| channel.id);
        for (channel, entries) in indexes {
            for entry in entries {
                let message = summary.seek_message(&bytes, chunk, &entry);
                let message = message.expect("a message");
                assert_eq!(message.channel.topic, channel.topic);
                assert_eq!(message.log_time, entry.log_time);
                let times = chunk.message_start_time..=chunk.message_end_time;
                assert!(times.contains(&message.log_time));
                messages += 1;
            }
        }
    }
    let stream = mcap::MessageStream::new(&bytes).expect("messages");
    assert_eq!(stream.count() as u64, messages);
    assert_eq!(statistics.message_count, messages);
    let counted: u64 = statistics.channel_message_counts.values().sum();
    assert_eq!(counted, messages);
    let names: Vec<String> = summary
        .attachment_indexes
        .iter()
        .map(|index| mcap::read::attachment(&bytes, index).expect("a file").name)
        .collect();
    assert_eq!(names, ["field.toml", "robot.toml"]);
    let [metadata] = &summary.metadata_indexes[..] else {
        panic!("{:?}", summary.metadata_indexes);
    };
    let metadata = mcap::read::metadata(&bytes, metadata).expect("metadata");
    assert_eq!(metadata.name, "mirrorball");
}
