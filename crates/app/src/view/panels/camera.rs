//! What does the robot see, and what does it make of it? The image with everything that was found or refused in it.

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Color32, ColorImage, FontId, Pos2, Rect, RichText, Sense, TextureHandle,
    TextureOptions, Ui, Vec2,
};
use localize::Stamp;
use serde::{Deserialize, Serialize};
use vision::colour::lookup_table::{CLASS_NAMES, ColourClass};
use vision::image::{Image, rgb_to_yuv};

use super::camera_drawing::{self, CameraCanvas};
use crate::view::brush::{Brush, Tool};
use crate::view::layer_worker::{BIRDS_EYE_HALF_EXTENT, BIRDS_EYE_SIDE_PX, LayerSelection};
use crate::view::palette;
use crate::view::panzoom::{PanZoom, ScreenTransform, fill_around};
use crate::view::session::Session;
use crate::view::source::rgb_image;
use crate::view::static_scene::StaticScene;
use pipeline::Cycle;

/// What is drawn over the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct CameraLayers {
    /// The image itself.
    pub(crate) image: bool,
    /// The class of every pixel.
    pub(crate) classes: bool,
    /// The pixels that vision reads, in their classes' colours.
    pub(crate) scan_pixels: bool,
    /// Line points.
    pub(crate) line_points: bool,
    /// Runs that were refused.
    pub(crate) rejected_candidates: bool,
    /// The ball.
    pub(crate) ball: bool,
    /// Robots.
    pub(crate) robots: bool,
    /// Goals and posts.
    pub(crate) goals: bool,
    /// Where the carpet ends.
    pub(crate) carpet_end: bool,
    /// Virtual sensor windows.
    pub(crate) virtual_sensors: bool,
    /// What is masked, and what shows no ground.
    pub(crate) mask: bool,
    /// The field's lines at the estimated pose.
    pub(crate) field_lines: bool,
    /// Rings and rays on the ground.
    pub(crate) grid: bool,
}

impl Default for CameraLayers {
    fn default() -> Self {
        CameraLayers {
            image: true,
            classes: false,
            scan_pixels: false,
            line_points: true,
            rejected_candidates: true,
            ball: true,
            robots: true,
            goals: true,
            carpet_end: false,
            virtual_sensors: false,
            mask: false,
            field_lines: true,
            grid: false,
        }
    }
}

/// The panel's memory.
#[derive(Default)]
pub(crate) struct CameraPanel {
    /// What is drawn.
    pub(crate) layers: CameraLayers,
    /// The floor from above in place of the camera's image.
    pub(crate) birds_eye: bool,
    pan_zoom: PanZoom,
    image: Option<(Stamp, TextureHandle)>,
    classes: LayerTexture,
    scan_texture: LayerTexture,
    birds_eye_texture: LayerTexture,
    mask: LayerTexture,
    /// The mask as a picture, and what it was made of.
    mask_image: Option<(MaskKey, Arc<ColorImage>)>,
}

type MaskKey = (u64, Option<*const StaticScene>);

/// A painted layer on its way to the screen.
#[derive(Default)]
struct LayerTexture {
    source: Option<Arc<ColorImage>>,
    handle: Option<TextureHandle>,
}

impl LayerTexture {
    fn update(&mut self, ui: &Ui, name: &str, image: &Arc<ColorImage>) -> egui::TextureId {
        let known = self
            .source
            .as_ref()
            .is_some_and(|of| Arc::ptr_eq(of, image));
        let handle = self
            .handle
            .get_or_insert_with(|| ui.load_texture(name, image.clone(), TextureOptions::NEAREST));
        if !known {
            handle.set(image.clone(), TextureOptions::NEAREST);
            self.source = Some(image.clone());
        }
        handle.id()
    }
}

impl CameraPanel {
    /// Which layers are to be painted.
    pub(crate) fn layer_selection(&self) -> LayerSelection {
        LayerSelection {
            classes: self.layers.classes && !self.birds_eye,
            virtual_sensors: self.layers.virtual_sensors && !self.birds_eye,
            scan_pixels: self.layers.scan_pixels && !self.birds_eye,
            birds_eye: self.birds_eye,
            ..LayerSelection::default()
        }
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &Session, brush: &mut Brush) {
        self.switches(ui);
        let Some(now) = &session.shown else {
            ui.weak("No cycle yet.");
            return;
        };
        // A picture and what is painted of it are of one cycle, though the painter may be a little behind.
        let painted = session.rendered_layers.cycle.as_ref();
        let painted = painted.filter(|_| self.layer_selection() != LayerSelection::default());
        let cycle = painted.unwrap_or(&now.cycle);
        let image = rgb_image(cycle).cloned();
        let size = match (&image, &session.scene) {
            _ if self.birds_eye => Vec2::splat(BIRDS_EYE_SIDE_PX as f32),
            (Some(image), _) => Vec2::new(image.width_px as f32, image.height_px as f32),
            (None, Some(stage)) => match &stage.camera {
                Some(eye) => Vec2::new(eye.map.width_px as f32, eye.map.height_px as f32),
                None => {
                    ui.weak("This source has no camera: its line points come from elsewhere.");
                    return;
                }
            },
            (None, None) => {
                ui.weak("No image, and no camera to draw into.");
                return;
            }
        };
        let line = ui.text_style_height(&egui::TextStyle::Body) + 6.0;
        let area = Vec2::new(
            ui.available_width().max(1.0),
            (ui.available_height() - line).max(1.0),
        );
        let (response, painter) = ui.allocate_painter(area, Sense::click_and_drag());
        let painting = brush.tool != Tool::Pan && !self.birds_eye;
        let placed = self.pan_zoom.handle_input(ui, &response, size, !painting);
        let painter = painter.with_clip_rect(response.rect);
        let covered = if image.is_some() && self.layers.image && !self.birds_eye {
            placed.screen_rect(size)
        } else {
            Rect::NOTHING
        };
        fill_around(&painter, response.rect, covered, Color32::BLACK);
        self.draw_layers(ui, &painter, session, cycle, (&placed, size));
        if let Some(stage) = &session.scene {
            let drawing = CameraCanvas {
                painter: &painter,
                transform: placed,
                scene: stage,
                cycle,
                layers: &self.layers,
                virtual_sensors: session
                    .rendered_layers
                    .virtual_sensors
                    .as_deref()
                    .map_or(&[], Vec::as_slice),
            };
            if self.birds_eye {
                camera_drawing::draw_birds_eye_overlay(&drawing);
            } else {
                camera_drawing::draw_image_overlay(&drawing);
            }
        }
        if image.is_none() {
            painter.text(
                response.rect.center_top() + Vec2::new(0.0, 8.0),
                Align2::CENTER_TOP,
                no_image(cycle),
                FontId::proportional(15.0),
                Color32::WHITE,
            );
        }
        if painting
            && (response.dragged() || response.clicked())
            && let (Some(pointer), Some(image)) = (response.interact_pointer_pos(), &image)
        {
            brush.paint(cycle.stamp, image, placed.from_screen(pointer));
        }
        if let Some(pointer) = response.hover_pos() {
            if painting {
                let radius = (f32::from(brush.radius_px) + 0.5) * placed.scale;
                painter.circle_stroke(pointer, radius, (1.0, Color32::WHITE));
            }
            self.show_pixel_info(ui, session, image.as_deref(), placed.from_screen(pointer));
        } else {
            ui.weak(
                "Point at a pixel to read it. Scroll zooms, drag pans, double-click shows all.",
            );
        }
    }

    fn switches(&mut self, ui: &mut Ui) {
        let shows = &mut self.layers;
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Layers", |ui| {
                for (name, shown) in [
                    ("Image", &mut shows.image),
                    ("Classes", &mut shows.classes),
                    ("Scan lines", &mut shows.scan_pixels),
                    ("Line points", &mut shows.line_points),
                    ("Refused points", &mut shows.rejected_candidates),
                    ("Ball", &mut shows.ball),
                    ("Robots", &mut shows.robots),
                    ("Goals", &mut shows.goals),
                    ("Carpet's end", &mut shows.carpet_end),
                    ("Windows", &mut shows.virtual_sensors),
                    ("Mask", &mut shows.mask),
                    ("Field lines", &mut shows.field_lines),
                    ("Ground grid", &mut shows.grid),
                ] {
                    ui.checkbox(shown, name);
                }
            });
            ui.toggle_value(&mut self.birds_eye, "Bird's-eye");
            ui.toggle_value(&mut shows.classes, "Classes");
            ui.toggle_value(&mut shows.scan_pixels, "Scan lines");
            ui.toggle_value(&mut shows.virtual_sensors, "Windows");
            ui.toggle_value(&mut shows.field_lines, "Field lines");
            ui.menu_button("Key", camera_drawing::show_legend);
        });
    }

    fn draw_layers(
        &mut self,
        ui: &Ui,
        painter: &egui::Painter,
        session: &Session,
        cycle: &Cycle,
        (placed, size): (&ScreenTransform, Vec2),
    ) {
        let rect = placed.screen_rect(size);
        let uv = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        let painted = &session.rendered_layers;
        if self.birds_eye {
            if let Some(floor) = &painted.birds_eye {
                let id = self.birds_eye_texture.update(ui, "floor", floor);
                painter.image(id, rect, uv, Color32::WHITE);
            }
            return;
        }
        if let (true, Some(image)) = (self.layers.image, rgb_image(cycle)) {
            let id = self.upload(ui, cycle.stamp, image);
            painter.image(id, rect, uv, Color32::WHITE);
        }
        if let (true, Some(classes)) = (self.layers.classes, &painted.classes) {
            let id = self.classes.update(ui, "classes", classes);
            let tint = if self.layers.image { 190 } else { 255 };
            painter.image(id, rect, uv, Color32::from_white_alpha(tint));
        }
        if let (true, Some(scan)) = (self.layers.scan_pixels, &painted.scan_pixels) {
            let id = self.scan_texture.update(ui, "scan", scan);
            painter.image(id, rect, uv, Color32::WHITE);
        }
        if self.layers.mask {
            let key = (session.revision, session.scene.as_ref().map(Arc::as_ptr));
            if self.mask_image.as_ref().is_none_or(|(of, _)| *of != key) {
                let mask = render_mask(session).map(Arc::new);
                self.mask_image = mask.map(|mask| (key, mask));
            }
            if let Some((_, mask)) = &self.mask_image {
                let id = self.mask.update(ui, "mask", mask);
                painter.image(id, rect, uv, Color32::WHITE);
            }
        }
    }

    fn upload(&mut self, ui: &Ui, stamp: Stamp, image: &Image) -> egui::TextureId {
        if let Some((of, handle)) = &mut self.image {
            if *of != stamp {
                handle.set(colours(image), TextureOptions::NEAREST);
                *of = stamp;
            }
            return handle.id();
        }
        let handle = ui.load_texture("camera", colours(image), TextureOptions::NEAREST);
        let id = handle.id();
        self.image = Some((stamp, handle));
        id
    }

    /// What is there: colour, class, ground.
    fn show_pixel_info(&self, ui: &mut Ui, session: &Session, image: Option<&Image>, at: Vec2) {
        let (Some(stage), Some(now)) = (&session.scene, &session.shown) else {
            return;
        };
        let mut words = Vec::new();
        let ground = if self.birds_eye {
            let step = 2.0 * BIRDS_EYE_HALF_EXTENT / BIRDS_EYE_SIDE_PX as f32;
            Some(localize::At::new(
                BIRDS_EYE_HALF_EXTENT - at.y * step,
                BIRDS_EYE_HALF_EXTENT - at.x * step,
            ))
        } else {
            let (column, row) = (at.x.floor(), at.y.floor());
            let inside = column >= 0.0 && row >= 0.0;
            if let Some(image) = image.filter(|_| inside)
                && (column as usize) < image.width_px
                && (row as usize) < image.height_px
            {
                let (u, v) = (column as usize, row as usize);
                let rgb = image.view().rgb(u, v);
                let [y, cb, cr] = rgb_to_yuv(rgb);
                words.push(format!("({u}, {v})  YUV {y} {cb} {cr}  RGB {rgb:?}"));
                if let Some(class) = self.class_at(session, u, v) {
                    words.push(class.to_owned());
                }
            }
            let eye = stage.camera.as_ref();
            eye.and_then(|eye| inside.then(|| eye.map.at(column as usize, row as usize))?)
        };
        match ground {
            Some(ground) => {
                words.push(format!(
                    "ground {:.2}, {:.2} m, {:.2} m away at {:.0}°",
                    ground.x,
                    ground.y,
                    ground.distance(),
                    ground.bearing().to_degrees()
                ));
                if let Some(pose) = now.cycle.estimate.pose {
                    let at = pose * ground;
                    words.push(format!("field {:.2}, {:.2} m", at.x, at.y));
                }
            }
            None => words.push("no ground".to_owned()),
        }
        ui.label(RichText::new(words.join("   ")).monospace());
    }

    fn class_at(&self, session: &Session, u: usize, v: usize) -> Option<&'static str> {
        let painted = session.rendered_layers.classes.as_ref()?;
        let colour = *painted.pixels.get(v * painted.size[0] + u)?;
        let found =
            (0..CLASS_NAMES.len()).find(|&c| palette::class_colour(ColourClass(c as u8)) == colour);
        found.map(|class| CLASS_NAMES[class])
    }
}

fn colours(image: &Image) -> ColorImage {
    ColorImage::from_rgb([image.width_px, image.height_px], &image.rgb)
}

fn no_image(cycle: &Cycle) -> String {
    match &cycle.fault {
        Some(fault) => format!("no image: {fault}"),
        None => "no image in this cycle".to_owned(),
    }
}

/// What is masked (crossed out in purple) and what shows no ground (darkened).
fn render_mask(session: &Session) -> Option<ColorImage> {
    let stage = session.scene.as_ref()?;
    let eye = stage.camera.as_ref()?;
    let (width, height) = (eye.map.width_px, eye.map.height_px);
    let mask = session.mask.as_ref().or(stage.mask.as_ref());
    let pixel = |at: usize| {
        let masked = mask.is_some_and(|mask| mask.get(at) == Some(&false));
        if masked {
            Color32::from_rgba_unmultiplied(204, 121, 167, 170)
        } else if !eye.map.x[at].is_finite() {
            Color32::from_black_alpha(150)
        } else {
            Color32::TRANSPARENT
        }
    };
    Some(ColorImage::new(
        [width, height],
        (0..width * height).map(pixel).collect(),
    ))
}
