//! Colour tables learned from labelled pixels, and their file format.
//!
//! lima2001 3.1: a table over (U, V); minho2016 III: a table over all 24 bits of (Y, U, V), 16 MiB. Both are learned from
//! the same labels: each class is a normal distribution, inflated for noise and changes of light.

use std::path::Path;

use localize::input_file::{self, TEXT_BYTES_MAX};
use localize::math;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::colour::lookup_table::{CLASS_NAMES, ColourClass};
use crate::csv_error;
use crate::error::VisionError;
use crate::image::{Image, rgb_to_yuv};
use crate::output_file::write_file;

/// Channels that a table depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableKind {
    /// U and V: 64 KiB, independent of brightness.
    Uv,
    /// Y, U and V: 16 MiB.
    Yuv,
}

/// A class for every colour.
#[derive(Clone, PartialEq, Eq)]
pub struct ColourTable {
    kind: TableKind,
    /// Names of the classes, by class.
    names: Vec<String>,
    classes: Vec<u8>,
}

impl std::fmt::Debug for ColourTable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ColourTable")
            .field("kind", &self.kind)
            .field("names", &self.names)
            .finish_non_exhaustive()
    }
}

/// One labelled colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Label {
    /// Red, green, blue.
    pub rgb: [u8; 3],
    /// Class name: one of [`CLASS_NAMES`], a synonym (green, line, orange), or any other name.
    pub class: String,
}

/// Magic bytes of the file.
const MAGIC: &[u8; 8] = b"MBCOLOUR";

/// Largest file: 16 MiB of classes, and names.
const FILE_BYTES_MAX: u64 = 17 << 20;

/// Version of the file format.
const VERSION: u32 = 1;

/// Neighbours up to this distance get the same label, pixels.
const LABEL_RADIUS_PX: i64 = 1;

/// Standard deviation added to each class, levels: light changes brightness more than chroma.
const CLASS_STD_INFLATION: [f64; 3] = [18.0, 5.0, 5.0];

/// A colour with a larger Mahalanobis distance from every class belongs to none.
const MAHALANOBIS_MAX: f64 = 4.0;

/// Reads `file,u,v,class` and the pixels' colours from the images; files relative to the list.
pub fn load_labels(path: &Path) -> Result<Vec<Label>, VisionError> {
    let refuse = |reason: String| VisionError::File {
        path: path.to_owned(),
        reason,
    };
    let text = input_file::read(path, TEXT_BYTES_MAX).map_err(|error| refuse(error.to_string()))?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_slice());
    let refuse_line = |error: csv::Error| {
        let line = csv_error::line(&error);
        refuse(format!("line {line}: {}", csv_error::reason(&error)))
    };
    let header = reader.headers().map_err(refuse_line)?;
    if header.iter().ne(["file", "u", "v", "class"]) {
        let found = header.iter().collect::<Vec<_>>().join(",");
        return Err(refuse(format!(
            "line 1: wrong header: {found:?} (expected file,u,v,class)"
        )));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut labels = Vec::new();
    let mut open: Option<(String, Image)> = None;
    for record in reader.records() {
        let record = record.map_err(refuse_line)?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |column: usize| {
            record[column]
                .parse::<i64>()
                .map_err(|error| refuse(format!("line {line}: {:?}: {error}", &record[column])))
        };
        let (u, v) = (number(1)?, number(2)?);
        let image = match &open {
            Some((file, image)) if *file == record[0] => image,
            _ => {
                let image = Image::load(&folder.join(&record[0]))?;
                &open.insert((record[0].to_owned(), image)).1
            }
        };
        let (width, height) = (image.width_px as i64, image.height_px as i64);
        if !(0..width).contains(&u) || !(0..height).contains(&v) {
            return Err(refuse(format!(
                "line {line}: pixel outside the image: ({u}, {v}) of {}",
                &record[0]
            )));
        }
        for (du, dv) in (-LABEL_RADIUS_PX..=LABEL_RADIUS_PX)
            .flat_map(|du| (-LABEL_RADIUS_PX..=LABEL_RADIUS_PX).map(move |dv| (du, dv)))
        {
            let (u, v) = ((u + du).clamp(0, width - 1), (v + dv).clamp(0, height - 1));
            labels.push(Label {
                rgb: image.view().rgb(u as usize, v as usize),
                class: record[3].to_owned(),
            });
        }
    }
    Ok(labels)
}

/// A class as a normal distribution over (Y, U, V).
struct ClassGaussian {
    class: u8,
    mean: Vector3<f64>,
    information: Matrix3<f64>,
    /// Logarithm of the covariance's determinant, for comparing densities.
    log_determinant: f64,
}

impl ColourTable {
    /// Learns a table from labels. None without labels.
    pub fn learn(labels: &[Label], kind: TableKind) -> Option<Self> {
        let mut names: Vec<String> = CLASS_NAMES.map(str::to_owned).to_vec();
        let mut members: Vec<Vec<Vector3<f64>>> = vec![Vec::new(); names.len()];
        for label in labels {
            let name = canonical_class_name(&label.class);
            let class = match names.iter().position(|known| known == name) {
                Some(class) => class,
                None if names.len() < 255 => {
                    names.push(name.to_owned());
                    members.push(Vec::new());
                    names.len() - 1
                }
                None => continue,
            };
            let [y, u, v] = rgb_to_yuv(label.rgb).map(f64::from);
            members[class].push(Vector3::new(y, u, v));
        }
        let gaussians: Vec<ClassGaussian> = members
            .iter()
            .enumerate()
            .filter_map(|(class, members)| fit_gaussian(class as u8, members, kind))
            .collect();
        if gaussians.is_empty() {
            return None;
        }
        let classes = match kind {
            TableKind::Uv => (0..1usize << 16)
                .map(|index| {
                    most_likely_class(&gaussians, [0, (index >> 8) as u8, index as u8], kind)
                })
                .collect(),
            TableKind::Yuv => (0..1usize << 24)
                .into_par_iter()
                .map(|index| {
                    most_likely_class(
                        &gaussians,
                        [(index >> 16) as u8, (index >> 8) as u8, index as u8],
                        kind,
                    )
                })
                .collect(),
        };
        Some(ColourTable {
            kind,
            names,
            classes,
        })
    }

    /// Builds a table from the classes of all its entries.
    pub(crate) fn from_classes(kind: TableKind, names: Vec<String>, classes: Vec<u8>) -> Self {
        ColourTable {
            kind,
            names,
            classes,
        }
    }

    /// Channels that the table depends on.
    pub fn kind(&self) -> TableKind {
        self.kind
    }

    /// Class of a colour (Y, U, V).
    pub fn class(&self, [y, u, v]: [u8; 3]) -> ColourClass {
        let chroma = usize::from(u) << 8 | usize::from(v);
        ColourClass(match self.kind {
            TableKind::Uv => self.classes[chroma],
            TableKind::Yuv => self.classes[usize::from(y) << 16 | chroma],
        })
    }

    /// Name of a class.
    pub fn name(&self, class: ColourClass) -> Option<&str> {
        self.names.get(usize::from(class.0)).map(String::as_str)
    }

    /// Serialises the table in its file format.
    pub fn to_bytes(&self) -> Vec<u8> {
        let names = self.names.join("\n");
        let kind = u32::from(self.kind == TableKind::Yuv);
        let mut bytes = MAGIC.to_vec();
        for number in [VERSION, kind, names.len() as u32] {
            bytes.extend(number.to_le_bytes());
        }
        bytes.extend(names.as_bytes());
        bytes.extend(&self.classes);
        bytes
    }

    /// Writes the table atomically.
    pub fn save(&self, path: &Path) -> Result<(), VisionError> {
        let refuse = |error: std::io::Error| VisionError::File {
            path: path.to_owned(),
            reason: error.to_string(),
        };
        write_file(path, self.to_bytes()).map_err(refuse)
    }

    /// Reads a table. Errors on another version or a truncated file.
    pub fn load(path: &Path) -> Result<Self, VisionError> {
        let refuse = |reason: String| VisionError::File {
            path: path.to_owned(),
            reason,
        };
        let bytes =
            input_file::read(path, FILE_BYTES_MAX).map_err(|error| refuse(error.to_string()))?;
        ColourTable::from_bytes(&bytes).map_err(refuse)
    }

    /// The table of a file's content. The error is the reason why it is none.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let truncated = || "truncated file".to_owned();
        let rest = bytes
            .strip_prefix(MAGIC)
            .ok_or_else(|| "not a colour table".to_owned())?;
        let number = |place: usize| {
            let four = rest.get(4 * place..4 * place + 4)?;
            Some(u32::from_le_bytes(four.try_into().ok()?))
        };
        let version = number(0).ok_or_else(truncated)?;
        if version != VERSION {
            return Err(format!(
                "unsupported version: {version} (expected {VERSION})"
            ));
        }
        let kind = match number(1).ok_or_else(truncated)? {
            0 => TableKind::Uv,
            _ => TableKind::Yuv,
        };
        let length = number(2).ok_or_else(truncated)? as usize;
        let names = rest.get(12..12 + length).ok_or_else(truncated)?;
        let names = String::from_utf8(names.to_vec()).map_err(|error| error.to_string())?;
        let classes = rest[12 + length..].to_vec();
        let expected_len = match kind {
            TableKind::Uv => 1 << 16,
            TableKind::Yuv => 1 << 24,
        };
        if classes.len() != expected_len {
            return Err(truncated());
        }
        Ok(ColourTable {
            kind,
            names: names.split('\n').map(str::to_owned).collect(),
            classes,
        })
    }
}

/// Maps synonyms to the built-in class names.
pub fn canonical_class_name(name: &str) -> &str {
    match name {
        "green" | "field" => "carpet",
        "line" => "white",
        "orange" => "ball",
        other => other,
    }
}

fn fit_gaussian(class: u8, members: &[Vector3<f64>], kind: TableKind) -> Option<ClassGaussian> {
    if members.is_empty() {
        return None;
    }
    let count = members.len() as f64;
    let mean = members.iter().sum::<Vector3<f64>>() / count;
    let mut covariance = members
        .iter()
        .map(|member| (member - mean) * (member - mean).transpose())
        .sum::<Matrix3<f64>>()
        / count;
    for (i, widen) in CLASS_STD_INFLATION.iter().enumerate() {
        covariance[(i, i)] += widen * widen;
    }
    if kind == TableKind::Uv {
        // Ignore brightness: no correlation, and the same variance for all classes.
        for i in 1..3 {
            covariance[(0, i)] = 0.0;
            covariance[(i, 0)] = 0.0;
        }
        covariance[(0, 0)] = 1.0;
    }
    Some(ClassGaussian {
        class,
        mean,
        information: covariance.try_inverse()?,
        log_determinant: math::ln(covariance.determinant()),
    })
}

fn most_likely_class(gaussians: &[ClassGaussian], yuv: [u8; 3], kind: TableKind) -> u8 {
    let [y, u, v] = yuv.map(f64::from);
    let mut best = (f64::INFINITY, ColourClass::OTHER.0);
    for gaussian in gaussians {
        let mut difference = Vector3::new(y, u, v) - gaussian.mean;
        if kind == TableKind::Uv {
            difference[0] = 0.0;
        }
        let squared = (difference.transpose() * gaussian.information * difference)[(0, 0)];
        let cost = squared + gaussian.log_determinant;
        if squared <= MAHALANOBIS_MAX * MAHALANOBIS_MAX && cost < best.0 {
            best = (cost, gaussian.class);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> Vec<Label> {
        let label = |rgb, class: &str| Label {
            rgb,
            class: class.to_owned(),
        };
        vec![
            label([60, 140, 70], "green"),
            label([70, 150, 80], "carpet"),
            label([230, 230, 230], "line"),
            label([240, 120, 30], "ball"),
            label([120, 60, 160], "banner"),
        ]
    }

    #[test]
    fn labelled_colours_are_classified_as_labelled() {
        for kind in [TableKind::Uv, TableKind::Yuv] {
            let table = ColourTable::learn(&labels(), kind).expect("a table");
            let class = |rgb| table.class(rgb_to_yuv(rgb));
            assert_eq!(class([65, 146, 76]), ColourClass::CARPET);
            assert_eq!(class([225, 228, 231]), ColourClass::WHITE);
            assert_eq!(class([238, 125, 33]), ColourClass::BALL);
            assert_eq!(table.name(class([121, 61, 158])), Some("banner"));
        }
    }

    #[test]
    fn saved_table_round_trips_and_other_versions_are_rejected() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("colours.bin");
        let table = ColourTable::learn(&labels(), TableKind::Uv).expect("a table");
        table.save(&path).expect("saved");
        assert_eq!(ColourTable::load(&path).expect("loaded"), table);
        let mut bytes = std::fs::read(&path).expect("read");
        bytes[8] = 7;
        std::fs::write(&path, &bytes).expect("written");
        let message = ColourTable::load(&path).expect_err("version").to_string();
        assert!(message.contains("version: 7 (expected 1)"), "{message}");
    }
}
