//! What is painted pixel by pixel over camera and field? Classes, the unwarped floor, landscapes of error; in a thread of
//! its own, so that the window stays quick, and always of the newest cycle alone.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

use eframe::egui::{Color32, ColorImage};
use localize::frame::{At, RobotFrame};
use localize::sample::LinePoint;
use localize::{DistanceField, Stamp};
use vision::colours::ColourClass;
use vision::config::{ImageRect, VisionConfig};
use vision::eyes::Vision;
use vision::image::{Image, rgb_to_yuv};
use vision::labels::ColourTable;

use super::ink;
use super::source::image_of;
use super::stage::Stage;
use pipeline::cycle::Cycle;

/// Half the side of the bird's-eye view, metres: a midfield robot sees the lines of half the field there.
pub(crate) const BIRD_REACH: f32 = 6.0;
/// Its side, pixels: 2 cm each.
pub(crate) const BIRD_SIDE: usize = 600;
/// Side of a cell of the landscapes, metres.
pub(crate) const LANDSCAPE_CELL: f32 = 0.1;
/// Mean distance that is painted darkest, metres: half the gap between the league's nearest parallel lines.
const LANDSCAPE_DARK: f32 = 0.75;

/// What is to be painted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Wanted {
    /// The class of every pixel.
    pub(crate) classes: bool,
    /// The class of the pixels that vision reads.
    pub(crate) scan: bool,
    /// Where the virtual sensors' windows are.
    pub(crate) windows: bool,
    /// The floor from above.
    pub(crate) bird: bool,
    /// The distance to the nearest marking over the field.
    pub(crate) distance: bool,
    /// The mean distance of this frame's points, were the robot there (minho2016).
    pub(crate) landscape: bool,
}

/// One cycle to paint.
#[derive(Clone)]
pub(crate) struct Job {
    pub(crate) stage: Arc<Stage>,
    pub(crate) cycle: Arc<Cycle>,
    pub(crate) vision: VisionConfig,
    /// Classes from painted labels, in place of the robot's own.
    pub(crate) table: Option<Arc<ColourTable>>,
    /// What the robot sees of itself, one entry a pixel; false where it does.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Counts changes of what does not come with the cycle: settings, table, mask.
    pub(crate) version: u64,
    pub(crate) wanted: Wanted,
}

/// What was painted.
#[derive(Clone, Default)]
pub(crate) struct Painted {
    /// What was painted of.
    pub(crate) cycle: Option<Arc<Cycle>>,
    pub(crate) classes: Option<Arc<ColorImage>>,
    pub(crate) scan: Option<Arc<ColorImage>>,
    pub(crate) bird: Option<Arc<ColorImage>>,
    pub(crate) windows: Option<Arc<Vec<(&'static str, ImageRect)>>>,
    pub(crate) distance: Option<Arc<ColorImage>>,
    pub(crate) landscape: Option<Arc<ColorImage>>,
    /// Why classes could not be painted.
    pub(crate) fault: Option<String>,
}

#[derive(Default)]
struct Desk {
    job: Option<Job>,
    done: Option<Painted>,
    closed: bool,
}

/// The painting thread's desk: one job on it, one result.
pub(crate) struct Layers {
    desk: Arc<(Mutex<Desk>, Condvar)>,
    last: Option<(Stamp, u64, Wanted)>,
}

impl Layers {
    /// Starts the thread; `wake` is called when something is painted.
    pub(crate) fn start(wake: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let desk = Arc::new((Mutex::new(Desk::default()), Condvar::new()));
        let theirs = desk.clone();
        std::thread::Builder::new()
            .name("layers".to_owned())
            .spawn(move || work(&theirs, &wake))?;
        Ok(Layers { desk, last: None })
    }

    /// Lays a job on the desk, in place of one that waits; the same one twice is none.
    pub(crate) fn ask(&mut self, job: Job) {
        let key = (job.cycle.stamp, job.version, job.wanted);
        if job.wanted == Wanted::default() || self.last == Some(key) {
            return;
        }
        self.last = Some(key);
        lock(&self.desk.0).job = Some(job);
        self.desk.1.notify_all();
    }

    /// What was painted since the last call.
    pub(crate) fn take(&mut self) -> Option<Painted> {
        lock(&self.desk.0).done.take()
    }
}

impl Drop for Layers {
    fn drop(&mut self) {
        lock(&self.desk.0).closed = true;
        self.desk.1.notify_all();
    }
}

fn lock(desk: &Mutex<Desk>) -> std::sync::MutexGuard<'_, Desk> {
    desk.lock().unwrap_or_else(PoisonError::into_inner)
}

fn work(desk: &(Mutex<Desk>, Condvar), wake: &impl Fn()) {
    let mut painter = Painter::default();
    loop {
        let mut held = lock(&desk.0);
        while held.job.is_none() && !held.closed {
            held = desk.1.wait(held).unwrap_or_else(PoisonError::into_inner);
        }
        if held.closed {
            return;
        }
        let job = held.job.take();
        drop(held);
        if let Some(job) = job {
            let painted = painter.paint(&job);
            lock(&desk.0).done = Some(painted);
            wake();
        }
    }
}

/// What painting keeps from one cycle to the next.
#[derive(Default)]
struct Painter {
    eyes: Option<(u64, Vision)>,
    /// Class by the upper six bits of red, green and blue; 255 is not known yet.
    cells: Vec<u8>,
    /// Carpet, white and noise that the cells are of.
    light: Option<vision::carpet::CarpetModel>,
    /// Pixel of the image under each pixel of the bird's-eye view.
    bird: Option<(usize, Vec<u32>)>,
    distance: Option<(usize, Arc<ColorImage>)>,
}

impl Painter {
    fn paint(&mut self, job: &Job) -> Painted {
        let mut painted = Painted {
            cycle: Some(job.cycle.clone()),
            ..Painted::default()
        };
        let stage = &job.stage;
        let key = Arc::as_ptr(stage) as usize;
        if let (Some(image), Some(eye)) = (image_of(&job.cycle), &stage.eye)
            && (image.width_px, image.height_px) == (eye.map.width_px, eye.map.height_px)
        {
            if job.wanted.classes || job.wanted.scan || job.wanted.windows {
                match self.classes(job, image) {
                    Ok((classes, scan)) => (painted.classes, painted.scan) = (classes, scan),
                    Err(error) => painted.fault = Some(error),
                }
                let eyes = self.eyes.as_ref().filter(|_| job.wanted.windows);
                painted.windows =
                    eyes.map(|(_, eyes)| Arc::new(eyes.virtual_sensor_regions().to_vec()));
            }
            if job.wanted.bird {
                if self.bird.as_ref().is_none_or(|(known, _)| *known != key) {
                    self.bird = Some((key, bird_pixels(stage)));
                }
                let pixels = self.bird.as_ref().map_or(&[][..], |(_, pixels)| pixels);
                painted.bird = Some(Arc::new(bird(image, pixels)));
            }
        }
        if job.wanted.distance {
            if self
                .distance
                .as_ref()
                .is_none_or(|(known, _)| *known != key)
            {
                self.distance = Some((key, Arc::new(distance(stage))));
            }
            painted.distance = self.distance.as_ref().map(|(_, image)| image.clone());
        }
        if job.wanted.landscape {
            let heading = job.cycle.estimate.pose.map(|pose| pose.theta);
            let heading = heading.or(job.cycle.inputs.compass.last().map(|last| last.heading));
            painted.landscape = Some(Arc::new(landscape(
                stage,
                &job.cycle.line_points,
                heading.unwrap_or(0.0),
            )));
        }
        painted
    }

    /// Classes of all pixels, and of those that vision reads.
    fn classes(&mut self, job: &Job, image: &Image) -> Result<(Layer, Layer), String> {
        let stage = &job.stage;
        let eye = stage.eye.as_ref().ok_or("no camera")?;
        if self.eyes.as_ref().is_none_or(|(of, _)| *of != job.version) {
            let width = stage.field.config.line_width;
            let mask = job.mask.as_ref().map(|mask| mask.as_slice());
            let mut eyes =
                Vision::with_mask(&eye.map, &eye.camera, mask, width, job.vision.clone())
                    .map_err(|error| error.to_string())?;
            if let Some(table) = job.table.as_deref().or(stage.colours.as_ref()) {
                eyes.set_colour_table(table.clone());
            }
            self.eyes = Some((job.version, eyes));
            self.light = None;
        }
        let Some((_, eyes)) = &mut self.eyes else {
            return Err("no eyes".to_owned());
        };
        eyes.process_lines(&image.view())
            .map_err(|error| error.to_string())?;
        let model = *eyes.carpet_model().ok_or("no carpet was learned")?;
        if self.light != Some(model) {
            self.light = Some(model);
            self.cells = vec![u8::MAX; 1 << 18];
        }
        let table = job.table.as_deref().or(stage.colours.as_ref());
        let (colours, ball) = (&job.vision.colours, job.vision.objects.ball_hue_deg);
        let mut scan = None;
        if job.wanted.scan {
            let mut layer =
                ColorImage::filled([image.width_px, image.height_px], Color32::TRANSPARENT);
            let classes = eyes.classify_samples(&image.view());
            let classes = classes.map_err(|error| error.to_string())?.to_vec();
            for (sample, class) in eyes.scan_pattern().samples.iter().zip(classes) {
                let at = usize::from(sample.v) * image.width_px + usize::from(sample.u);
                layer.pixels[at] = ink::class(class);
            }
            scan = Some(Arc::new(layer));
        }
        let classes = job.wanted.classes.then(|| {
            let cells = &mut self.cells;
            let pixels = image.rgb.chunks_exact(3).map(|rgb| {
                let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(|channel| usize::from(channel >> 2));
                let cell = &mut cells[r << 12 | g << 6 | b];
                if *cell == u8::MAX {
                    let middle = [r, g, b].map(|channel| (channel << 2 | 2) as u8);
                    *cell = match table {
                        Some(table) => table.class(rgb_to_yuv(middle)).0,
                        None => model.classify(middle, colours, ball).0,
                    };
                }
                ink::class(ColourClass(*cell))
            });
            let size = [image.width_px, image.height_px];
            Arc::new(ColorImage::new(size, pixels.collect()))
        });
        Ok((classes, scan))
    }
}

type Layer = Option<Arc<ColorImage>>;

/// Index of the image's pixel under each of the bird's-eye view; `u32::MAX` where there is none.
fn bird_pixels(stage: &Stage) -> Vec<u32> {
    let Some(eye) = &stage.eye else {
        return Vec::new();
    };
    let step = 2.0 * BIRD_REACH / BIRD_SIDE as f32;
    let mut pixels = Vec::with_capacity(BIRD_SIDE * BIRD_SIDE);
    for row in 0..BIRD_SIDE {
        for column in 0..BIRD_SIDE {
            // Forward is up, left is left.
            let ground = At::<RobotFrame>::new(
                BIRD_REACH - (row as f32 + 0.5) * step,
                BIRD_REACH - (column as f32 + 0.5) * step,
            );
            let found = eye.inverse.pixel(&eye.map, ground);
            pixels.push(found.map_or(u32::MAX, |[u, v]| {
                v.round() as u32 * eye.map.width_px as u32 + u.round() as u32
            }));
        }
    }
    pixels
}

fn bird(image: &Image, pixels: &[u32]) -> ColorImage {
    let colour = |&pixel: &u32| {
        let at = 3 * pixel as usize;
        image.rgb.get(at..at + 3).map_or(ink::SURROUND, |rgb| {
            Color32::from_rgb(rgb[0], rgb[1], rgb[2])
        })
    };
    let mut colours: Vec<Color32> = pixels.iter().map(colour).collect();
    colours.resize(BIRD_SIDE * BIRD_SIDE, ink::SURROUND);
    ColorImage::new([BIRD_SIDE, BIRD_SIDE], colours)
}

/// Columns and rows of a landscape over the carpet, and the value of each cell's middle; the first row is at the top.
///
/// On this thread alone: the pool's threads are the robot's.
fn over_field(stage: &Stage, value: impl Fn(f32, f32) -> f32) -> ColorImage {
    let (half_x, half_y) = stage.field.carpet_half_extent();
    let columns = (2.0 * half_x / LANDSCAPE_CELL).round().max(1.0) as usize;
    let rows = (2.0 * half_y / LANDSCAPE_CELL).round().max(1.0) as usize;
    let (step_x, step_y) = (2.0 * half_x / columns as f32, 2.0 * half_y / rows as f32);
    let pixels: Vec<Color32> = (0..rows * columns)
        .map(|cell| {
            let x = (cell % columns) as f32 * step_x + step_x / 2.0 - half_x;
            let y = half_y - (cell / columns) as f32 * step_y - step_y / 2.0;
            shade(value(x, y) / LANDSCAPE_DARK)
        })
        .collect();
    ColorImage::new([columns, rows], pixels)
}

/// From bright yellow (0) over orange and purple to nearly black (1): brightness alone orders it.
fn shade(value: f32) -> Color32 {
    const STOPS: [[f32; 3]; 4] = [
        [252.0, 246.0, 170.0],
        [240.0, 140.0, 40.0],
        [120.0, 30.0, 110.0],
        [10.0, 5.0, 30.0],
    ];
    let place = value.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let stop = (place as usize).min(STOPS.len() - 2);
    let part = place - stop as f32;
    let [r, g, b] = [0, 1, 2].map(|channel| {
        let (from, to) = (STOPS[stop][channel], STOPS[stop + 1][channel]);
        (from + part * (to - from)) as u8
    });
    Color32::from_rgb(r, g, b)
}

fn distance(stage: &Stage) -> ColorImage {
    let distances: &DistanceField = &stage.distances;
    over_field(stage, |x, y| distances.nearest(x, y).signed_distance.abs())
}

/// Mean distance of the points from the markings, were the robot in the middle of each cell with this heading.
fn landscape(stage: &Stage, points: &[LinePoint], heading: f32) -> ColorImage {
    let (sin, cos) = heading.sin_cos();
    let turned: Vec<[f32; 2]> = points
        .iter()
        .map(|point| {
            let at = point.at;
            [cos * at.x - sin * at.y, sin * at.x + cos * at.y]
        })
        .collect();
    let per = 1.0 / turned.len().max(1) as f32;
    let distances = &stage.distances;
    over_field(stage, |x, y| {
        // Far outliers would drown what the others say (nubot2013 bounds them alike).
        let distance = |at: &[f32; 2]| {
            let near = distances.nearest(x + at[0], y + at[1]);
            near.signed_distance.abs().min(LANDSCAPE_DARK)
        };
        per * turned.iter().map(distance).sum::<f32>()
    })
}
