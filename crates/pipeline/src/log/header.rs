//! What does a log contain before its first cycle? Version, seed, source, and the files of the run.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use localize::input_file;
use localize::robot::{CameraSection, MapConfig, RobotConfig};
use vision::GroundMap;
use vision::colour::colour_table::ColourTable;
use vision::output_file::write_file;

use super::encoded_image::ImageCompression;
use super::schema::{FORMAT_VERSION, PROJECT_NAME, wire};
use crate::config::{PIPELINE_FILE, translate};
use crate::message_text::printable_line;

/// Largest file of a robot that a log takes, bytes.
const FILE_BYTES_MAX: u64 = 1 << 30;

/// Name of the settings file in logs of version 0.1.0.
const OLD_PIPELINE_FILE: &str = "spine.toml";

/// Converts the files of a log to the file names and setting keys of this version.
pub(super) fn translate_files(mut files: BTreeMap<String, Vec<u8>>) -> BTreeMap<String, Vec<u8>> {
    if let Some(settings) = files.remove(OLD_PIPELINE_FILE) {
        let settings = translate(&String::from_utf8_lossy(&settings));
        files
            .entry(PIPELINE_FILE.to_owned())
            .or_insert(settings.into_bytes());
    }
    if let Some(settings) = files.get_mut(PIPELINE_FILE) {
        let text = String::from_utf8_lossy(settings).into_owned();
        *settings = without_later_stages(&text).into_bytes();
    }
    files
}

/// Settings of a log, with the stages off that the version which wrote it did not have: its images were all processed.
fn without_later_stages(settings: &str) -> String {
    let Ok(mut table) = toml::from_str::<toml::Table>(settings) else {
        return settings.to_owned();
    };
    let Some(toml::Value::Table(vision)) = table.get_mut("vision") else {
        return settings.to_owned();
    };
    if vision.contains_key("image_check") {
        return settings.to_owned();
    }
    let off = toml::Table::from_iter([("enabled".to_owned(), toml::Value::Boolean(false))]);
    vision.insert("image_check".to_owned(), toml::Value::Table(off));
    table.to_string()
}

/// Metadata and files at the start of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// Version of mirrorball that wrote the log.
    pub version: String,
    /// The command with its main argument.
    pub source: String,
    /// Seed of a simulation.
    pub seed: Option<u64>,
    /// Compression of the images.
    pub images: ImageCompression,
    /// Name of the log that this one continues after a full disk. Its first cycle needs the state at the end of that log.
    pub continues: Option<String>,
    /// Wall-clock time since 1970 at the zero of the stamps, nanoseconds: added to a stamp it gives its log time.
    ///
    /// 0 in simulations and in logs of versions up to 0.2.0.
    pub clock_offset_ns: i64,
    /// Files of the run by their names in a recording folder: robot.toml, field.toml, map.npz, mirror.csv, …
    ///
    /// robot.toml refers to the others by these names, so that they work in any folder.
    pub files: BTreeMap<String, Vec<u8>>,
}

impl Header {
    /// A header of this version, without files.
    pub fn new(source: &str, seed: Option<u64>) -> Self {
        Header {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source: source.to_owned(),
            seed,
            images: ImageCompression::Png,
            continues: None,
            clock_offset_ns: 0,
            files: BTreeMap::new(),
        }
    }

    /// The header of a log that continues the log `previous` of the same run.
    pub fn continuing(self, previous: &str) -> Self {
        Header {
            continues: Some(previous.to_owned()),
            ..self
        }
    }

    /// Sets the wall-clock time at the zero of the stamps.
    pub fn with_clock_offset_ns(mut self, clock_offset_ns: i64) -> Self {
        self.clock_offset_ns = clock_offset_ns;
        self
    }

    /// Adds a file.
    pub fn with_file(mut self, name: &str, content: impl Into<Vec<u8>>) -> Self {
        self.files.insert(name.to_owned(), content.into());
        self
    }

    /// Adds robot.toml and the files that it names, under their names in a recording folder.
    ///
    /// `map`: the ground map in use, from any source. Replay needs its exact bits.
    /// `colours`: the colour table, if it was learned from labels.
    pub fn with_robot(
        self,
        robot: &RobotConfig,
        map: Option<&GroundMap>,
        colours: Option<&ColourTable>,
    ) -> Result<Self> {
        let read = |path: &Path| {
            input_file::read(path, FILE_BYTES_MAX)
                .with_context(|| format!("cannot read {}", path.display()))
        };
        let mut stored = robot.clone();
        let mut header = self.with_file("field.toml", read(&robot.field)?);
        stored.field = "field.toml".into();
        if let Some(mirror) = &mut stored.mirror {
            header = header.with_file("mirror.csv", read(&mirror.profile)?);
            mirror.profile = "mirror.csv".into();
        }
        if let Some(map) = map {
            header = header.with_file("map.npz", map.to_npz().context("cannot pack the map")?);
        }
        let stated = robot.map.as_ref();
        stored.map = map.map(|_| MapConfig {
            file: "map.npz".into(),
            origin_std: stated.and_then(|stated| stated.origin_std),
            turn_std_deg: stated.and_then(|stated| stated.turn_std_deg),
        });
        if let Some(mask) = &mut stored.mask {
            header = header.with_file("mask.png", read(mask)?);
            *mask = "mask.png".into();
        }
        // The colour table replaces the labels, because their images are not stored.
        stored.labels = None;
        stored.colours = colours.map(|_| "colours.table".into());
        if let Some(colours) = colours {
            header = header.with_file("colours.table", colours.to_bytes());
        }
        Ok(header.with_file("robot.toml", toml::to_string(&stored)?))
    }

    /// The camera of robot.toml. None without a file or without a camera in it.
    pub(super) fn camera(&self) -> Option<CameraSection> {
        let text = std::str::from_utf8(self.files.get("robot.toml")?).ok()?;
        toml::from_str::<RobotConfig>(text).ok()?.camera
    }

    /// True if the log holds what devices measured, and nothing computed from it (`mirrorball record`).
    pub fn holds_inputs_only(&self) -> bool {
        self.source.split(' ').next() == Some("record")
    }

    /// True if recomputed world and team must equal the recorded ones.
    ///
    /// Version 0.1.0 corrected observations by a linearised tilt, 6 cm off at 8 m. The correction is exact now.
    pub fn has_comparable_world(&self) -> bool {
        self.version != "0.1.0"
    }

    /// A warning if another version wrote the log. Recomputed bits may then differ.
    pub fn version_mismatch(&self) -> Option<String> {
        let version = env!("CARGO_PKG_VERSION");
        (self.version != version).then(|| {
            let mut warning = format!(
                "written by mirrorball {}, this is {version}: recomputed values may differ",
                self.version
            );
            if !self.has_portable_functions() {
                warning += " (from the last bit on: before 0.3.0 sine, logarithm and the like came from the platform)";
            }
            if !self.has_comparable_world() {
                warning += " (world and team are not compared: their tilt correction has changed)";
            }
            warning
        })
    }

    /// True if the log's elementary functions are those of `localize::math`, which no platform changes.
    ///
    /// Logs before 0.3.0 hold the last bits of the library on the machine that wrote them.
    fn has_portable_functions(&self) -> bool {
        !["0.1.", "0.2."]
            .iter()
            .any(|old| self.version.starts_with(old))
    }

    /// Writes the files to a temporary or new folder. Errors if one has no plain name, or names a file outside the log.
    pub fn write_files(&self, folder: &Path) -> Result<()> {
        self.write_each(folder, |path, content| std::fs::write(path, content))
    }

    /// As [`Header::write_files`], to a user's folder: each file replaces an earlier one when it is complete.
    pub fn save_files(&self, folder: &Path) -> Result<()> {
        self.write_each(folder, |path, content| write_file(path, content))
    }

    fn write_each(
        &self,
        folder: &Path,
        write: impl Fn(&Path, &[u8]) -> std::io::Result<()>,
    ) -> Result<()> {
        self.check_paths()?;
        for (name, content) in &self.files {
            if name.is_empty() || name.starts_with('.') || name.contains(['/', '\\', '\0']) {
                bail!("invalid file name in the log: {name:?} (expected a plain name)");
            }
            let path = folder.join(name);
            write(&path, content).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    /// Errors if robot.toml names a file that the log does not hold. A log must not make its reader open other files.
    fn check_paths(&self) -> Result<()> {
        if self.files.contains_key("labels.csv") {
            bail!("the log holds labels.csv, which names files outside the log");
        }
        let text = self
            .files
            .get("robot.toml")
            .map(|bytes| String::from_utf8_lossy(bytes));
        // A file that is no TOML is refused with its line when it is loaded.
        let Some(robot) = text.and_then(|text| text.parse::<toml::Table>().ok()) else {
            return Ok(());
        };
        for key in [
            "field",
            "mask",
            "labels",
            "colours",
            "include",
            "map.file",
            "mirror.profile",
        ] {
            let value = match key.split_once('.') {
                Some((table, key)) => robot.get(table).and_then(|table| table.get(key)),
                None => robot.get(key),
            };
            let is_inside = |value: &toml::Value| {
                value
                    .as_str()
                    .is_some_and(|name| self.files.contains_key(name))
            };
            if let Some(value) = value.filter(|value| !is_inside(value)) {
                if let Some(name) = value.as_str().filter(|name| !name.contains(['/', '\\'])) {
                    let name = printable_line(name);
                    bail!("the log has lost {name}, which its robot.toml names as {key}");
                }
                bail!(
                    "the log's robot.toml: {key} = {value} (expected the name of a file in the log)"
                );
            }
        }
        Ok(())
    }

    /// The first message of a live stream.
    pub fn to_message(&self) -> wire::About {
        let file = |(name, content): (&String, &Vec<u8>)| wire::Attachment {
            name: name.clone(),
            content: content.clone().into(),
        };
        wire::About {
            metadata: self
                .metadata()
                .into_iter()
                .map(|(key, value)| wire::MetadataEntry { key, value })
                .collect(),
            files: self.files.iter().map(file).collect(),
        }
    }

    /// Reads the first message of the stream at `place`. Rejects other log formats.
    pub fn from_message(about: wire::About, place: &Path) -> Result<Self> {
        let metadata = about
            .metadata
            .into_iter()
            .map(|entry| (entry.key, entry.value));
        let files = about
            .files
            .into_iter()
            .map(|file| (file.name, file.content.into()));
        Ok(Header {
            files: translate_files(files.collect()),
            ..Header::from_metadata(&metadata.collect(), place)?
        })
    }

    /// The metadata record. Files are attachments.
    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        let seed = self.seed.map_or_else(String::new, |seed| seed.to_string());
        let continues = self.continues.iter().map(|log| ("continues", log.clone()));
        [
            ("format", FORMAT_VERSION.to_string()),
            ("version", self.version.clone()),
            ("source", self.source.clone()),
            ("seed", seed),
            ("images", self.images.name().to_owned()),
            ("clock_offset_ns", self.clock_offset_ns.to_string()),
        ]
        .into_iter()
        .chain(continues)
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
    }

    /// Reads the metadata record of the log at `path`. Rejects other log formats.
    pub(crate) fn from_metadata(values: &BTreeMap<String, String>, path: &Path) -> Result<Self> {
        // Every text is shown to an operator, and another program may have written it.
        let values: BTreeMap<&str, String> = values
            .iter()
            .map(|(key, value)| (key.as_str(), printable_line(value)))
            .collect();
        let value = |key: &str| {
            values.get(key).with_context(|| {
                format!("{}: its {PROJECT_NAME} record has no {key}", path.display())
            })
        };
        let (format, version) = (value("format")?, value("version")?);
        if *format != FORMAT_VERSION.to_string() {
            bail!(
                "{}: written by mirrorball {version} in log format {format}; this is mirrorball {}, which reads \
                 format {FORMAT_VERSION}",
                path.display(),
                env!("CARGO_PKG_VERSION")
            );
        }
        let seed = value("seed")?;
        let images = value("images")?;
        let clock_offset = values.get("clock_offset_ns").map_or("0", String::as_str);
        Ok(Header {
            version: version.clone(),
            source: value("source")?.clone(),
            seed: match seed.as_str() {
                "" => None,
                seed => Some(seed.parse().with_context(|| {
                    format!(
                        "{}: invalid seed: {seed:?} (expected a whole number)",
                        path.display()
                    )
                })?),
            },
            images: ImageCompression::from_name(images).with_context(|| {
                format!(
                    "{}: unknown image compression: {images:?} (expected png, jpeg or none)",
                    path.display()
                )
            })?,
            continues: values.get("continues").cloned(),
            clock_offset_ns: clock_offset.parse().with_context(|| {
                format!(
                    "{}: invalid clock_offset_ns: {clock_offset:?} (expected a whole number)",
                    path.display()
                )
            })?,
            files: BTreeMap::new(),
        })
    }
}
