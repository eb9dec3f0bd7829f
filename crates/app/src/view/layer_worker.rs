//! What is painted pixel by pixel over camera and field? Classes, the unwarped floor, landscapes of error; in a thread of
//! its own, so that the window stays quick, and always of the newest cycle alone.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

use eframe::egui::{Color32, ColorImage};
use localize::frames::{At, RobotFrame};
use localize::sample::LinePoint;
use localize::{DistanceField, Stamp};
use vision::colour::colour_table::ColourTable;
use vision::colour::lookup_table::ColourClass;
use vision::config::{ImageRect, VisionConfig};
use vision::image::{Image, rgb_to_yuv};
use vision::process::Vision;

use super::palette;
use super::source::rgb_image;
use super::static_scene::StaticScene;
use pipeline::Cycle;

/// Half the side of the bird's-eye view, metres: a midfield robot sees the lines of half the field there.
pub(crate) const BIRDS_EYE_HALF_EXTENT: f32 = 6.0;
/// Its side, pixels: 2 cm each.
pub(crate) const BIRDS_EYE_SIDE_PX: usize = 600;
/// Side of a cell of the landscapes, metres.
pub(crate) const HEATMAP_CELL: f32 = 0.1;
/// Mean distance that is painted darkest, metres: half the gap between the league's nearest parallel lines.
const HEATMAP_MAX_DISTANCE: f32 = 0.75;

/// What is to be painted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct LayerSelection {
    /// The class of every pixel.
    pub(crate) classes: bool,
    /// The class of the pixels that vision reads.
    pub(crate) scan_pixels: bool,
    /// Where the virtual sensors' windows are.
    pub(crate) virtual_sensors: bool,
    /// The floor from above.
    pub(crate) birds_eye: bool,
    /// The distance to the nearest marking over the field.
    pub(crate) distance_field: bool,
    /// The mean distance of this frame's points, were the robot there (minho2016).
    pub(crate) error_landscape: bool,
}

/// One cycle to paint.
#[derive(Clone)]
pub(crate) struct LayerJob {
    pub(crate) scene: Arc<StaticScene>,
    pub(crate) cycle: Arc<Cycle>,
    pub(crate) vision: VisionConfig,
    /// Classes from painted labels, in place of the robot's own.
    pub(crate) colour_table: Option<Arc<ColourTable>>,
    /// What the robot sees of itself, one entry a pixel; false where it does.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Counts changes of what does not come with the cycle: settings, table, mask.
    pub(crate) revision: u64,
    pub(crate) selection: LayerSelection,
}

/// What was painted.
#[derive(Clone, Default)]
pub(crate) struct RenderedLayers {
    /// What was painted of.
    pub(crate) cycle: Option<Arc<Cycle>>,
    pub(crate) classes: Option<Arc<ColorImage>>,
    pub(crate) scan_pixels: Option<Arc<ColorImage>>,
    pub(crate) birds_eye: Option<Arc<ColorImage>>,
    pub(crate) virtual_sensors: Option<Arc<Vec<(&'static str, ImageRect)>>>,
    pub(crate) distance_field: Option<Arc<ColorImage>>,
    pub(crate) error_landscape: Option<Arc<ColorImage>>,
    /// Why classes could not be painted.
    pub(crate) error: Option<String>,
}

#[derive(Default)]
struct Mailbox {
    job: Option<LayerJob>,
    result: Option<RenderedLayers>,
    closed: bool,
}

/// The painting thread's desk: one job on it, one result.
pub(crate) struct LayerWorker {
    mailbox: Arc<(Mutex<Mailbox>, Condvar)>,
    last_request: Option<(Stamp, u64, LayerSelection)>,
}

impl LayerWorker {
    /// Starts the thread; `wake` is called when something is painted.
    pub(crate) fn start(wake: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let desk = Arc::new((Mutex::new(Mailbox::default()), Condvar::new()));
        let theirs = desk.clone();
        std::thread::Builder::new()
            .name("layers".to_owned())
            .spawn(move || run_worker(&theirs, &wake))?;
        Ok(LayerWorker {
            mailbox: desk,
            last_request: None,
        })
    }

    /// Lays a job on the desk, in place of one that waits; the same one twice is none.
    pub(crate) fn submit(&mut self, job: LayerJob) {
        let key = (job.cycle.stamp, job.revision, job.selection);
        if job.selection == LayerSelection::default() || self.last_request == Some(key) {
            return;
        }
        self.last_request = Some(key);
        lock(&self.mailbox.0).job = Some(job);
        self.mailbox.1.notify_all();
    }

    /// What was painted since the last call.
    pub(crate) fn take_result(&mut self) -> Option<RenderedLayers> {
        lock(&self.mailbox.0).result.take()
    }
}

impl Drop for LayerWorker {
    fn drop(&mut self) {
        lock(&self.mailbox.0).closed = true;
        self.mailbox.1.notify_all();
    }
}

fn lock(desk: &Mutex<Mailbox>) -> std::sync::MutexGuard<'_, Mailbox> {
    desk.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run_worker(desk: &(Mutex<Mailbox>, Condvar), wake: &impl Fn()) {
    let mut painter = LayerRenderer::default();
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
            let painted = painter.render(&job);
            lock(&desk.0).result = Some(painted);
            wake();
        }
    }
}

/// What painting keeps from one cycle to the next.
#[derive(Default)]
struct LayerRenderer {
    vision: Option<(u64, Vision)>,
    /// Class by the upper six bits of red, green and blue; 255 is not known yet.
    class_cache: Vec<u8>,
    /// Carpet, white and noise that the cells are of.
    carpet_model: Option<vision::colour::carpet_model::CarpetModel>,
    /// Pixel of the image under each pixel of the bird's-eye view.
    birds_eye_pixels: Option<(usize, Vec<u32>)>,
    distance_layer: Option<(usize, Arc<ColorImage>)>,
}

impl LayerRenderer {
    fn render(&mut self, job: &LayerJob) -> RenderedLayers {
        let mut painted = RenderedLayers {
            cycle: Some(job.cycle.clone()),
            ..RenderedLayers::default()
        };
        let stage = &job.scene;
        let key = Arc::as_ptr(stage) as usize;
        if let (Some(image), Some(eye)) = (rgb_image(&job.cycle), &stage.camera)
            && (image.width_px, image.height_px) == (eye.map.width_px, eye.map.height_px)
        {
            if job.selection.classes || job.selection.scan_pixels || job.selection.virtual_sensors {
                match self.render_classes(job, image) {
                    Ok((classes, scan)) => (painted.classes, painted.scan_pixels) = (classes, scan),
                    Err(error) => painted.error = Some(error),
                }
                let eyes = self
                    .vision
                    .as_ref()
                    .filter(|_| job.selection.virtual_sensors);
                painted.virtual_sensors =
                    eyes.map(|(_, eyes)| Arc::new(eyes.virtual_sensor_regions().to_vec()));
            }
            if job.selection.birds_eye {
                if self
                    .birds_eye_pixels
                    .as_ref()
                    .is_none_or(|(known, _)| *known != key)
                {
                    self.birds_eye_pixels = Some((key, birds_eye_pixels(stage)));
                }
                let pixels = self
                    .birds_eye_pixels
                    .as_ref()
                    .map_or(&[][..], |(_, pixels)| pixels);
                painted.birds_eye = Some(Arc::new(render_birds_eye(image, pixels)));
            }
        }
        if job.selection.distance_field {
            if self
                .distance_layer
                .as_ref()
                .is_none_or(|(known, _)| *known != key)
            {
                self.distance_layer = Some((key, Arc::new(render_distance_field(stage))));
            }
            painted.distance_field = self.distance_layer.as_ref().map(|(_, image)| image.clone());
        }
        if job.selection.error_landscape {
            let heading = job.cycle.estimate.pose.map(|pose| pose.theta);
            let heading = heading.or(job.cycle.inputs.compass.last().map(|last| last.heading));
            painted.error_landscape = Some(Arc::new(render_error_landscape(
                stage,
                &job.cycle.line_points,
                heading.unwrap_or(0.0),
            )));
        }
        painted
    }

    /// Classes of all pixels, and of those that vision reads.
    fn render_classes(&mut self, job: &LayerJob, image: &Image) -> Result<(Layer, Layer), String> {
        let stage = &job.scene;
        let eye = stage.camera.as_ref().ok_or("no camera")?;
        if self
            .vision
            .as_ref()
            .is_none_or(|(of, _)| *of != job.revision)
        {
            let width = stage.field.config.line_width;
            let mask = job.mask.as_ref().map(|mask| mask.as_slice());
            let mut eyes =
                Vision::with_mask(&eye.map, &eye.config, mask, width, job.vision.clone())
                    .map_err(|error| error.to_string())?;
            if let Some(table) = job.colour_table.as_deref().or(stage.colour_table.as_ref()) {
                eyes.set_colour_table(table.clone());
            }
            self.vision = Some((job.revision, eyes));
            self.carpet_model = None;
        }
        let Some((_, eyes)) = &mut self.vision else {
            return Err("no eyes".to_owned());
        };
        eyes.process_lines(&image.view())
            .map_err(|error| error.to_string())?;
        let model = *eyes.carpet_model().ok_or("no carpet was learned")?;
        if self.carpet_model != Some(model) {
            self.carpet_model = Some(model);
            self.class_cache = vec![u8::MAX; 1 << 18];
        }
        let table = job.colour_table.as_deref().or(stage.colour_table.as_ref());
        let (colours, ball) = (&job.vision.colours, job.vision.objects.ball_hue_deg);
        let mut scan = None;
        if job.selection.scan_pixels {
            let mut layer =
                ColorImage::filled([image.width_px, image.height_px], Color32::TRANSPARENT);
            let classes = eyes.classify_samples(&image.view());
            let classes = classes.map_err(|error| error.to_string())?.to_vec();
            for (sample, class) in eyes.scan_pattern().samples.iter().zip(classes) {
                let at = usize::from(sample.v) * image.width_px + usize::from(sample.u);
                layer.pixels[at] = palette::class_colour(class);
            }
            scan = Some(Arc::new(layer));
        }
        let classes = job.selection.classes.then(|| {
            let cells = &mut self.class_cache;
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
                palette::class_colour(ColourClass(*cell))
            });
            let size = [image.width_px, image.height_px];
            Arc::new(ColorImage::new(size, pixels.collect()))
        });
        Ok((classes, scan))
    }
}

type Layer = Option<Arc<ColorImage>>;

/// Index of the image's pixel under each of the bird's-eye view; `u32::MAX` where there is none.
fn birds_eye_pixels(stage: &StaticScene) -> Vec<u32> {
    let Some(eye) = &stage.camera else {
        return Vec::new();
    };
    let step = 2.0 * BIRDS_EYE_HALF_EXTENT / BIRDS_EYE_SIDE_PX as f32;
    let mut pixels = Vec::with_capacity(BIRDS_EYE_SIDE_PX * BIRDS_EYE_SIDE_PX);
    for row in 0..BIRDS_EYE_SIDE_PX {
        for column in 0..BIRDS_EYE_SIDE_PX {
            // Forward is up, left is left.
            let ground = At::<RobotFrame>::new(
                BIRDS_EYE_HALF_EXTENT - (row as f32 + 0.5) * step,
                BIRDS_EYE_HALF_EXTENT - (column as f32 + 0.5) * step,
            );
            let found = eye.inverse.project(&eye.map, ground);
            pixels.push(found.map_or(u32::MAX, |[u, v]| {
                v.round() as u32 * eye.map.width_px as u32 + u.round() as u32
            }));
        }
    }
    pixels
}

fn render_birds_eye(image: &Image, pixels: &[u32]) -> ColorImage {
    let colour = |&pixel: &u32| {
        let at = 3 * pixel as usize;
        image.rgb.get(at..at + 3).map_or(palette::FLOOR, |rgb| {
            Color32::from_rgb(rgb[0], rgb[1], rgb[2])
        })
    };
    let mut colours: Vec<Color32> = pixels.iter().map(colour).collect();
    colours.resize(BIRDS_EYE_SIDE_PX * BIRDS_EYE_SIDE_PX, palette::FLOOR);
    ColorImage::new([BIRDS_EYE_SIDE_PX, BIRDS_EYE_SIDE_PX], colours)
}

/// Columns and rows of a landscape over the carpet, and the value of each cell's middle; the first row is at the top.
///
/// On this thread alone: the pool's threads are the robot's.
fn render_over_field(stage: &StaticScene, value: impl Fn(f32, f32) -> f32) -> ColorImage {
    let (half_x, half_y) = stage.field.carpet_half_extent();
    let columns = (2.0 * half_x / HEATMAP_CELL).round().max(1.0) as usize;
    let rows = (2.0 * half_y / HEATMAP_CELL).round().max(1.0) as usize;
    let (step_x, step_y) = (2.0 * half_x / columns as f32, 2.0 * half_y / rows as f32);
    let pixels: Vec<Color32> = (0..rows * columns)
        .map(|cell| {
            let x = (cell % columns) as f32 * step_x + step_x / 2.0 - half_x;
            let y = half_y - (cell / columns) as f32 * step_y - step_y / 2.0;
            apply_colormap(value(x, y) / HEATMAP_MAX_DISTANCE)
        })
        .collect();
    ColorImage::new([columns, rows], pixels)
}

/// From bright yellow (0) over orange and purple to nearly black (1): brightness alone orders it.
fn apply_colormap(value: f32) -> Color32 {
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

fn render_distance_field(stage: &StaticScene) -> ColorImage {
    let distances: &DistanceField = &stage.distances;
    render_over_field(stage, |x, y| distances.nearest(x, y).signed_distance.abs())
}

/// Mean distance of the points from the markings, were the robot in the middle of each cell with this heading.
fn render_error_landscape(stage: &StaticScene, points: &[LinePoint], heading: f32) -> ColorImage {
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
    render_over_field(stage, |x, y| {
        // Far outliers would drown what the others say (nubot2013 bounds them alike).
        let distance = |at: &[f32; 2]| {
            let near = distances.nearest(x + at[0], y + at[1]);
            near.signed_distance.abs().min(HEATMAP_MAX_DISTANCE)
        };
        per * turned.iter().map(distance).sum::<f32>()
    })
}
