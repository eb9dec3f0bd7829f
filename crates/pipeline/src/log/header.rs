//! What does a log say of its run before the first cycle? Version, seed and source, and the files it ran with.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use localize::robot::{MapConfig, RobotConfig};
use vision::GroundMap;
use vision::colour::colour_table::ColourTable;

use super::encoded_image::ImageCompression;
use super::schema::{FORMAT_VERSION, PROJECT_NAME, wire};
use crate::config::{PIPELINE_FILE, translate};

/// The name under which logs of version 0.1.0 hold the settings.
const OLD_PIPELINE_FILE: &str = "spine.toml";

/// The files of a log under the names of this version, settings with the keys of this version.
pub(super) fn translate_files(mut files: BTreeMap<String, Vec<u8>>) -> BTreeMap<String, Vec<u8>> {
    if let Some(settings) = files.remove(OLD_PIPELINE_FILE) {
        let settings = translate(&String::from_utf8_lossy(&settings));
        files
            .entry(PIPELINE_FILE.to_owned())
            .or_insert(settings.into_bytes());
    }
    files
}

/// What a log starts with.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// The version of mirrorball that wrote it.
    pub version: String,
    /// What ran: a command and its main argument.
    pub source: String,
    /// The seed of a simulation.
    pub seed: Option<u64>,
    /// How images are kept.
    pub images: ImageCompression,
    /// The files it ran with, by their names in a recording folder: robot.toml, field.toml, map.npz, mirror.csv, …
    ///
    /// robot.toml names the others by these names, so that they stand for themselves wherever they are put.
    pub files: BTreeMap<String, Vec<u8>>,
}

impl Header {
    /// The header of a run of this version, still without files.
    pub fn new(source: &str, seed: Option<u64>) -> Self {
        Header {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            source: source.to_owned(),
            seed,
            images: ImageCompression::Png,
            files: BTreeMap::new(),
        }
    }

    /// Adds a file's content under a name.
    pub fn with_file(mut self, name: &str, content: impl Into<Vec<u8>>) -> Self {
        self.files.insert(name.to_owned(), content.into());
        self
    }

    /// Adds robot.toml with the files that it names, under the names they have in a recording folder.
    ///
    /// `map`: what vision measures with, whichever it came from; replay measures with its very bits.
    /// `colours`: the table it learned from labels, if it did.
    pub fn with_robot(
        self,
        robot: &RobotConfig,
        map: Option<&GroundMap>,
        colours: Option<&ColourTable>,
    ) -> Result<Self> {
        let read = |path: &Path| {
            std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
        };
        let mut own = robot.clone();
        let mut header = self.with_file("field.toml", read(&robot.field)?);
        own.field = "field.toml".into();
        if let Some(mirror) = &mut own.mirror {
            header = header.with_file("mirror.csv", read(&mirror.profile)?);
            mirror.profile = "mirror.csv".into();
        }
        if let Some(map) = map {
            header = header.with_file("map.npz", map.to_npz().context("cannot pack the map")?);
        }
        own.map = map.map(|_| MapConfig {
            file: "map.npz".into(),
        });
        if let Some(mask) = &mut own.mask {
            header = header.with_file("mask.png", read(mask)?);
            *mask = "mask.png".into();
        }
        // The labels' images stay where they are; what was learned from them goes along.
        own.labels = None;
        own.colours = colours.map(|_| "colours.table".into());
        if let Some(colours) = colours {
            header = header.with_file("colours.table", colours.to_bytes());
        }
        Ok(header.with_file("robot.toml", toml::to_string(&own)?))
    }

    /// Why bits may differ from what this program computes, though the log can be read.
    pub fn version_mismatch(&self) -> Option<String> {
        let own = env!("CARGO_PKG_VERSION");
        (self.version != own).then(|| {
            format!(
                "written by mirrorball {}, this is {own}: what is recomputed may differ",
                self.version
            )
        })
    }

    /// Writes the files into a folder.
    pub fn write_files(&self, folder: &Path) -> Result<()> {
        for (name, content) in &self.files {
            if name.is_empty() || name.starts_with('.') || name.contains(['/', '\\', '\0']) {
                bail!("the log holds a file {name:?}, which is no plain file name");
            }
            let path = folder.join(name);
            std::fs::write(&path, content)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    /// The message with which a live stream greets.
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

    /// Reads the greeting of the stream at `place`; one of another form is refused.
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

    /// The metadata record; the files go as attachments.
    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        let seed = self.seed.map_or_else(String::new, |seed| seed.to_string());
        [
            ("format", FORMAT_VERSION.to_string()),
            ("version", self.version.clone()),
            ("source", self.source.clone()),
            ("seed", seed),
            ("images", self.images.name().to_owned()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    /// Reads the metadata record of the log at `path`; one of another form is refused.
    pub(crate) fn from_metadata(values: &BTreeMap<String, String>, path: &Path) -> Result<Self> {
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
        Ok(Header {
            version: version.clone(),
            source: value("source")?.clone(),
            seed: match seed.as_str() {
                "" => None,
                seed => Some(
                    seed.parse()
                        .with_context(|| format!("{}: seed {seed:?}", path.display()))?,
                ),
            },
            images: ImageCompression::from_name(images).with_context(|| {
                format!(
                    "{}: keeps images as {images:?}, which is unknown",
                    path.display()
                )
            })?,
            files: BTreeMap::new(),
        })
    }
}
