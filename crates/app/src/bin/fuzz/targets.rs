//! What reads bytes that a stranger may have written? Each reader as a function of bytes that describes its outcome.

use std::fmt::Display;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use app::{
    CommandConfig, CommandFilter, RobotIdentity, StreamMessages, check_client_bytes,
    check_network_file,
};
use localize::global_search::scan_map::{ScanMap, ScanMapConfig};
use localize::robot::RobotConfig;
use localize::team::{TeamConfig, TeamModel};
use localize::{DistanceField, Field, LocalizeConfig, Stamp};
use pipeline::PipelineConfig;
use pipeline::csv_table::CsvTable;
use pipeline::datagram::{TeamLink, TeamLinkConfig};
use pipeline::log::read::{CycleAssembler, TopicKind};
use pipeline::log::{self, LogIndex, LogReader};
use pipeline::recording::Recording;
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};
use vision::calibrate::mask::load_mask;
use vision::colour::colour_table::load_labels;
use vision::image::Image;
use vision::{ColourTable, GroundMap, Profile};

#[path = "../../../../hw/tests/oracle/mod.rs"]
mod oracle;

/// A reader under test.
pub(crate) struct Target {
    /// Name of its folder in fuzz/corpus.
    pub(crate) name: &'static str,
    /// Reads the bytes; may write into the folder. Returns a description of the outcome. A panic is a failure.
    pub(crate) run: fn(&[u8], &Path) -> String,
}

/// All readers.
pub(crate) const TARGETS: &[Target] = &[
    target("log", read_log),
    target("log_index", index_log),
    target("log_recover", recover_log),
    target("cycle", assemble_cycle),
    target("stream", read_stream),
    target("stream_guard", guard_stream),
    target("image", |bytes, _| {
        outcome(Image::decode(bytes).map(|image| image.width_px))
    }),
    target("map", |bytes, folder| {
        outcome(GroundMap::load(&saved(bytes, folder, "a.npz")))
    }),
    target("colour_table", |bytes, folder| {
        outcome(ColourTable::load(&saved(bytes, folder, "a.table")))
    }),
    target("scan_map", read_scan_map),
    target("csv", read_csv),
    target("recording", read_recording),
    target("toml", read_toml),
    target("commands", accept_command),
    target("team", accept_report),
    target("board", |bytes, _| in_pieces(bytes, oracle::check_board)),
    target("bno085", |bytes, _| in_pieces(bytes, oracle::check_bno085)),
    target("wit", |bytes, _| in_pieces(bytes, oracle::check_wit)),
    target("vesc", |bytes, _| in_pieces(bytes, oracle::check_vesc)),
    target("slcan", |bytes, _| in_pieces(bytes, oracle::check_slcan)),
    target("image_header", |bytes, _| {
        oracle::check_image_header(bytes);
        String::new()
    }),
    target("can", |bytes, _| {
        oracle::check_can(bytes);
        String::new()
    }),
];

const fn target(name: &'static str, run: fn(&[u8], &Path) -> String) -> Target {
    Target { name, run }
}

/// "read", or the error.
fn outcome<T, E: Display>(result: Result<T, E>) -> String {
    match result {
        Ok(_) => "read".to_owned(),
        Err(error) => format!("{error:#}"),
    }
}

/// A file with these bytes.
fn saved(bytes: &[u8], folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("the temporary folder is writable");
    path
}

/// The first byte is the size of the pieces, the rest the stream.
fn in_pieces(bytes: &[u8], check: fn(&[u8], &[u8])) -> String {
    if let Some((cut, stream)) = bytes.split_first() {
        check(stream, &[]);
        check(stream, &[*cut]);
    }
    String::new()
}

/// Every cycle with its samples, images decoded, and the files of the header written.
fn read_log(bytes: &[u8], folder: &Path) -> String {
    let log = match LogReader::open(&saved(bytes, folder, "a.mcap")) {
        Ok(log) => log,
        Err(error) => return format!("{error:#}"),
    };
    let files = folder.join("files");
    std::fs::create_dir_all(&files).expect("the temporary folder is writable");
    let mut outcomes = outcome(log.header().write_files(&files));
    for logged in log {
        outcomes += &outcome(logged.and_then(|logged| logged.samples(true)));
    }
    outcomes
}

/// Every chunk by random access, as the view reads it.
fn index_log(bytes: &[u8], folder: &Path) -> String {
    let index = match LogIndex::open(&saved(bytes, folder, "a.mcap")) {
        Ok(index) => index,
        Err(error) => return format!("{error:#}"),
    };
    let mut outcomes = index.warnings().join("; ");
    for chunk in 0..index.chunks().len() {
        outcomes += &outcome(index.load(chunk));
    }
    outcomes
}

fn recover_log(bytes: &[u8], folder: &Path) -> String {
    let whole = folder.join("whole.mcap");
    let summary = match log::recover(&saved(bytes, folder, "a.mcap"), &whole) {
        Ok(summary) => summary,
        Err(error) => return format!("{error:#}"),
    };
    if summary.messages == 0 {
        return summary.lost.join("; ");
    }
    // What was recovered is a log without damage.
    let again = log::recover(&whole, &folder.join("again.mcap")).expect("recovered again");
    assert!(again.was_whole, "{:?}", again.lost);
    assert_eq!(again.messages, summary.messages);
    summary.lost.join("; ")
}

fn assemble_cycle(bytes: &[u8], _: &Path) -> String {
    let mut assembler = CycleAssembler::default();
    outcome(assembler.push_message(TopicKind::Image, 0, bytes))
        + &outcome(assembler.push_message(TopicKind::Cycle, 0, bytes))
}

/// The bytes that a server sends after the handshake.
fn read_stream(bytes: &[u8], _: &Path) -> String {
    let mut socket = WebSocket::from_raw_socket(Received(Cursor::new(bytes)), Role::Client, None);
    let mut messages = StreamMessages::default();
    let mut outcomes = String::new();
    loop {
        outcomes += &match socket.read() {
            Ok(Message::Text(text)) => outcome(messages.read_text(&text)),
            Ok(Message::Binary(bytes)) => outcome(messages.read_binary(&bytes, "robot")),
            Ok(_) => continue,
            Err(error) => return outcomes + &error.to_string(),
        };
    }
}

/// The bytes of a client before the guard: its request and its messages. The cuts between reads must not matter.
fn guard_stream(bytes: &[u8], _: &Path) -> String {
    let Some((cut, client)) = bytes.split_first() else {
        return String::new();
    };
    let outcome = check_client_bytes(client, usize::MAX);
    let in_pieces = check_client_bytes(client, usize::from(*cut) + 1);
    // A head that is too long is noticed at its end or, in pieces, before.
    assert!(
        outcome == in_pieces || client.len() > 8192,
        "{outcome}; in pieces: {in_pieces}"
    );
    outcome
}

/// A connection that only receives.
struct Received<'a>(Cursor<&'a [u8]>);

impl Read for Received<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        self.0.read(bytes)
    }
}

impl Write for Received<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A stored scan map of a small field. Its checksum is set right in a second copy, so that the cells are reached too.
fn read_scan_map(bytes: &[u8], _: &Path) -> String {
    static FIELD: OnceLock<(Field, ScanMapConfig)> = OnceLock::new();
    let (field, config) = FIELD.get_or_init(|| {
        let fields = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields");
        let field = Field::load(&fields.join("msl_2001.toml")).expect("a field");
        let config = ScanMapConfig {
            cell: 1.0,
            ..ScanMapConfig::default()
        };
        (field, config)
    });
    static WHOLE: OnceLock<Vec<u8>> = OnceLock::new();
    let whole = WHOLE.get_or_init(|| {
        let distances = DistanceField::new(field, &LocalizeConfig::default().distance_field);
        ScanMap::new(field, &distances, config.clone()).to_bytes(field)
    });
    let mut damaged = whole.clone();
    for (place, byte) in bytes.iter().enumerate() {
        if let Some(target) = damaged.get_mut(place) {
            *target ^= byte;
        }
    }
    let read = ScanMap::from_bytes(&damaged, field, config);
    assert!(
        read.is_none() || damaged == *whole,
        "a damaged scan map was read"
    );
    format!("{}", ScanMap::from_bytes(bytes, field, config).is_some())
}

fn read_csv(bytes: &[u8], folder: &Path) -> String {
    let path = saved(bytes, folder, "a.csv");
    let labels = outcome(load_labels(&path));
    let profile = outcome(Profile::load(&path));
    let table = match CsvTable::read(&path, &["stamp_s"]) {
        Ok(table) => table,
        Err(error) => return format!("{error:#}{labels}{profile}"),
    };
    let numbers = table.rows().map(|row| outcome(row.number("stamp_s")));
    numbers.take(8).collect::<String>() + &labels + &profile
}

/// The first byte chooses the file of the recording folder.
fn read_recording(bytes: &[u8], folder: &Path) -> String {
    const FILES: [(&str, &str); 8] = [
        ("frames.csv", "stamp_s,file\n0.0,a.png\n0.1,b.png\n"),
        (
            "odometry.csv",
            "stamp_s,dx_m,dy_m,dtheta_rad\n0.05,0.1,0,0\n",
        ),
        ("compass.csv", "stamp_s,heading_rad\n0.05,1.0\n"),
        ("truth.csv", "stamp_s,x_m,y_m,theta_rad\n0.0,0,0,0\n"),
        ("objects.csv", "stamp_s,kind,x_m,y_m\n0.0,ball,1,0\n"),
        ("points.csv", "stamp_s,x_m,y_m\n0.0,1,0\n"),
        (
            "imu.csv",
            "stamp_s,ax_m_s2,ay_m_s2,az_m_s2,wx_rad_s,wy_rad_s,wz_rad_s\n0.05,0,0,9.8,0,0,1\n",
        ),
        ("magnetometer.csv", "stamp_s,x,y\n0.05,0.3,0.1\n"),
    ];
    let Some((choice, content)) = bytes.split_first() else {
        return String::new();
    };
    let choice = usize::from(*choice) % FILES.len();
    for (number, (name, usual)) in FILES.iter().enumerate() {
        let path = folder.join(name);
        if number == choice {
            saved(content, folder, name);
        } else if *name == "points.csv" {
            let _absent = std::fs::remove_file(path);
        } else {
            saved(usual.as_bytes(), folder, name);
        }
    }
    match Recording::open(folder, 0.04) {
        Ok(recording) => format!("{choice} read {}", recording.take(1000).count().min(9)),
        Err(error) => format!("{error:#}"),
    }
}

/// Every kind of configuration file, from the same text.
fn read_toml(bytes: &[u8], folder: &Path) -> String {
    let path = saved(bytes, folder, "a.toml");
    outcome(RobotConfig::load(&path))
        + &outcome(Field::load(&path))
        + &outcome(PipelineConfig::load("default", Some(&path)))
        + &outcome(hw::HardwareConfig::load(&path))
        + &outcome(check_network_file(&path))
        + &outcome(load_mask(&path, 4, 4))
}

/// The command as sent, and sealed with the key.
fn accept_command(bytes: &[u8], _: &Path) -> String {
    let mut outcomes = String::new();
    for key in [None, Some("a key of sixteen")] {
        let config = CommandConfig {
            key: key.map(str::to_owned),
            ..CommandConfig::default()
        };
        let mut filter =
            CommandFilter::new(&config, RobotIdentity { robot: 1, boot: 1 }).expect("a filter");
        let datagram = seal(bytes, key);
        match filter.accept(&datagram, None, Stamp(0)) {
            Ok(command) => {
                assert!(command.valid_for.as_millis() <= 100);
                let drive = command.drive;
                assert!(drive.is_none_or(|drive| drive.x.hypot(drive.y) <= config.speed_max));
                // The same datagram again is a replay.
                assert!(filter.accept(&datagram, None, Stamp(0)).is_err());
                outcomes += "accepted ";
            }
            Err(reason) => outcomes += &format!("{reason:?}"),
        }
    }
    outcomes
}

fn accept_report(bytes: &[u8], _: &Path) -> String {
    let mut outcomes = String::new();
    for key in [None, Some("a key of sixteen")] {
        let config = TeamLinkConfig {
            key: key.map(str::to_owned),
            ..TeamLinkConfig::default()
        };
        let mut link = TeamLink::new(&config, 1).expect("a link");
        let datagram = seal(bytes, key);
        match link.receive(&datagram, Stamp(0)) {
            Ok(report) => {
                assert!(report.robot != config.robot && report.stamp <= Stamp(0));
                assert!(link.receive(&datagram, Stamp(0)).is_err());
                TeamModel::new(TeamConfig::default()).receive(&report);
                outcomes += "accepted ";
            }
            Err(reason) => outcomes += &format!("{reason:?}"),
        }
    }
    outcomes
}

/// A datagram with the code of its key.
fn seal(bytes: &[u8], key: Option<&str>) -> Vec<u8> {
    use pipeline::datagram::authentication::{MacKey, append_mac};
    let key = key.map(|phrase| MacKey::new(phrase).expect("a key"));
    append_mac(bytes.to_vec(), key.as_ref())
}
