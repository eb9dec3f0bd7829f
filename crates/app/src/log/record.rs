//! How does a cycle get to the disk without holding up the robot? Through a bounded queue, by a thread of its own.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use localize::{Field, Stamp};

use super::header::Header;
use super::picture::{Encoded, ImageMode};
use super::queue::{Dropped, Entry, Queue};
use super::schema::{Sink, annotate, convert, scene, wire};
use super::{Level, LogConfig, Note, Pace};
use crate::cycle::Cycle;

/// What a recorder wrote.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Written {
    /// Cycles.
    pub cycles: u64,
    /// Images.
    pub images: u64,
    /// What a slow disk cost.
    pub dropped: Dropped,
}

/// Writes the cycles of one run into one log.
pub struct Recorder {
    queue: Arc<Queue>,
    next_index: u64,
    writer: Option<JoinHandle<Result<Written>>>,
    fault: Arc<OnceLock<String>>,
    path: PathBuf,
}

impl Recorder {
    /// Starts a log at `path`, replacing one that is there, and its writer thread.
    ///
    /// What `header` says of images is set from `config`.
    pub fn create(
        path: &Path,
        header: &Header,
        field: &Field,
        pace: Pace,
        config: &LogConfig,
    ) -> Result<Self> {
        if !(1..=100).contains(&config.jpeg_quality) {
            bail!(
                "[log] jpeg_quality = {}: must be 1 to 100",
                config.jpeg_quality
            );
        }
        let period = Duration::try_from_secs_f32(config.flush_period).with_context(|| {
            format!(
                "[log] flush_period = {}: must be seconds",
                config.flush_period
            )
        })?;
        let sink = Sink::create(path)?;
        let header = Header {
            images: config.images,
            ..header.clone()
        };
        begin(&sink, &header, field)?;
        let queue = Arc::new(Queue::new(pace, config.queue_images, config.queue_cycles));
        let fault = Arc::new(OnceLock::new());
        let mut writer = Writer {
            sink,
            images: config.images,
            jpeg_quality: config.jpeg_quality,
            period,
            field_scene: Some(field.clone()),
            written: Written::default(),
        };
        let (end, failed) = (Closing(queue.clone()), fault.clone());
        let run = move || {
            let done = writer.run(&end.0).and_then(|()| writer.close());
            if let Err(error) = &done {
                failed.get_or_init(|| format!("{error:#}"));
            }
            done
        };
        let thread = std::thread::Builder::new()
            .name("log".to_owned())
            .spawn(run)?;
        Ok(Recorder {
            queue,
            next_index: 0,
            writer: Some(thread),
            fault,
            path: path.to_owned(),
        })
    }

    /// Takes a cycle; fails once the log could not be written.
    pub fn cycle(&mut self, cycle: Arc<Cycle>) -> Result<()> {
        let index = self.next_index;
        self.next_index += 1;
        self.queue.push(Entry::Cycle(index, cycle));
        self.check()
    }

    /// Takes a line for /log; fails once the log could not be written.
    pub fn note(&mut self, note: Note) -> Result<()> {
        self.queue.push(Entry::Note(note));
        self.check()
    }

    /// Writes what waits, then index and summary.
    pub fn finish(mut self) -> Result<Written> {
        self.join()
    }

    fn check(&self) -> Result<()> {
        self.fault
            .get()
            .map_or(Ok(()), |fault| Err(anyhow!("{fault}")))
    }

    fn join(&mut self) -> Result<Written> {
        self.queue.close();
        let Some(writer) = self.writer.take() else {
            bail!("the log {} is closed already", self.path.display());
        };
        let written = writer.join();
        written.unwrap_or_else(|_| {
            Err(anyhow!(
                "the writer of the log {} broke off",
                self.path.display()
            ))
        })
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // A run that failed still leaves a whole log; the failure that ends it is the one to be told.
        if self.writer.is_some() {
            let _ = self.join();
        }
    }
}

/// Closes the queue when the writer ends, however it ends: nobody waits for a writer that is gone.
struct Closing(Arc<Queue>);

impl Drop for Closing {
    fn drop(&mut self) {
        self.0.close();
    }
}

fn begin(sink: &Sink, header: &Header, field: &Field) -> Result<()> {
    sink.metadata(super::schema::ABOUT, header.metadata())?;
    let mut files = header.files.clone();
    if !files.contains_key("field.toml") {
        files.insert(
            "field.toml".to_owned(),
            toml::to_string(&field.config)?.into_bytes(),
        );
    }
    for (name, content) in &files {
        sink.attach(name, content)?;
    }
    sink.flush()
}

/// The thread's side.
struct Writer {
    sink: Sink,
    images: ImageMode,
    jpeg_quality: u8,
    period: Duration,
    /// Until it is drawn, at the first cycle's time.
    field_scene: Option<Field>,
    written: Written,
}

impl Writer {
    fn run(&mut self, queue: &Queue) -> Result<()> {
        let mut flushed = now();
        while let Some((entry, dropped)) = queue.pop() {
            let stamp = match entry {
                Entry::Cycle(index, cycle) => {
                    self.cycle(index, &cycle)?;
                    cycle.stamp
                }
                Entry::Note(note) => {
                    self.note(&note);
                    note.stamp
                }
            };
            self.tell_dropped(dropped, stamp);
            if flushed.elapsed() >= self.period {
                self.sink.flush()?;
                flushed = now();
            }
        }
        Ok(())
    }

    fn close(self) -> Result<Written> {
        self.sink.close()?;
        Ok(self.written)
    }

    fn cycle(&mut self, index: u64, cycle: &Cycle) -> Result<()> {
        let stamp = cycle.stamp;
        if let Some(field) = self.field_scene.take() {
            self.sink
                .field_lines
                .log_at(&scene::field_points(&field, stamp), stamp);
            self.sink
                .scene
                .log_at(&scene::field_scene(&field, stamp), stamp);
        }
        self.inputs(cycle);
        let image = match &cycle.inputs.image {
            Some(image) => Encoded::new(image, self.images, self.jpeg_quality)?,
            None => None,
        };
        let image_name = image
            .as_ref()
            .map_or(ImageMode::None, |image| image.mode)
            .name();
        if let Some(image) = image {
            self.sink.picture(image, stamp);
            self.written.images += 1;
        }
        self.findings(cycle);
        // Last, so that whoever reads it has its image already.
        self.sink
            .cycle
            .log_at(&convert::cycle_to_wire(index, cycle, image_name), stamp);
        self.written.cycles += 1;
        Ok(())
    }

    fn inputs(&self, cycle: &Cycle) {
        for sample in &cycle.inputs.odometry {
            self.sink
                .odometry
                .log_at(&convert::odometry_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.imu {
            self.sink
                .imu
                .log_at(&convert::imu_to_wire(sample), sample.stamp);
        }
        for sample in &cycle.inputs.compass {
            self.sink
                .compass
                .log_at(&convert::compass_to_wire(sample), sample.stamp);
        }
        if let Some(truth) = &cycle.inputs.truth {
            self.sink
                .truth
                .log_at(&scene::pose_in_frame(truth.pose, truth.stamp), truth.stamp);
        }
    }

    fn findings(&self, cycle: &Cycle) {
        let (sink, stamp, estimate) = (&self.sink, cycle.stamp, &cycle.estimate);
        if let Some(annotations) = annotate::annotations(cycle) {
            sink.annotations.log_at(&annotations, stamp);
        }
        if let Some(seen) = &cycle.seen {
            let sensors = wire::Sensors {
                line_points: seen.line_points.len() as u32,
                refused: seen.refused.len() as u32,
                carpet_share: seen.carpet_share,
                colours_learned: seen.learned,
            };
            sink.sensors.log_at(&sensors, stamp);
            if let Some(ball) = &seen.ball {
                sink.ball.log_at(&convert::ball_to_wire(ball), stamp);
            }
            // Also when there are none: else a viewer would go on showing those that left.
            let robots = seen.robots.iter().map(convert::robot_to_wire).collect();
            sink.robots.log_at(&wire::Robots { robots }, stamp);
        }
        sink.line_points
            .log_at(&scene::line_points(&cycle.points, stamp), stamp);
        if let Some(pose) = estimate.pose {
            sink.pose.log_at(&scene::pose_in_frame(pose, stamp), stamp);
            sink.frames.log_at(&scene::robot_frame(pose, stamp), stamp);
        }
        if !estimate.runners_up.is_empty() {
            let poses = estimate.runners_up.iter().map(|other| other.pose);
            sink.particles
                .log_at(&scene::poses_in_frame(poses, stamp), stamp);
        }
        sink.scene.log_at(&scene::cycle_scene(cycle), stamp);
        if let Some(fault) = &cycle.fault {
            self.note(&Note {
                stamp,
                level: Level::Warning,
                text: format!("frame not used: {fault}"),
            });
        }
    }

    fn tell_dropped(&mut self, dropped: Dropped, stamp: Stamp) {
        if dropped.none() {
            return;
        }
        let Dropped {
            images,
            cycles,
            notes,
        } = dropped;
        self.written.dropped.images += images;
        self.written.dropped.cycles += cycles;
        self.written.dropped.notes += notes;
        let text =
            format!("the disk is slow: dropped {images} images, {cycles} cycles, {notes} notes");
        self.note(&Note {
            stamp,
            level: Level::Warning,
            text,
        });
    }

    fn note(&self, note: &Note) {
        self.sink.note(note);
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "when to flush is the disk's matter, not the data's"
)]
fn now() -> Instant {
    Instant::now()
}
