//! How do other programs read a log? As a recording folder of images and CSV files.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::iter::repeat;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use super::encoded_image::ImageCompression;
use super::mcap_records::LogCompleteness;
use super::read::{LogReader, LoggedCycle};
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
/// A log without images is exported with points.csv instead of frames.csv. An existing folder must be empty.
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
        })
    }

    fn write_cycle(&mut self, logged: &LoggedCycle) -> Result<()> {
        let cycle = &logged.cycle;
        for sample in &cycle.inputs.odometry {
            let row = format!(
                "{},{},{},{}",
                format_seconds(sample.stamp),
                sample.dx,
                sample.dy,
                sample.dtheta
            );
            self.odometry.write_row(&row)?;
        }
        for sample in &cycle.inputs.imu {
            let stamp = format_seconds(sample.stamp);
            let ([ax, ay, az], [wx, wy, wz]) = (sample.specific_force, sample.angular_velocity);
            self.imu
                .write_row(&format!("{stamp},{ax},{ay},{az},{wx},{wy},{wz}"))?;
        }
        for sample in &cycle.inputs.compass {
            self.compass.write_row(&format!(
                "{},{}",
                format_seconds(sample.stamp),
                sample.heading
            ))?;
            if let Some([x, y]) = sample.magnetic_field {
                self.magnetometer
                    .write_row(&format!("{},{x},{y}", format_seconds(sample.stamp)))?;
            }
        }
        if let Some(truth) = &cycle.inputs.truth {
            let (stamp, pose) = (format_seconds(truth.stamp), truth.pose);
            self.truth
                .write_row(&format!("{stamp},{},{},{}", pose.x, pose.y, pose.theta))?;
            let ball = truth.ball.iter().map(|at| ("ball", at, None));
            let headings = truth.robot_headings.iter().copied().map(Some);
            let robots = truth.robots.iter().zip(headings.chain(repeat(None)));
            let robots = robots.map(|(at, heading)| ("robot", at, heading));
            let people = truth.people.iter().map(|at| ("person", at, None));
            for (kind, at, heading) in ball.chain(robots).chain(people) {
                let heading = heading.map_or_else(String::new, |heading| heading.to_string());
                self.objects
                    .write_row(&format!("{stamp},{kind},{},{},{heading}", at.x, at.y))?;
            }
        }
        let stamp = format_seconds(cycle.stamp);
        if let Some(image) = &logged.image {
            let ending = if image.compression == ImageCompression::Jpeg {
                "jpg"
            } else {
                "png"
            };
            let file = format!("frames/{:06}.{ending}", logged.index);
            let path = self.folder.join(&file);
            std::fs::write(&path, &image.bytes)
                .with_context(|| format!("cannot write {}", path.display()))?;
            self.frames.write_row(&format!("{stamp},{file}"))?;
        }
        for point in &cycle.line_points {
            self.points
                .write_row(&format!("{stamp},{},{}", point.at.x, point.at.y))?;
        }
        self.point_frames += u64::from(!cycle.line_points.is_empty());
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
}

impl OptionalCsv {
    fn create(path: PathBuf, columns: &str) -> Result<Self> {
        let file =
            File::create(&path).with_context(|| format!("cannot write {}", path.display()))?;
        let mut table = OptionalCsv {
            path,
            file: BufWriter::new(file),
            rows: 0,
        };
        table.write_line(columns)?;
        Ok(table)
    }

    fn write_row(&mut self, row: &str) -> Result<()> {
        self.rows += 1;
        self.write_line(row)
    }

    fn write_line(&mut self, line: &str) -> Result<()> {
        writeln!(self.file, "{line}")
            .with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn finish(mut self, wanted: bool) -> Result<()> {
        self.file
            .flush()
            .with_context(|| format!("cannot write {}", self.path.display()))?;
        if self.rows == 0 || !wanted {
            std::fs::remove_file(&self.path)?;
        }
        Ok(())
    }
}
