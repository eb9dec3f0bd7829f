//! What the devices measure, as tables and images of a recording folder.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use hw::DeviceEvent;
use hw::camera::CapturedImage;
use localize::sample::Compass;
use pipeline::csv_table::{CsvWriter, format_seconds};
use pipeline::recording::IMU_COLUMNS;
use pipeline::sample::SourceImage;

use super::counts::Counts;
use crate::run::raw_image::raw_image;

/// Images that wait for the disk: a second.
const IMAGE_QUEUE_CAPACITY: usize = 30;
/// Period in which tables are passed to the system: what a killed process loses.
const FLUSH_PERIOD: Duration = Duration::from_secs(1);

/// The tables of the folder, and the thread that writes its images.
pub(super) struct FolderRecorder {
    folder: PathBuf,
    odometry: Table,
    imu: Table,
    compass: Table,
    magnetometer: Table,
    images: SyncSender<CapturedImage>,
    image_thread: JoinHandle<(u64, Result<()>)>,
    images_dropped: u64,
    flushed: Instant,
}

/// A table and its number of rows.
struct Table {
    path: PathBuf,
    file: CsvWriter,
    rows: u64,
}

impl Table {
    fn create(folder: &Path, name: &str, columns: &str) -> Result<Self> {
        let path = folder.join(name);
        Ok(Table {
            file: CsvWriter::create_in_place(&path, columns)?,
            path,
            rows: 0,
        })
    }

    fn write_row(&mut self, row: std::fmt::Arguments<'_>) -> Result<()> {
        self.rows += 1;
        self.file.write_row(row)
    }

    /// Completes the table; an empty one is removed.
    fn finish(self) -> Result<()> {
        self.file.finish()?;
        if self.rows == 0 {
            std::fs::remove_file(&self.path)?;
        }
        Ok(())
    }
}

impl FolderRecorder {
    pub(super) fn start(folder: &Path) -> Result<Self> {
        let frames = folder.join("frames");
        std::fs::create_dir(&frames)
            .with_context(|| format!("cannot write {}", frames.display()))?;
        let (images, queue) = sync_channel(IMAGE_QUEUE_CAPACITY);
        let images_folder = folder.to_owned();
        let image_thread = std::thread::Builder::new()
            .name("images".to_owned())
            .spawn(move || write_images(&images_folder, &queue))?;
        let table = |name: &str, columns: &str| Table::create(folder, name, columns);
        Ok(FolderRecorder {
            odometry: table("odometry.csv", "stamp_s,dx_m,dy_m,dtheta_rad")?,
            imu: table("imu.csv", &format!("stamp_s,{}", IMU_COLUMNS.join(",")))?,
            compass: table("compass.csv", "stamp_s,heading_rad")?,
            magnetometer: table("magnetometer.csv", "stamp_s,x,y")?,
            folder: folder.to_owned(),
            images,
            image_thread,
            images_dropped: 0,
            flushed: Instant::now(),
        })
    }

    pub(super) fn write(&mut self, event: DeviceEvent) -> Result<()> {
        if self.flushed.elapsed() >= FLUSH_PERIOD {
            self.flushed = Instant::now();
            for table in self.tables() {
                table.file.flush()?;
            }
        }
        match event {
            DeviceEvent::Image(image) => self.write_image(image),
            DeviceEvent::Odometry(sample) => {
                let stamp = format_seconds(sample.stamp);
                let (dx, dy, dtheta) = (sample.dx, sample.dy, sample.dtheta);
                self.odometry
                    .write_row(format_args!("{stamp},{dx},{dy},{dtheta}"))
            }
            DeviceEvent::Imu(sample) => {
                let stamp = format_seconds(sample.stamp);
                let ([ax, ay, az], [wx, wy, wz]) = (sample.specific_force, sample.angular_velocity);
                self.imu
                    .write_row(format_args!("{stamp},{ax},{ay},{az},{wx},{wy},{wz}"))
            }
            DeviceEvent::Compass(sample) => self.write_compass(&sample),
            DeviceEvent::Command(_)
            | DeviceEvent::Health(_)
            | DeviceEvent::Power(_)
            | DeviceEvent::Kicker(_)
            | DeviceEvent::Switches(_) => Ok(()),
        }
    }

    fn tables(&mut self) -> [&mut Table; 4] {
        [
            &mut self.odometry,
            &mut self.imu,
            &mut self.compass,
            &mut self.magnetometer,
        ]
    }

    fn write_compass(&mut self, sample: &Compass) -> Result<()> {
        let stamp = format_seconds(sample.stamp);
        self.compass
            .write_row(format_args!("{stamp},{}", sample.heading))?;
        match sample.magnetic_field {
            Some([x, y]) => self.magnetometer.write_row(format_args!("{stamp},{x},{y}")),
            None => Ok(()),
        }
    }

    fn write_image(&mut self, image: CapturedImage) -> Result<()> {
        // An image that the camera repeats shows another time than its stamp.
        if image.repeated {
            return Ok(());
        }
        match self.images.try_send(image) {
            Ok(()) => Ok(()),
            Err(std::sync::mpsc::TrySendError::Full(_)) => {
                self.images_dropped += 1;
                Ok(())
            }
            Err(std::sync::mpsc::TrySendError::Disconnected(_)) => {
                Err(anyhow!("cannot write {}", self.folder.display()))
            }
        }
    }

    /// What was recorded, and why not more.
    pub(super) fn finish(self) -> (Counts, Result<()>) {
        drop(self.images);
        let (frames, images) = self
            .image_thread
            .join()
            .unwrap_or_else(|_panic| (0, Err(anyhow!("the thread that writes images panicked"))));
        let mut written = images;
        let mut rows = |table: Table| {
            let rows = table.rows;
            written = std::mem::replace(&mut written, Ok(())).and(table.finish());
            rows
        };
        let counts = Counts {
            frames,
            images_dropped: self.images_dropped,
            odometry: rows(self.odometry),
            imu: rows(self.imu),
            compass: rows(self.compass),
        };
        rows(self.magnetometer);
        (counts, written)
    }
}

/// Writes images and frames.csv until the queue ends or the disk refuses; returns their number.
fn write_images(folder: &Path, queue: &Receiver<CapturedImage>) -> (u64, Result<()>) {
    let mut table = match CsvWriter::create_in_place(&folder.join("frames.csv"), "stamp_s,file") {
        Ok(table) => table,
        Err(error) => return (0, Err(error)),
    };
    let mut frames = 0;
    let mut written = Ok(());
    for image in queue {
        let stamp = format_seconds(image.stamp);
        // An image that the camera cut off is left out.
        let Some(rgb) = SourceImage::Raw(raw_image(image)).to_rgb() else {
            continue;
        };
        let file = format!("frames/{frames:06}.png");
        let path = folder.join(&file);
        written = rgb
            .save(&path)
            .with_context(|| format!("cannot write {}", path.display()));
        if written.is_err() {
            // Half an image. Its space is enough for what the tables still hold.
            let _refused = std::fs::remove_file(&path);
            break;
        }
        written = table
            .write_row(format_args!("{stamp},{file}"))
            .and_then(|()| table.flush());
        if written.is_err() {
            break;
        }
        frames += 1;
    }
    (frames, written.and(table.finish()))
}
