//! Renders the pixel layers in a separate thread: classes, bird's-eye view, distance field and error landscape.
//!
//! A new job replaces a waiting one, so that only the newest cycle is rendered.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

use eframe::egui::{Color32, ColorImage};
use localize::sample::LinePoint;
use localize::{DistanceField, Stamp};
use vision::colour::colour_table::ColourTable;
use vision::colour::lookup_table::ColourClass;
use vision::config::{ImageRect, VisionConfig};
use vision::image::{Image, rgb_to_yuv};
use vision::process::Vision;

use super::birds_eye::BirdsEye;
use super::palette;
use super::source::decoded_cycle::rgb_image;
use super::static_scene::StaticScene;
use pipeline::Cycle;

/// Cell size of the distance field and the error landscape, metres.
pub(crate) const HEATMAP_CELL: f32 = 0.1;
/// Distance drawn darkest, metres: half the gap between the league's nearest parallel lines.
pub(super) const HEATMAP_MAX_DISTANCE: f32 = 0.75;

/// The layers to render.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct LayerSelection {
    /// Colour class of every pixel.
    pub(crate) classes: bool,
    /// Colour class of the pixels that vision samples.
    pub(crate) scan_pixels: bool,
    /// Windows of the virtual sensors.
    pub(crate) virtual_sensors: bool,
    /// Bird's-eye view of the ground.
    pub(crate) birds_eye: bool,
    /// Distance to the nearest marking, over the field.
    pub(crate) distance_field: bool,
    /// Mean distance of the cycle's line points to the markings, over assumed robot positions (minho2016).
    pub(crate) error_landscape: bool,
}

impl LayerSelection {
    /// The layers of both.
    pub(crate) fn union(self, other: Self) -> Self {
        LayerSelection {
            classes: self.classes || other.classes,
            scan_pixels: self.scan_pixels || other.scan_pixels,
            virtual_sensors: self.virtual_sensors || other.virtual_sensors,
            birds_eye: self.birds_eye || other.birds_eye,
            distance_field: self.distance_field || other.distance_field,
            error_landscape: self.error_landscape || other.error_landscape,
        }
    }
}

/// One cycle to render.
#[derive(Clone)]
pub(crate) struct LayerJob {
    pub(crate) scene: Arc<StaticScene>,
    pub(crate) cycle: Arc<Cycle>,
    pub(crate) vision: VisionConfig,
    /// Colour table from painted labels; overrides the robot's own.
    pub(crate) colour_table: Option<Arc<ColourTable>>,
    /// One entry per pixel; false where the robot sees itself.
    pub(crate) mask: Option<Arc<Vec<bool>>>,
    /// Counts changes of settings, colour table and mask.
    pub(crate) revision: u64,
    pub(crate) selection: LayerSelection,
}

/// Rendered layers of one cycle.
#[derive(Clone, Default)]
pub(crate) struct RenderedLayers {
    /// The cycle they show.
    pub(crate) cycle: Option<Arc<Cycle>>,
    pub(crate) classes: Option<Arc<ColorImage>>,
    /// Class of every pixel of `classes`.
    pub(crate) class_indices: Option<Arc<Vec<u8>>>,
    pub(crate) scan_pixels: Option<Arc<ColorImage>>,
    pub(crate) birds_eye: Option<Arc<ColorImage>>,
    pub(crate) virtual_sensors: Option<Arc<Vec<(&'static str, ImageRect)>>>,
    pub(crate) distance_field: Option<Arc<ColorImage>>,
    pub(crate) error_landscape: Option<Arc<ColorImage>>,
    /// Why the class layers could not be rendered.
    pub(crate) error: Option<String>,
}

#[derive(Default)]
struct Mailbox {
    job: Option<LayerJob>,
    result: Option<RenderedLayers>,
    closed: bool,
}

/// Handle of the rendering thread, with at most one job and one result waiting.
pub(crate) struct LayerWorker {
    mailbox: Arc<(Mutex<Mailbox>, Condvar)>,
    last_request: Option<(Stamp, u64, LayerSelection)>,
}

impl LayerWorker {
    /// Starts the thread; it calls `wake` after each rendered job.
    pub(crate) fn start(wake: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let mailbox = Arc::new((Mutex::new(Mailbox::default()), Condvar::new()));
        let thread_mailbox = mailbox.clone();
        std::thread::Builder::new()
            .name("layers".to_owned())
            .spawn(move || run_worker(&thread_mailbox, &wake))?;
        Ok(LayerWorker {
            mailbox,
            last_request: None,
        })
    }

    /// Submits a job and replaces a waiting one. A job equal to the last one is ignored.
    pub(crate) fn submit(&mut self, job: LayerJob) {
        let key = (job.cycle.stamp, job.revision, job.selection);
        if job.selection == LayerSelection::default() || self.last_request == Some(key) {
            return;
        }
        self.last_request = Some(key);
        lock(&self.mailbox.0).job = Some(job);
        self.mailbox.1.notify_all();
    }

    /// The result, if one is ready.
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

fn lock(mailbox: &Mutex<Mailbox>) -> std::sync::MutexGuard<'_, Mailbox> {
    mailbox.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run_worker(mailbox: &(Mutex<Mailbox>, Condvar), wake: &impl Fn()) {
    let mut renderer = LayerRenderer::default();
    loop {
        let mut guard = lock(&mailbox.0);
        while guard.job.is_none() && !guard.closed {
            guard = mailbox
                .1
                .wait(guard)
                .unwrap_or_else(PoisonError::into_inner);
        }
        if guard.closed {
            return;
        }
        let job = guard.job.take();
        drop(guard);
        if let Some(job) = job {
            let layers = renderer.render(&job);
            lock(&mailbox.0).result = Some(layers);
            wake();
        }
    }
}

/// Caches of the rendering thread.
#[derive(Default)]
struct LayerRenderer {
    vision: Option<(u64, Vision)>,
    /// Class by the upper six bits of R, G and B; 255 if not computed yet.
    class_cache: Vec<u8>,
    /// Carpet model of `class_cache`.
    carpet_model: Option<vision::colour::carpet_model::CarpetModel>,
    birds_eye: BirdsEye,
    distance_layer: Option<(usize, Arc<ColorImage>)>,
}

impl LayerRenderer {
    fn render(&mut self, job: &LayerJob) -> RenderedLayers {
        let mut layers = RenderedLayers {
            cycle: Some(job.cycle.clone()),
            ..RenderedLayers::default()
        };
        let scene = &job.scene;
        let key = Arc::as_ptr(scene) as usize;
        if let (Some(image), Some(camera)) = (rgb_image(&job.cycle), &scene.camera)
            && (image.width_px, image.height_px) == (camera.map.width_px, camera.map.height_px)
        {
            if job.selection.classes || job.selection.scan_pixels || job.selection.virtual_sensors {
                match self.render_classes(job, image) {
                    Ok(rendered) => {
                        layers.classes = rendered.classes;
                        layers.class_indices = rendered.class_indices;
                        layers.scan_pixels = rendered.scan_pixels;
                    }
                    Err(error) => layers.error = Some(error),
                }
                let vision = self
                    .vision
                    .as_ref()
                    .filter(|_| job.selection.virtual_sensors);
                layers.virtual_sensors =
                    vision.map(|(_, vision)| Arc::new(vision.virtual_sensor_regions().to_vec()));
            }
            if job.selection.birds_eye {
                let correction = job.cycle.estimate.map_correction.as_ref();
                let view = self.birds_eye.render(scene, image, correction);
                layers.birds_eye = Some(Arc::new(view));
            }
        }
        if job.selection.distance_field {
            if self
                .distance_layer
                .as_ref()
                .is_none_or(|(cached, _)| *cached != key)
            {
                self.distance_layer = Some((key, Arc::new(render_distance_field(scene))));
            }
            layers.distance_field = self.distance_layer.as_ref().map(|(_, image)| image.clone());
        }
        if job.selection.error_landscape {
            let heading = job.cycle.estimate.pose.map(|pose| pose.theta);
            let heading = heading.or(job.cycle.inputs.compass.last().map(|last| last.heading));
            layers.error_landscape = Some(Arc::new(render_error_landscape(
                scene,
                &job.cycle.line_points,
                heading.unwrap_or(0.0),
            )));
        }
        layers
    }

    /// Renders the classes of all pixels, and of the sampled pixels.
    fn render_classes(&mut self, job: &LayerJob, image: &Image) -> Result<ClassLayers, String> {
        let scene = &job.scene;
        let camera = scene.camera.as_ref().ok_or("no camera")?;
        if self
            .vision
            .as_ref()
            .is_none_or(|(of, _)| *of != job.revision)
        {
            let width = scene.field.config.line_width;
            let mask = job.mask.as_ref().map(|mask| mask.as_slice());
            let mut vision =
                Vision::with_mask(&camera.map, &camera.config, mask, width, job.vision.clone())
                    .map_err(|error| error.to_string())?;
            if let Some(table) = job.colour_table.as_deref().or(scene.colour_table.as_ref()) {
                vision.set_colour_table(table.clone());
            }
            self.vision = Some((job.revision, vision));
            self.carpet_model = None;
        }
        let Some((_, vision)) = &mut self.vision else {
            return Err("vision is not initialised".to_owned());
        };
        vision
            .process_lines(&image.view())
            .map_err(|error| error.to_string())?;
        let model = *vision.carpet_model().ok_or("no carpet colour learned")?;
        if self.carpet_model != Some(model) {
            self.carpet_model = Some(model);
            self.class_cache = vec![u8::MAX; 1 << 18];
        }
        let table = job.colour_table.as_deref().or(scene.colour_table.as_ref());
        let (colours, ball) = (&job.vision.colours, job.vision.objects.ball_hue_deg);
        let mut scan = None;
        if job.selection.scan_pixels {
            let mut layer =
                ColorImage::filled([image.width_px, image.height_px], Color32::TRANSPARENT);
            let classes = vision.classify_samples(&image.view());
            let classes = classes.map_err(|error| error.to_string())?.to_vec();
            for (sample, class) in vision.scan_pattern().samples.iter().zip(classes) {
                let at = usize::from(sample.v) * image.width_px + usize::from(sample.u);
                layer.pixels[at] = palette::class_colour(class);
            }
            scan = Some(Arc::new(layer));
        }
        let class_indices = job.selection.classes.then(|| -> Vec<u8> {
            let cells = &mut self.class_cache;
            let indices = image.rgb.chunks_exact(3).map(|rgb| {
                let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(|channel| usize::from(channel >> 2));
                let cell = &mut cells[r << 12 | g << 6 | b];
                if *cell == u8::MAX {
                    let middle = [r, g, b].map(|channel| (channel << 2 | 2) as u8);
                    *cell = match table {
                        Some(table) => table.class(rgb_to_yuv(middle)).0,
                        None => model.classify(middle, colours, ball).0,
                    };
                }
                *cell
            });
            indices.collect()
        });
        let classes = class_indices.as_ref().map(|indices| {
            let colour = |&class: &u8| palette::class_colour(ColourClass(class));
            let size = [image.width_px, image.height_px];
            Arc::new(ColorImage::new(size, indices.iter().map(colour).collect()))
        });
        Ok(ClassLayers {
            classes,
            class_indices: class_indices.map(Arc::new),
            scan_pixels: scan,
        })
    }
}

/// The class layers of one image; None if not selected.
struct ClassLayers {
    classes: Option<Arc<ColorImage>>,
    class_indices: Option<Arc<Vec<u8>>>,
    scan_pixels: Option<Arc<ColorImage>>,
}

/// Image pixel index of each bird's-eye pixel; `u32::MAX` if not visible.
/// Heat map over the carpet of `value`, a distance (m), at each cell's centre; the first row is at the top.
///
/// Runs on this thread only: the rayon pool belongs to the pipeline.
fn render_over_field(scene: &StaticScene, value: impl Fn(f32, f32) -> f32) -> ColorImage {
    let (half_x, half_y) = scene.field.carpet_half_extent();
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

/// Colour map from bright yellow (0) over orange and purple to nearly black (1); its brightness is monotonic.
pub(super) fn apply_colormap(value: f32) -> Color32 {
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

fn render_distance_field(scene: &StaticScene) -> ColorImage {
    let distances: &DistanceField = &scene.distances;
    render_over_field(scene, |x, y| distances.nearest(x, y).signed_distance.abs())
}

/// Mean distance of the line points to the markings for a robot at each cell's centre with this heading.
fn render_error_landscape(scene: &StaticScene, points: &[LinePoint], heading: f32) -> ColorImage {
    let (sin, cos) = heading.sin_cos();
    let rotated: Vec<[f32; 2]> = points
        .iter()
        .map(|point| {
            let at = point.at;
            [cos * at.x - sin * at.y, sin * at.x + cos * at.y]
        })
        .collect();
    let weight = 1.0 / rotated.len().max(1) as f32;
    let distances = &scene.distances;
    render_over_field(scene, |x, y| {
        // Distances are bounded so that outliers do not dominate (as in nubot2013).
        let distance = |at: &[f32; 2]| {
            let nearest = distances.nearest(x + at[0], y + at[1]);
            nearest.signed_distance.abs().min(HEATMAP_MAX_DISTANCE)
        };
        weight * rotated.iter().map(distance).sum::<f32>()
    })
}
