//! What does a recording folder contain? CSV files and images, read as stamped samples ordered by time.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use localize::frames::At;
use localize::sample::{Compass, Imu, LinePoint, Odometry};
use localize::{Pose, Stamp};
use vision::{CommonOrientation, Image, Orientation, VisionError};

use crate::csv_table::{CsvRow, CsvTable};
use crate::sample::{CameraImage, GroundTruth, ImageContent, Sample};
use crate::score::detections::{GroundTruthKind, GroundTruthObject};

/// A recording folder as an iterator of samples. Tables are read when it is opened, images one by one.
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use std::path::Path;
///
/// use pipeline::recording::Recording;
/// use pipeline::sample::Sample;
///
/// let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../samples/sequence");
/// let recording = Recording::open(&folder, 0.04)?;
/// assert_eq!(recording.frames(), 20);
/// let images = recording.filter(|sample| matches!(sample, Sample::Image(_)));
/// assert_eq!(images.count(), 20);
/// # Ok(())
/// # }
/// ```
pub struct Recording {
    /// Path of the folder.
    pub folder: PathBuf,
    /// True poses, for scoring. Empty without truth.csv.
    pub truth: Vec<GroundTruth>,
    /// True positions of ball, robots and people, for scoring. Empty without objects.csv.
    pub objects: BTreeMap<Stamp, Vec<GroundTruthObject>>,
    events: std::vec::IntoIter<RecordedSample>,
    frames: usize,
    /// Tables of which only one is used.
    notice: Option<String>,
    images: ImageLoader,
}

/// Loads the images of one camera in their order.
#[derive(Debug, Clone, Default)]
pub(crate) struct ImageLoader {
    orientation: CommonOrientation,
}

impl ImageLoader {
    /// An image whose EXIF orientation is that of the images before.
    pub(crate) fn load(&mut self, path: &Path) -> Result<Image, String> {
        self.accept(path, Image::load_with_orientation(path))
    }

    /// As [`ImageLoader::load`], of a file that was read already.
    pub(crate) fn accept(
        &mut self,
        path: &Path,
        loaded: Result<(Image, Orientation), VisionError>,
    ) -> Result<Image, String> {
        let (image, orientation) = loaded.map_err(|error| error.to_string())?;
        self.orientation
            .check(&path.display().to_string(), orientation)?;
        Ok(image)
    }
}

/// A table of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Table {
    /// frames.csv or points.csv.
    Images,
    /// odometry.csv.
    Odometry,
    /// compass.csv.
    Compass,
    /// imu.csv.
    Imu,
}

pub(crate) struct RecordedSample {
    pub(crate) stamp: Stamp,
    pub(crate) data: RecordedData,
}

// Samples of equal stamps are yielded in this order: motion before images.
pub(crate) enum RecordedData {
    Odometry(Odometry),
    Compass(Compass),
    Imu(Imu),
    Truth(GroundTruth),
    Image(PathBuf),
    Points(Vec<LinePoint>),
}

impl RecordedData {
    fn order(&self) -> u8 {
        match self {
            RecordedData::Imu(_) => 0,
            RecordedData::Odometry(_) => 1,
            RecordedData::Compass(_) => 2,
            RecordedData::Truth(_) => 3,
            RecordedData::Image(_) | RecordedData::Points(_) => 4,
        }
    }
}

/// Names of the files that a recording is read from. Results must have other names.
pub const INPUT_FILES: [&str; 11] = [
    "robot.toml",
    "field.toml",
    "frames.csv",
    "points.csv",
    "odometry.csv",
    "imu.csv",
    "compass.csv",
    "magnetometer.csv",
    "truth.csv",
    "objects.csv",
    "object_labels.csv",
];

impl Recording {
    /// Reads the tables. A malformed table is an error that names the line. Optional tables may be absent.
    ///
    /// `point_std`: standard deviation of line points from another vision system (points.csv has none), metres.
    pub fn open(folder: &Path, point_std: f32) -> Result<Self> {
        let mut events = Vec::new();
        let (images, points) = (folder.join("frames.csv"), folder.join("points.csv"));
        if points.exists() {
            events.extend(read_points(&points, point_std)?);
        } else if images.exists() {
            events.extend(read_images(&images, folder)?);
        } else {
            bail!(
                "{} is no recording: it has neither frames.csv nor points.csv",
                folder.display()
            );
        }
        let notice = (points.exists() && images.exists()).then(|| {
            format!(
                "{} has points.csv and frames.csv: the line points of points.csv are used, and no image is",
                folder.display()
            )
        });
        let frames = events.len();
        if frames == 0 {
            bail!(
                "{} has no frame",
                if points.exists() { points } else { images }.display()
            );
        }
        let mut truth = read_truth(folder)?;
        let objects = read_objects(folder)?;
        for row in &mut truth {
            let objects = objects.get(&row.stamp).map_or(&[][..], Vec::as_slice);
            let of = |kind| objects.iter().filter(move |object| object.kind == kind);
            row.ball = of(GroundTruthKind::Ball).next().map(|ball| ball.at);
            row.robots = of(GroundTruthKind::Robot).map(|robot| robot.at).collect();
            let headings = of(GroundTruthKind::Robot).map(|robot| robot.heading);
            row.robot_headings = headings.collect::<Option<_>>().unwrap_or_default();
            row.people = of(GroundTruthKind::Person)
                .map(|person| person.at)
                .collect();
        }
        events.extend(truth.iter().map(|truth| RecordedSample {
            stamp: truth.stamp,
            data: RecordedData::Truth(truth.clone()),
        }));
        events.extend(read_odometry(folder)?);
        if let Some(table) =
            read_optional_table(folder, "compass.csv", &["stamp_s", "heading_rad"])?
        {
            let fields = read_magnetic_fields(folder)?;
            for row in table.rows() {
                let [heading] = parse_floats(row, ["heading_rad"])?;
                let stamp = parse_stamp(row)?;
                let compass = Compass {
                    stamp,
                    heading,
                    magnetic_field: fields.get(&stamp).copied(),
                };
                events.push(RecordedSample {
                    stamp: compass.stamp,
                    data: RecordedData::Compass(compass),
                });
            }
        }
        events.extend(read_imu(folder)?);
        events.sort_by_key(|event| (event.stamp, event.data.order()));
        Ok(Recording {
            folder: folder.to_owned(),
            truth,
            objects,
            events: events.into_iter(),
            frames,
            notice,
            images: ImageLoader::default(),
        })
    }

    /// Which table is used where another one is not.
    pub fn notice(&self) -> Option<&str> {
        self.notice.as_deref()
    }

    /// Number of images (or of sets of line points).
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Leaves out all samples of a table.
    pub(crate) fn leave_out(&mut self, table: Table) {
        let events = std::mem::take(&mut self.events);
        let kept = events.filter(|event| match event.data {
            RecordedData::Odometry(_) => table != Table::Odometry,
            RecordedData::Compass(_) => table != Table::Compass,
            RecordedData::Imu(_) => table != Table::Imu,
            RecordedData::Truth(_) | RecordedData::Image(_) | RecordedData::Points(_) => true,
        });
        self.events = kept.collect::<Vec<_>>().into_iter();
    }

    /// Files of the images that are still to come, relative to the folder.
    pub(crate) fn image_files(&self) -> BTreeMap<Stamp, PathBuf> {
        let events = self.remaining_samples().iter();
        let files = events.filter_map(|event| match &event.data {
            RecordedData::Image(path) => Some((event.stamp, self.relative(path).to_owned())),
            _ => None,
        });
        files.collect()
    }

    /// A file of the folder without the folder's path.
    pub(crate) fn relative<'a>(&self, path: &'a Path) -> &'a Path {
        path.strip_prefix(&self.folder).unwrap_or(path)
    }

    /// The samples that are still to come, images as paths.
    pub(crate) fn remaining_samples(&self) -> &[RecordedSample] {
        self.events.as_slice()
    }
}

impl Iterator for Recording {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        let RecordedSample { stamp, data } = self.events.next()?;
        let content = match data {
            RecordedData::Odometry(odometry) => return Some(Sample::Odometry(odometry)),
            RecordedData::Compass(compass) => return Some(Sample::Compass(compass)),
            RecordedData::Imu(imu) => return Some(Sample::Imu(imu)),
            RecordedData::Truth(truth) => return Some(Sample::GroundTruth(truth)),
            RecordedData::Points(points) => ImageContent::Features {
                points,
                goals: Vec::new(),
            },
            RecordedData::Image(path) => match self.images.load(&path) {
                Ok(image) => ImageContent::Pixels(image.into()),
                Err(reason) => ImageContent::Unreadable(reason),
            },
        };
        Some(Sample::Image(CameraImage {
            stamp,
            setting: None,
            content,
        }))
    }
}

/// Images of frames.csv.
fn read_images(table: &Path, folder: &Path) -> Result<Vec<RecordedSample>> {
    let mut images: Vec<RecordedSample> = Vec::new();
    for row in CsvTable::read(table, &["stamp_s", "file"])?.rows() {
        let stamp = parse_stamp(row)?;
        if images.last().is_some_and(|last| stamp < last.stamp) {
            bail!("{}: stamp_s goes back in time", row.location());
        }
        images.push(RecordedSample {
            stamp,
            data: RecordedData::Image(folder.join(row.text("file")?)),
        });
    }
    let pairs = images.windows(2);
    let repeated = pairs.filter(|pair| pair[0].stamp == pair[1].stamp).count();
    if 2 * repeated >= images.len() {
        bail!(
            "{}: {repeated} of {} images have the stamp_s of the image before (expected the time of each exposure, seconds)",
            table.display(),
            images.len()
        );
    }
    Ok(images)
}

/// Motions of odometry.csv. Each row is the motion since the previous row, so the order of rows matters.
fn read_odometry(folder: &Path) -> Result<Vec<RecordedSample>> {
    let columns = ["stamp_s", "dx_m", "dy_m", "dtheta_rad"];
    let Some(table) = read_optional_table(folder, "odometry.csv", &columns)? else {
        return Ok(Vec::new());
    };
    let mut motions: Vec<Odometry> = Vec::new();
    let mut repeated: Vec<String> = Vec::new();
    for row in table.rows() {
        let odometry = parse_odometry(row)?;
        if let Some(last) = motions.last() {
            if odometry.stamp < last.stamp {
                bail!("{}: stamp_s goes back in time", row.location());
            }
            if odometry == *last && odometry.path() > 0.0 {
                repeated.push(row.location());
            }
        }
        motions.push(odometry);
    }
    let moving = motions.iter().filter(|row| row.path() > 0.0).count();
    // Coarse stamps repeat some rows of a steady drive.
    if let Some(first) = repeated.first()
        && 3 * repeated.len() > moving
    {
        bail!(
            "{first}: the row before again, stamp and all, like {} of the {moving} rows with motion: each row counts as another motion",
            repeated.len()
        );
    }
    let samples = motions.into_iter().map(|odometry| RecordedSample {
        stamp: odometry.stamp,
        data: RecordedData::Odometry(odometry),
    });
    Ok(samples.collect())
}

/// Magnetic fields of magnetometer.csv by stamp. They belong to the headings of compass.csv with equal stamps.
fn read_magnetic_fields(folder: &Path) -> Result<BTreeMap<Stamp, [f32; 2]>> {
    let Some(table) = read_optional_table(folder, "magnetometer.csv", &["stamp_s", "x", "y"])?
    else {
        return Ok(BTreeMap::new());
    };
    let rows = table.rows();
    rows.map(|row| Ok((parse_stamp(row)?, parse_floats(row, ["x", "y"])?)))
        .collect()
}

/// Columns of imu.csv: specific force and rate, axes of the robot (or of the unit, if robot.toml has its mounting).
pub const IMU_COLUMNS: [&str; 6] = [
    "ax_m_s2", "ay_m_s2", "az_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s",
];

/// Inertial readings of imu.csv.
fn read_imu(folder: &Path) -> Result<Vec<RecordedSample>> {
    let columns: Vec<&str> = std::iter::once("stamp_s").chain(IMU_COLUMNS).collect();
    let Some(table) = read_optional_table(folder, "imu.csv", &columns)? else {
        return Ok(Vec::new());
    };
    let rows = table.rows();
    rows.map(|row| {
        let [ax, ay, az, wx, wy, wz] = parse_floats(row, IMU_COLUMNS)?;
        let imu = Imu {
            stamp: parse_stamp(row)?,
            specific_force: [ax, ay, az],
            angular_velocity: [wx, wy, wz],
        };
        Ok(RecordedSample {
            stamp: imu.stamp,
            data: RecordedData::Imu(imu),
        })
    })
    .collect()
}

/// None without an entry of that name. A link that leads nowhere is an error: its table would be missing without a word.
pub(crate) fn read_optional_table(
    folder: &Path,
    name: &str,
    columns: &[&str],
) -> Result<Option<CsvTable>> {
    let path = folder.join(name);
    let entry = path.symlink_metadata();
    if entry.is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound) {
        return Ok(None);
    }
    CsvTable::read(&path, columns).map(Some)
}

pub(crate) fn parse_stamp(row: CsvRow<'_>) -> Result<Stamp> {
    let seconds = row.number("stamp_s")?;
    // 64 bits of nanoseconds span ±292 years.
    if seconds.abs() > 9e9 {
        let unit = match seconds.abs() {
            size if size < 9e12 => ": milliseconds? Divide by 1000",
            size if size < 9e15 => ": microseconds? Divide by 1000000",
            size if size < 9e18 => ": nanoseconds? Divide by 1000000000",
            _ => "",
        };
        let place = row.location();
        bail!("{place}: stamp_s = {seconds} is no time in seconds{unit}");
    }
    Ok(Stamp::from_seconds(seconds))
}

/// Largest motion in one row, metres and radians. A row may span a gap in time.
const MAX_ODOMETRY_STEP: f32 = 100.0;

fn parse_odometry(row: CsvRow<'_>) -> Result<Odometry> {
    let columns = ["dx_m", "dy_m", "dtheta_rad"];
    let [dx, dy, dtheta] = parse_floats(row, columns)?;
    for (value, column) in [dx, dy, dtheta].into_iter().zip(columns) {
        if value.abs() > MAX_ODOMETRY_STEP {
            bail!(
                "{}: {column} = {value}: no robot moves so far between two rows (expected {})",
                row.location(),
                if column == "dtheta_rad" {
                    "radians"
                } else {
                    "metres"
                }
            );
        }
    }
    Ok(Odometry {
        stamp: parse_stamp(row)?,
        dx,
        dy,
        dtheta,
        slip: 0.0,
    })
}

fn parse_floats<const N: usize>(row: CsvRow<'_>, columns: [&str; N]) -> Result<[f32; N]> {
    let mut values = [0.0; N];
    for (value, column) in values.iter_mut().zip(columns) {
        *value = row.number(column)? as f32;
    }
    Ok(values)
}

/// Line points of another vision system. Rows with equal stamps form one image.
fn read_points(path: &Path, point_std: f32) -> Result<Vec<RecordedSample>> {
    let mut frames: BTreeMap<Stamp, Vec<LinePoint>> = BTreeMap::new();
    for row in CsvTable::read(path, &["stamp_s", "x_m", "y_m"])?.rows() {
        let [x, y] = parse_floats(row, ["x_m", "y_m"])?;
        let point = LinePoint {
            at: At::new(x, y),
            std_radial: point_std,
            std_tangential: point_std,
        };
        frames.entry(parse_stamp(row)?).or_default().push(point);
    }
    Ok(frames
        .into_iter()
        .map(|(stamp, points)| RecordedSample {
            stamp,
            data: RecordedData::Points(points),
        })
        .collect())
}

fn read_truth(folder: &Path) -> Result<Vec<GroundTruth>> {
    let Some(table) =
        read_optional_table(folder, "truth.csv", &["stamp_s", "x_m", "y_m", "theta_rad"])?
    else {
        return Ok(Vec::new());
    };
    let mut truth = Vec::new();
    for row in table.rows() {
        let [x, y, theta] = parse_floats(row, ["x_m", "y_m", "theta_rad"])?;
        truth.push(GroundTruth {
            stamp: parse_stamp(row)?,
            pose: Pose::new(x, y, theta),
            ball: None,
            ball_height: 0.0,
            robots: Vec::new(),
            robot_headings: Vec::new(),
            people: Vec::new(),
        });
    }
    truth.sort_by_key(|truth| truth.stamp);
    Ok(truth)
}

/// True positions of ball, robots and people from objects.csv, for scoring.
fn read_objects(folder: &Path) -> Result<BTreeMap<Stamp, Vec<GroundTruthObject>>> {
    let mut objects: BTreeMap<Stamp, Vec<GroundTruthObject>> = BTreeMap::new();
    let Some(table) =
        read_optional_table(folder, "objects.csv", &["stamp_s", "kind", "x_m", "y_m"])?
    else {
        return Ok(objects);
    };
    for row in table.rows() {
        let [x, y] = parse_floats(row, ["x_m", "y_m"])?;
        let kind = match row.text("kind")? {
            "ball" => GroundTruthKind::Ball,
            "robot" => GroundTruthKind::Robot,
            "person" => GroundTruthKind::Person,
            // Other kinds are not scored.
            _ => continue,
        };
        let optional = |column| -> Result<Option<f32>> {
            Ok(row.optional_number(column)?.map(|number| number as f32))
        };
        objects
            .entry(parse_stamp(row)?)
            .or_default()
            .push(GroundTruthObject {
                kind,
                at: At::new(x, y),
                heading: optional("heading_rad")?,
                visible_px: optional("visible_px")?,
            });
    }
    Ok(objects)
}
