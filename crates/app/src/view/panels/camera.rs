//! Camera panel: the image, or the bird's-eye view, with detections, rejected candidates and pixel layers.

use std::sync::Arc;

use eframe::egui::{
    self, Align2, Color32, ColorImage, FontId, Pos2, Rect, RichText, Sense, TextureHandle,
    TextureOptions, Ui, Vec2,
};
use localize::Stamp;
use localize::frames::{At, FieldFrame};
use vision::image::Image;

use super::camera_drawing::{self, CameraCanvas};
use super::camera_layers::CameraLayers;
use super::carpet_boundary::CarpetBoundary;
use super::projected_markings::ProjectedMarkings;
use crate::view::birds_eye::BIRDS_EYE_SIDE_PX;
use crate::view::brush::Tool;
use crate::view::labels::Labels;
use crate::view::layer_worker::LayerSelection;
use crate::view::panzoom::{PanZoom, ScreenTransform, fill_around};
use crate::view::pen::Pen;
use crate::view::pixel_info::PixelInfo;
use crate::view::session::Session;
use crate::view::source::decoded_cycle::rgb_image;
use crate::view::static_scene::StaticScene;
use pipeline::Cycle;

/// Largest distance of a click from the object that it selects, points.
const SELECT_RADIUS: f32 = 10.0;
/// The same on the ground, metres.
const SELECT_RADIUS_MIN: f32 = 0.05;
const SELECT_RADIUS_MAX: f32 = 0.5;

/// State of the panel.
#[derive(Default)]
pub(crate) struct CameraPanel {
    /// Visible layers.
    pub(crate) layers: CameraLayers,
    /// Show the bird's-eye view instead of the camera image.
    pub(crate) birds_eye: bool,
    pub(super) pan_zoom: PanZoom,
    image: Option<(Stamp, TextureHandle)>,
    classes: LayerTexture,
    scan_texture: LayerTexture,
    birds_eye_texture: LayerTexture,
    mask: LayerTexture,
    projected: ProjectedMarkings,
    boundary: CarpetBoundary,
    /// Rendered mask, and the key of its inputs.
    mask_image: Option<(MaskKey, Arc<ColorImage>)>,
}

type MaskKey = (u64, Option<*const StaticScene>);

/// Texture of a rendered layer.
#[derive(Default)]
struct LayerTexture {
    source: Option<Arc<ColorImage>>,
    handle: Option<TextureHandle>,
}

impl LayerTexture {
    fn update(&mut self, ui: &Ui, name: &str, image: &Arc<ColorImage>) -> egui::TextureId {
        let current = self
            .source
            .as_ref()
            .is_some_and(|of| Arc::ptr_eq(of, image));
        let handle = self
            .handle
            .get_or_insert_with(|| ui.load_texture(name, image.clone(), TextureOptions::NEAREST));
        if !current {
            handle.set(image.clone(), TextureOptions::NEAREST);
            self.source = Some(image.clone());
        }
        handle.id()
    }
}

impl CameraPanel {
    /// The layers to render.
    pub(crate) fn layer_selection(&self) -> LayerSelection {
        LayerSelection {
            classes: self.layers.classes && !self.birds_eye,
            virtual_sensors: self.layers.virtual_sensors && !self.birds_eye,
            scan_pixels: self.layers.scan_pixels && !self.birds_eye,
            birds_eye: self.birds_eye,
            ..LayerSelection::default()
        }
    }

    /// The visible part of the picture.
    #[cfg(test)]
    pub(crate) fn pan_zoom(&self) -> PanZoom {
        self.pan_zoom
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.switches(ui);
        let Some(now) = &session.shown else {
            ui.weak("No cycle yet.");
            return;
        };
        // Image and layers must show the same cycle, and rendering may lag behind.
        let rendered_cycle = session.rendered_layers.cycle.as_ref();
        let rendered_cycle =
            rendered_cycle.filter(|_| self.layer_selection() != LayerSelection::default());
        let cycle = rendered_cycle.unwrap_or(&now.cycle);
        let image = rgb_image(cycle).cloned();
        let size = match self.picture_size(image.as_deref(), session) {
            Ok(size) => size,
            Err(missing) => {
                ui.weak(missing);
                return;
            }
        };
        // The readout of a pixel may take a second line.
        let line = 2.0 * ui.text_style_height(&egui::TextStyle::Body) + 6.0;
        let area = Vec2::new(
            ui.available_width().max(1.0),
            (ui.available_height() - line).max(1.0),
        );
        let (response, painter) = ui.allocate_painter(area, Sense::click_and_drag());
        let painting = session.calibration.brush.tool != Tool::Pan && !self.birds_eye;
        let transform = self.pan_zoom.handle_input(ui, &response, size, !painting);
        let painter = painter.with_clip_rect(response.rect);
        let covered = if image.is_some() && self.layers.image && !self.birds_eye {
            transform.screen_rect(size)
        } else {
            Rect::NOTHING
        };
        let pen = Pen::new(painter);
        fill_around(&pen, response.rect, covered, Color32::BLACK);
        self.draw_layers(ui, pen.painter(), session, cycle, (&transform, size));
        self.draw_overlay(&pen, session, cycle, (transform, size));
        if image.is_none() {
            pen.text(
                response.rect.center_top() + Vec2::new(0.0, 8.0),
                Align2::CENTER_TOP,
                missing_image_text(cycle),
                FontId::proportional(15.0),
                Color32::WHITE,
            );
        }
        let pointer = response.interact_pointer_pos();
        let stroke = pointer
            .filter(|_| painting && (response.dragged() || response.clicked()))
            .zip(image.clone().map(|image| (cycle.stamp, image)));
        if let Some(pointer) = response.hover_pos() {
            if painting {
                let radius_px = f32::from(session.calibration.brush.radius_px);
                let radius = (radius_px + 0.5) * transform.scale;
                pen.circle(pointer, radius, (1.0, Color32::WHITE));
            }
            let at = transform.to_picture(pointer);
            let info = if self.birds_eye {
                PixelInfo::of_birds_eye(session, at.x, at.y)
            } else {
                PixelInfo::of_image(session, image.as_deref(), at.x, at.y)
            };
            ui.add(egui::Label::new(RichText::new(info.text()).small()).wrap());
            session.pointed_ground = info.ground;
        } else {
            ui.weak(
                "Point at a pixel to inspect it. Scroll zooms, drag pans, double-click resets.",
            );
        }
        let clicked = pointer.filter(|_| response.clicked() && !painting);
        if let Some((place, radius)) =
            clicked.and_then(|pointer| self.clicked_ground(session, &transform, pointer))
        {
            session.select_at(place, radius);
        }
        if let Some((pointer, (stamp, image))) = stroke {
            let at = transform.to_picture(pointer);
            session.calibration.brush.paint(stamp, &image, at);
        }
    }

    /// Draws detections, projected lines and the selection.
    fn draw_overlay(
        &mut self,
        pen: &Pen,
        session: &Session,
        cycle: &Cycle,
        (transform, size): (ScreenTransform, Vec2),
    ) {
        if let Some(scene) = &session.scene {
            if self.layers.field_lines && !self.birds_eye {
                self.projected.update(scene, cycle);
            }
            if self.layers.carpet_end && !self.birds_eye {
                self.boundary.update(scene, cycle);
            }
            let clipped = pen.clipped_to(transform.screen_rect(size));
            let canvas = CameraCanvas {
                pen: if self.birds_eye { &clipped } else { pen },
                transform,
                scene,
                cycle,
                layers: &self.layers,
                projected: &self.projected,
                boundary: &self.boundary,
                labels: Labels::default(),
                virtual_sensors: session
                    .rendered_layers
                    .virtual_sensors
                    .as_deref()
                    .map_or(&[], Vec::as_slice),
            };
            canvas.draw_selection(session.selection, self.birds_eye);
            if self.birds_eye {
                camera_drawing::draw_birds_eye_overlay(&canvas);
            } else {
                camera_drawing::draw_image_overlay(&canvas);
            }
        }
    }

    /// Size of what is shown, pixels; the reason if there is nothing.
    fn picture_size(&self, image: Option<&Image>, session: &Session) -> Result<Vec2, &'static str> {
        match (image, &session.scene) {
            _ if self.birds_eye => Ok(Vec2::splat(BIRDS_EYE_SIDE_PX as f32)),
            (Some(image), _) => Ok(Vec2::new(image.width_px as f32, image.height_px as f32)),
            (None, Some(scene)) => match &scene.camera {
                Some(camera) => Ok(Vec2::new(
                    camera.map.width_px as f32,
                    camera.map.height_px as f32,
                )),
                None => {
                    Err("This source has no camera: its line points come from an external vision.")
                }
            },
            (None, None) => Err("No image and no camera configuration."),
        }
    }

    /// Place on the field that a click points at, and the radius of the ground that it covers, metres.
    fn clicked_ground(
        &self,
        session: &Session,
        transform: &ScreenTransform,
        pointer: Pos2,
    ) -> Option<(At<FieldFrame>, f32)> {
        let at = transform.to_picture(pointer);
        let beside = at + Vec2::new(SELECT_RADIUS / transform.scale, 0.0);
        let [place, beside] = [at, beside].map(|at| {
            if self.birds_eye {
                PixelInfo::of_birds_eye(session, at.x, at.y).field
            } else {
                PixelInfo::of_image(session, None, at.x, at.y).field
            }
        });
        let place = place?;
        // The ground that a click covers grows with the distance.
        let radius = beside.map_or(SELECT_RADIUS_MIN, |beside| place.distance_to(beside));
        Some((place, radius.clamp(SELECT_RADIUS_MIN, SELECT_RADIUS_MAX)))
    }

    fn switches(&mut self, ui: &mut Ui) {
        let layers = &mut self.layers;
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Layers", |ui| {
                for (name, shown) in [
                    ("Image", &mut layers.image),
                    ("Classes", &mut layers.classes),
                    ("Scan lines", &mut layers.scan_pixels),
                    ("Line points", &mut layers.line_points),
                    ("Rejected points", &mut layers.rejected_candidates),
                    ("Ball", &mut layers.ball),
                    ("Robots", &mut layers.robots),
                    ("Goals", &mut layers.goals),
                    ("Carpet boundary", &mut layers.carpet_end),
                    ("Windows", &mut layers.virtual_sensors),
                    ("Mask", &mut layers.mask),
                    ("Field lines", &mut layers.field_lines),
                    ("Ground grid", &mut layers.grid),
                ] {
                    ui.checkbox(shown, name);
                }
            });
            ui.toggle_value(&mut self.birds_eye, "Bird's-eye");
            ui.toggle_value(&mut layers.classes, "Classes");
            ui.toggle_value(&mut layers.scan_pixels, "Scan lines");
            ui.toggle_value(&mut layers.virtual_sensors, "Windows");
            ui.toggle_value(&mut layers.field_lines, "Field lines");
            ui.menu_button("Legend", camera_drawing::show_legend);
        });
    }

    fn draw_layers(
        &mut self,
        ui: &Ui,
        painter: &egui::Painter,
        session: &Session,
        cycle: &Cycle,
        (transform, size): (&ScreenTransform, Vec2),
    ) {
        let rect = transform.screen_rect(size);
        let uv = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        let rendered = &session.rendered_layers;
        if self.birds_eye {
            if let Some(floor) = &rendered.birds_eye {
                let id = self.birds_eye_texture.update(ui, "floor", floor);
                painter.image(id, rect, uv, Color32::WHITE);
            }
            return;
        }
        if let (true, Some(image)) = (self.layers.image, rgb_image(cycle)) {
            let id = self.upload(ui, cycle.stamp, image);
            painter.image(id, rect, uv, Color32::WHITE);
        }
        if let (true, Some(classes)) = (self.layers.classes, &rendered.classes) {
            let id = self.classes.update(ui, "classes", classes);
            let tint = if self.layers.image { 190 } else { 255 };
            painter.image(id, rect, uv, Color32::from_white_alpha(tint));
        }
        if let (true, Some(scan)) = (self.layers.scan_pixels, &rendered.scan_pixels) {
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
                handle.set(to_color_image(image), TextureOptions::NEAREST);
                *of = stamp;
            }
            return handle.id();
        }
        let handle = ui.load_texture("camera", to_color_image(image), TextureOptions::NEAREST);
        let id = handle.id();
        self.image = Some((stamp, handle));
        id
    }
}

fn to_color_image(image: &Image) -> ColorImage {
    ColorImage::from_rgb([image.width_px, image.height_px], &image.rgb)
}

fn missing_image_text(cycle: &Cycle) -> String {
    match &cycle.image_fault {
        Some(fault) => format!("no image: {fault}"),
        None => "no image in this cycle".to_owned(),
    }
}

/// Image of the masked pixels (purple) and the pixels that show no ground (darkened).
fn render_mask(session: &Session) -> Option<ColorImage> {
    let scene = session.scene.as_ref()?;
    let camera = scene.camera.as_ref()?;
    let (width, height) = (camera.map.width_px, camera.map.height_px);
    let mask = session.mask.as_ref().or(scene.mask.as_ref());
    let pixel = |at: usize| {
        let masked = mask.is_some_and(|mask| mask.get(at) == Some(&false));
        if masked {
            Color32::from_rgba_unmultiplied(204, 121, 167, 170)
        } else if !camera.map.x[at].is_finite() {
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
