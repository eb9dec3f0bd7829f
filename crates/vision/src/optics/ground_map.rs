//! The ground map: for each pixel its ground point, traced from a mirror profile or calibrated.

use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use localize::frames::{At, RobotFrame};
use localize::input_file;
use localize::math;
use npyz::{NpyFile, WriteOptions, WriterBuilder};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use crate::image::PIXELS_MAX;
use crate::output_file::write_file;

/// Largest array of a map with its header, bytes.
const BYTES_MAX: u64 = 4 * PIXELS_MAX as u64 + 65_536;
/// Longest header of an array, bytes: numpy writes 118.
const NPY_HEADER_MAX: usize = 4096;

/// Pixel → ground point in the robot frame, for an upright robot.
///
/// ```
/// use vision::GroundMap;
///
/// // Two pixels, 1 m ahead and 2 m ahead; ground between them is interpolated.
/// let map = GroundMap { width_px: 2, height_px: 1, x: vec![1.0, 2.0], y: vec![0.0, 0.0] };
/// assert_eq!(map.at(1, 0).map(|ground| ground.x), Some(2.0));
/// assert_eq!(map.interpolate(0.25, 0.0).map(|ground| ground.x), Some(1.25));
/// assert_eq!(map.at(2, 0), None);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct GroundMap {
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// Forward, metres, row by row; NaN if the pixel shows no ground.
    pub x: Vec<f32>,
    /// To the left, metres, row by row; NaN if the pixel shows no ground.
    pub y: Vec<f32>,
}

/// Why a map cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum GroundMapError {
    /// The file cannot be opened, read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// An array is missing or has the wrong type or shape.
    #[error("{}: {reason}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

impl GroundMap {
    /// Distance of the nearest ground that the map shows, metres; infinite if it shows none.
    pub fn nearest_ground(&self) -> f32 {
        let ranges = self.x.iter().zip(&self.y).map(|(x, y)| math::hypot(*x, *y));
        ranges.fold(f32::INFINITY, f32::min)
    }

    /// Distance of the farthest ground within a circle of the image (pixels), metres; 0 if none is shown there.
    pub(crate) fn farthest_ground_within(&self, [cu, cv]: [f32; 2], radius_px: f32) -> f32 {
        let within = |index: usize| {
            let (u, v) = (index % self.width_px, index / self.width_px);
            math::hypot(u as f32 - cu, v as f32 - cv) <= radius_px
        };
        let shown = self.x.iter().zip(&self.y).enumerate();
        let ranges = shown.filter(|(index, _)| within(*index));
        // `max` passes over NaN.
        ranges.fold(0.0, |farthest, (_, (x, y))| {
            f32::max(farthest, math::hypot(*x, *y))
        })
    }

    /// Ground point of the pixel's centre.
    pub fn at(&self, column: usize, row: usize) -> Option<At<RobotFrame>> {
        if column >= self.width_px || row >= self.height_px {
            return None;
        }
        let index = row * self.width_px + column;
        let (x, y) = (self.x[index], self.y[index]);
        (x.is_finite() && y.is_finite()).then(|| At::new(x, y))
    }

    /// Ground point between pixel centres, bilinear. None if any of the four neighbours shows no ground.
    pub fn interpolate(&self, u: f32, v: f32) -> Option<At<RobotFrame>> {
        let (u0, v0) = (u.floor(), v.floor());
        if !(u0 >= 0.0 && v0 >= 0.0) {
            return None;
        }
        let (column, row) = (u0 as usize, v0 as usize);
        let (fu, fv) = (u - u0, v - v0);
        let next_column = if fu > 0.0 { column + 1 } else { column };
        let next_row = if fv > 0.0 { row + 1 } else { row };
        let p00 = self.at(column, row)?;
        let p10 = self.at(next_column, row)?;
        let p01 = self.at(column, next_row)?;
        let p11 = self.at(next_column, next_row)?;
        let mix = |a: f32, b: f32, c: f32, d: f32| {
            (a + fu * (b - a)) * (1.0 - fv) + (c + fu * (d - c)) * fv
        };
        Some(At::new(
            mix(p00.x, p10.x, p01.x, p11.x),
            mix(p00.y, p10.y, p01.y, p11.y),
        ))
    }

    /// The pixel (column, row) whose ground is nearest to a ground point; None if none lies within `distance_max` metres.
    pub fn nearest_pixel(&self, ground: At<RobotFrame>, distance_max: f32) -> Option<[f32; 2]> {
        let (mut nearest, mut pixel) = (distance_max, None);
        for row in 0..self.height_px {
            for column in 0..self.width_px {
                let Some(here) = self.at(column, row) else {
                    continue;
                };
                let distance = math::hypot(here.x - ground.x, here.y - ground.y);
                if distance < nearest {
                    (nearest, pixel) = (distance, Some([column as f32, row as f32]));
                }
            }
        }
        pixel
    }

    /// Reads `x_m` and `y_m` (float32, rows × columns) from an npz archive.
    pub fn load(path: &Path) -> Result<Self, GroundMapError> {
        Self::load_array_pair(path, None)
    }

    /// As [`GroundMap::load`] for a camera of that many columns and rows. Another size is refused before its arrays are read.
    pub fn load_for_camera(
        path: &Path,
        [width_px, height_px]: [usize; 2],
    ) -> Result<Self, GroundMapError> {
        Self::load_array_pair(path, Some(([height_px, width_px], "the camera")))
    }

    fn load_array_pair(
        path: &Path,
        shape: Option<([usize; 2], &str)>,
    ) -> Result<Self, GroundMapError> {
        let file = |source| GroundMapError::File {
            path: path.to_owned(),
            source,
        };
        let reader = BufReader::new(input_file::open(path).map_err(file)?);
        let mut archive = ZipArchive::new(reader).map_err(|error| match error {
            ZipError::Io(source) => file(source),
            _ => GroundMapError::Content {
                path: path.to_owned(),
                reason: "no npz archive (expected a map of `mirrorball calibrate`)".into(),
            },
        })?;
        let (x, shape) = read_array(&mut archive, path, "x_m", shape)?;
        let (y, [height_px, width_px]) =
            read_array(&mut archive, path, "y_m", Some((shape, "x_m")))?;
        Ok(GroundMap {
            width_px,
            height_px,
            x,
            y,
        })
    }

    /// Writes the npz archive atomically.
    pub fn save(&self, path: &Path) -> Result<(), GroundMapError> {
        let file = |source| GroundMapError::File {
            path: path.to_owned(),
            source,
        };
        // Packed first: an archive on a full disk hides the reason behind its own.
        let bytes = self.to_npz().map_err(file)?;
        write_file(path, bytes).map_err(file)
    }

    /// The npz archive as bytes.
    pub fn to_npz(&self) -> std::io::Result<Vec<u8>> {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, values) in [("x_m", &self.x), ("y_m", &self.y)] {
            archive.start_file(member_name(name), SimpleFileOptions::default())?;
            let mut writer = WriteOptions::new()
                .default_dtype()
                .shape(&[self.height_px as u64, self.width_px as u64])
                .writer(&mut archive)
                .begin_nd()?;
            writer.extend(values.iter())?;
            writer.finish()?;
        }
        Ok(archive.finish()?.into_inner())
    }
}

/// Name of an array's member of the archive.
fn member_name(array: &str) -> String {
    format!("{array}.npy")
}

/// Magic, version, length and text of an npy file's header.
///
/// The header is a literal of Python, and the time to parse nested brackets doubles with each of them. A header of plain numbers
/// has one pair inside another: the shape in the dictionary.
fn read_npy_header(reader: &mut impl Read) -> std::io::Result<Vec<u8>> {
    let invalid = |reason: &str| std::io::Error::new(std::io::ErrorKind::InvalidData, reason);
    let mut header = vec![0; 8];
    reader.read_exact(&mut header)?;
    // From version 2 on the length has four bytes.
    let mut length = [0; 4];
    let digits = if header[6] < 2 { 2 } else { 4 };
    reader.read_exact(&mut length[..digits])?;
    header.extend(&length[..digits]);
    let count = u32::from_le_bytes(length) as usize;
    if count > NPY_HEADER_MAX {
        return Err(invalid("the header is too long"));
    }
    let start = header.len();
    header.resize(start + count, 0);
    reader.read_exact(&mut header[start..])?;
    let mut depth = 0usize;
    for byte in &header[start..] {
        match byte {
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > 2 {
            return Err(invalid(
                "the header is nested (expected an array of numbers)",
            ));
        }
    }
    Ok(header)
}

fn read_array(
    archive: &mut ZipArchive<BufReader<File>>,
    path: &Path,
    name: &str,
    expected: Option<([usize; 2], &str)>,
) -> Result<(Vec<f32>, [usize; 2]), GroundMapError> {
    let content = |reason: String| GroundMapError::Content {
        path: path.to_owned(),
        reason,
    };
    let entry = archive
        .by_name(&member_name(name))
        .map_err(|error| content(format!("{name}: {error} (expected arrays x_m and y_m)")))?;
    // An archive may unpack to far more than its size.
    let mut entry = entry.take(BYTES_MAX);
    let found = read_npy_header(&mut entry)
        .and_then(|header| NpyFile::new(Cursor::new(header).chain(entry)))
        .map_err(|error| content(format!("{name}: {error}")))?;
    let &[rows, columns] = found.shape() else {
        return Err(content(format!(
            "wrong shape of {name}: {} dimensions (expected rows × columns)",
            found.shape().len()
        )));
    };
    if found.order() != npyz::Order::C {
        return Err(content(format!(
            "wrong order of {name}: column by column (expected row by row)"
        )));
    }
    let pixels = rows.saturating_mul(columns);
    if pixels > PIXELS_MAX as u64 {
        return Err(content(format!(
            "{name} is too large: {rows} × {columns} (expected at most {PIXELS_MAX} pixels)"
        )));
    }
    let shape = [rows as usize, columns as usize];
    if let Some((expected, source)) = expected.filter(|(expected, _)| *expected != shape) {
        return Err(content(format!(
            "wrong shape of {name}: {rows} × {columns} (expected {} × {} rows × columns, as {source})",
            expected[0], expected[1]
        )));
    }
    let values = found
        .into_vec::<f32>()
        .map_err(|error| content(format!("{name}: {error} (expected float32)")))?;
    Ok((values, shape))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nested_header_is_refused_at_once() {
        let map = GroundMap {
            width_px: 1,
            height_px: 1,
            x: vec![1.0],
            y: vec![2.0],
        };
        let mut plain = Vec::new();
        ZipArchive::new(Cursor::new(map.to_npz().expect("bytes")))
            .and_then(|mut archive| Ok(archive.by_name("x_m.npy")?.read_to_end(&mut plain)?))
            .expect("an array");
        assert!(read_npy_header(&mut &plain[..]).is_ok());
        let mut nested = plain.clone();
        let start = plain
            .iter()
            .position(|&byte| byte == b'{')
            .expect("a dictionary")
            + 1;
        nested[start..start + 28].fill(b'[');
        let error = read_npy_header(&mut &nested[..]).expect_err("nested");
        assert!(error.to_string().contains("nested"), "{error}");
    }

    #[test]
    fn saved_map_round_trips_bit_exactly() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("map.npz");
        let map = GroundMap {
            width_px: 3,
            height_px: 2,
            x: vec![1.0, -2.5, f32::NAN, 0.1, 0.2, 0.3],
            y: vec![0.0, 7.25, f32::NAN, 1.1, 1.2, 1.3],
        };
        map.save(&path).expect("saved");
        let bytes = std::fs::read(&path).expect("a file");
        assert_eq!(map.to_npz().expect("bytes"), bytes);
        let back = GroundMap::load(&path).expect("loaded");
        assert_eq!((back.width_px, back.height_px), (3, 2));
        for (a, b) in map.x.iter().chain(&map.y).zip(back.x.iter().chain(&back.y)) {
            assert_eq!(a.to_bits(), b.to_bits());
        }
        assert!(GroundMap::load_for_camera(&path, [3, 2]).is_ok());
        let error = GroundMap::load_for_camera(&path, [2, 3]).expect_err("another camera");
        assert!(
            error.to_string().contains("wrong shape of x_m: 2 × 3"),
            "{error}"
        );
        assert_eq!(back.at(2, 0), None);
        assert_eq!(back.interpolate(0.5, 0.0).map(|p| p.x), Some(-0.75));
    }
}
