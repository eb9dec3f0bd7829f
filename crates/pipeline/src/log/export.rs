//! How do other programs read a log? As a recording folder of images and CSV files.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::iter::repeat;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use localize::Stamp;
use mcap::records::Record;

use super::encoded_image::{EncodedImage, ImageCompression};
use super::mcap_records::{LogCompleteness, RecordReader};
use super::read::{LogReader, LoggedCycle};
use super::record_scan::stamp_from_log_time;
use super::schema::{IMAGE_TOPIC, decode_compressed_image};
use crate::csv_table::format_seconds;
use crate::partial_folder::PartialFolder;
use crate::recording::IMU_COLUMNS;

/// Counts of what an export wrote.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportSummary {
    /// Images, or sets of line points if the log has no images.
    pub frames: u64,
    /// Rows of odometry.csv.
    pub odometry: u64,
    /// How the log ended.
    pub end: LogCompleteness,
}

/// Writes a log as a recording folder, which gets its name only when it is complete.
///
/// A log without images is exported with points.csv instead of frames.csv. An existing folder must be empty. Rows are in the order of
/// their stamps also if the log's messages are not.
pub fn export(log: LogReader, folder: &Path) -> Result<ExportSummary> {
    let partial = PartialFolder::create(folder)?;
    std::fs::create_dir(partial.path().join("frames"))
        .with_context(|| format!("cannot write {}", partial.path().display()))?;
    let exported = write_recording(log, partial.path())?;
    partial.finish()?;
    Ok(exported)
}

fn write_recording(mut log: LogReader, folder: &Path) -> Result<ExportSummary> {
    let header = log.header().clone();
    header.write_files(folder)?;
    if !header.files.contains_key("robot.toml") {
        // A run with line points as its only input has no camera.
        std::fs::write(folder.join("robot.toml"), "field = \"field.toml\"\n")?;
    }
    let mut tables = RecordingTables::create(folder)?;
    for logged in log.by_ref() {
        tables.write_cycle(&logged?)?;
    }
    if log.has_displaced_images() {
        tables.write_displaced_images(log.path(), header.clock_offset_ns)?;
    }
    let end = log.end().unwrap_or(LogCompleteness::Truncated);
    tables.finish(end)
}

/// The CSV files of the folder, written while the log is read.
struct RecordingTables {
    folder: PathBuf,
    frames: OptionalCsv,
    points: OptionalCsv,
    odometry: OptionalCsv,
    imu: OptionalCsv,
    compass: OptionalCsv,
    magnetometer: OptionalCsv,
    truth: OptionalCsv,
    objects: OptionalCsv,
    point_frames: u64,
    /// Indices of the cycles that came without an image.
    without_image: HashMap<Stamp, u64>,
}

impl RecordingTables {
    fn create(folder: &Path) -> Result<Self> {
        let table = |name: &str, columns: &str| OptionalCsv::create(folder.join(name), columns);
        Ok(RecordingTables {
            folder: folder.to_owned(),
            frames: table("frames.csv", "stamp_s,file")?,
            points: table("points.csv", "stamp_s,x_m,y_m")?,
            odometry: table("odometry.csv", "stamp_s,dx_m,dy_m,dtheta_rad")?,
            imu: table("imu.csv", &format!("stamp_s,{}", IMU_COLUMNS.join(",")))?,
            compass: table("compass.csv", "stamp_s,heading_rad")?,
            magnetometer: table("magnetometer.csv", "stamp_s,x,y")?,
            truth: table("truth.csv", "stamp_s,x_m,y_m,theta_rad")?,
            objects: table("objects.csv", "stamp_s,kind,x_m,y_m,heading_rad")?,
            point_frames: 0,
            without_image: HashMap::new(),
        })
    }

    fn write_cycle(&mut self, logged: &LoggedCycle) -> Result<()> {
        let cycle = &logged.cycle;
        for sample in &cycle.inputs.odometry {
            let motion = format!("{},{},{}", sample.dx, sample.dy, sample.dtheta);
            self.odometry.write_row(sample.stamp, &motion)?;
        }
        for sample in &cycle.inputs.imu {
            let ([ax, ay, az], [wx, wy, wz]) = (sample.specific_force, sample.angular_velocity);
            self.imu
                .write_row(sample.stamp, &format!("{ax},{ay},{az},{wx},{wy},{wz}"))?;
        }
        for sample in &cycle.inputs.compass {
            self.compass
                .write_row(sample.stamp, &sample.heading.to_string())?;
            if let Some([x, y]) = sample.magnetic_field {
                self.magnetometer
                    .write_row(sample.stamp, &format!("{x},{y}"))?;
            }
        }
        if let Some(truth) = &cycle.inputs.truth {
            let (stamp, pose) = (truth.stamp, truth.pose);
            self.truth
                .write_row(stamp, &format!("{},{},{}", pose.x, pose.y, pose.theta))?;
            let ball = truth.ball.iter().map(|at| ("ball", at, None));
            let headings = truth.robot_headings.iter().copied().map(Some);
            let robots = truth.robots.iter().zip(headings.chain(repeat(None)));
            let robots = robots.map(|(at, heading)| ("robot", at, heading));
            let people = truth.people.iter().map(|at| ("person", at, None));
            for (kind, at, heading) in ball.chain(robots).chain(people) {
                let heading = heading.map_or_else(String::new, |heading| heading.to_string());
                self.objects
                    .write_row(stamp, &format!("{kind},{},{},{heading}", at.x, at.y))?;
            }
        }
        match &logged.image {
            Some(image) => self.write_image(cycle.stamp, logged.index, image)?,
            None => {
                self.without_image.insert(cycle.stamp, logged.index);
            }
        }
        for point in &cycle.line_points {
            self.points
                .write_row(cycle.stamp, &format!("{},{}", point.at.x, point.at.y))?;
        }
        self.point_frames += u64::from(!cycle.line_points.is_empty());
        Ok(())
    }

    fn write_image(&mut self, stamp: Stamp, index: u64, image: &EncodedImage) -> Result<()> {
        let ending = if image.compression == ImageCompression::Jpeg {
            "jpg"
        } else {
            "png"
        };
        let file = format!("frames/{index:06}.{ending}");
        let path = self.folder.join(&file);
        std::fs::write(&path, &image.bytes)
            .with_context(|| format!("cannot write {}", path.display()))?;
        self.frames.write_row(stamp, &file)
    }

    /// Writes the images that do not stand in front of their cycles, in a second reading, since their cycles may stand anywhere.
    fn write_displaced_images(&mut self, log: &Path, clock_offset_ns: i64) -> Result<()> {
        let mut stream = RecordReader::open(log)?;
        let mut channels = HashSet::new();
        while let Some(record) = stream
            .next_record()
            .map_err(|damage| damage.to_error(log))?
        {
            match record {
                Record::Channel(channel) if channel.topic == IMAGE_TOPIC => {
                    channels.insert(channel.id);
                }
                Record::Message { header, data } if channels.contains(&header.channel_id) => {
                    let stamp = stamp_from_log_time(header.log_time);
                    let stamp = Stamp(stamp.0.saturating_sub(clock_offset_ns));
                    if let Some(index) = self.without_image.remove(&stamp) {
                        self.write_image(stamp, index, &decode_compressed_image(&data)?)?;
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn finish(self, end: LogCompleteness) -> Result<ExportSummary> {
        let images = self.frames.rows;
        let exported = ExportSummary {
            frames: if images > 0 {
                images
            } else {
                self.point_frames
            },
            odometry: self.odometry.rows,
            end,
        };
        ensure!(
            exported.frames > 0,
            "the log holds neither images nor line points"
        );
        // Line points are exported only for logs without images.
        self.points.finish(images == 0)?;
        self.frames.finish(true)?;
        if images == 0 {
            std::fs::remove_dir(self.folder.join("frames"))?;
        }
        let motion = [self.odometry, self.imu, self.compass, self.magnetometer];
        for table in motion.into_iter().chain([self.truth, self.objects]) {
            table.finish(true)?;
        }
        Ok(exported)
    }
}

/// A CSV file that is kept if it has rows.
struct OptionalCsv {
    path: PathBuf,
    file: BufWriter<File>,
    rows: u64,
    last_stamp: Option<Stamp>,
    /// No stamp is below the one of the row above.
    is_sorted: bool,
}

impl OptionalCsv {
    fn create(path: PathBuf, columns: &str) -> Result<Self> {
        let file =
            File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
        let mut table = OptionalCsv {
            path,
            file: BufWriter::new(file),
            rows: 0,
            last_stamp: None,
            is_sorted: true,
        };
        table.write_line(columns)?;
        Ok(table)
    }

    fn write_row(&mut self, stamp: Stamp, values: &str) -> Result<()> {
        self.rows += 1;
        self.is_sorted &= self.last_stamp.replace(stamp) <= Some(stamp);
        self.write_line(&format!("{},{values}", format_seconds(stamp)))
    }

    fn write_line(&mut self, line: &str) -> Result<()> {
        writeln!(self.file, "{line}")
            .with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn finish(mut self, wanted: bool) -> Result<()> {
        let context = || format!("cannot write {}", self.path.display());
        self.file.flush().with_context(context)?;
        if self.rows == 0 || !wanted {
            std::fs::remove_file(&self.path)?;
        } else if !self.is_sorted {
            sort_rows(&self.path).with_context(context)?;
        }
        Ok(())
    }
}

/// Sorts a table by its first column, the stamp. Holds one table in memory, as each reader of the folder does.
fn sort_rows(path: &Path) -> std::io::Result<()> {
    let text = std::fs::read_to_string(path)?;
    let (columns, rows) = text.split_once('\n').unwrap_or((&text, ""));
    let mut rows: Vec<&str> = rows.lines().collect();
    let seconds = |row: &str| -> f64 {
        let stamp = row.split(',').next();
        stamp
            .and_then(|stamp| stamp.parse().ok())
            .unwrap_or(f64::NAN)
    };
    rows.sort_by(|a, b| seconds(a).total_cmp(&seconds(b)));
    let mut file = BufWriter::new(File::create(path)?);
    for line in std::iter::once(&columns).chain(&rows) {
        writeln!(file, "{line}")?;
    }
    file.flush()
}
