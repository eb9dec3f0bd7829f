//! Field panel: pose estimate, ground truth, objects and layers from above. Dragging moves the simulation's objects.

use std::sync::Arc;

use eframe::egui::{
    self, Color32, ColorImage, FontId, Pos2, Rect, Sense, TextureHandle, TextureOptions, Ui, Vec2,
};
use localize::At;

use super::field_contents::{FieldCanvas, status_text};
use super::field_drag::FieldDrag;
use super::field_drawing::{self as drawing, FieldTransform};
use super::field_layers::{FieldBackground, FieldLayers};
use super::field_marks;
use crate::view::labels::Labels;
use crate::view::layer_worker::LayerSelection;
use crate::view::palette;
use crate::view::panzoom::{PanZoom, fill_around};
use crate::view::pen::Pen;
use crate::view::session::Session;
use crate::view::static_scene::StaticScene;

/// Largest distance of a click from the object that it selects, points.
const SELECT_RADIUS: f32 = 12.0;

/// State of the panel.
#[derive(Default)]
pub(crate) struct FieldPanel {
    /// Visible layers.
    pub(crate) layers: FieldLayers,
    pub(super) pan_zoom: PanZoom,
    drag: FieldDrag,
    layer: Option<(Arc<ColorImage>, TextureHandle)>,
}

impl FieldPanel {
    /// The layers to render.
    pub(crate) fn layer_selection(&self) -> LayerSelection {
        LayerSelection {
            distance_field: self.layers.background == FieldBackground::DistanceField,
            error_landscape: self.layers.background == FieldBackground::ErrorLandscape,
            ..LayerSelection::default()
        }
    }

    /// The visible part of the field.
    #[cfg(test)]
    pub(crate) fn pan_zoom(&self) -> PanZoom {
        self.pan_zoom
    }

    /// Draws the panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, session: &mut Session) {
        self.switches(ui, session);
        let Some(scene) = session.scene.clone() else {
            ui.weak("This source has no field configuration.");
            return;
        };
        let half = drawing::view_half_extent(&scene.field);
        let line = ui.text_style_height(&egui::TextStyle::Body) + 6.0;
        let area = Vec2::new(
            ui.available_width().max(1.0),
            (ui.available_height() - line).max(1.0),
        );
        let (response, painter) = ui.allocate_painter(area, Sense::click_and_drag());
        let before = FieldTransform::new(self.pan_zoom.transform(response.rect, 2.0 * half), half);
        self.drag.start(&response, session, &before);
        let pans = self.drag.pans();
        let transform = self.pan_zoom.handle_input(ui, &response, 2.0 * half, pans);
        let screen = FieldTransform::new(transform, half);
        self.drag.update(ui, &response, session, &screen);
        if let Some(pointer) = response.interact_pointer_pos()
            && response.clicked()
            && !self.drag.measuring
        {
            let radius = SELECT_RADIUS / screen.scale();
            session.select_at(screen.to_field(pointer), radius);
        }
        let session = &*session;
        let pen = Pen::new(painter.with_clip_rect(response.rect));
        let carpet = drawing::carpet_rect(&screen, &scene.field);
        fill_around(&pen, response.rect, carpet, palette::FLOOR);
        let has_layer = self.draw_background(ui, pen.painter(), session, (&scene, &screen));
        drawing::draw_field(&pen, &screen, &scene.field, !has_layer);
        let status = pen.layout(
            status_text(session),
            FontId::proportional(13.0),
            Color32::WHITE,
        );
        let status_place = response.rect.left_top() + Vec2::new(6.0, 4.0);
        let labels = Labels::default();
        labels.keep_free(Rect::from_min_size(status_place, status.size()));
        let canvas = FieldCanvas {
            pen: &pen,
            screen: &screen,
            layers: &self.layers,
            session,
            labels: &labels,
        };
        canvas.draw_trails();
        if let Some(now) = &session.shown {
            // The landscape may be of an earlier cycle: what lies on it must be of the same one.
            let rendered = session.rendered_layers.cycle.as_ref();
            let landscape = has_layer && self.layers.background == FieldBackground::ErrorLandscape;
            let cycle = rendered.filter(|_| landscape).unwrap_or(&now.cycle);
            canvas.draw_estimate(cycle, &now.particles);
            canvas.draw_objects(cycle);
            canvas.draw_tracks(cycle);
        }
        canvas.draw_other_runs();
        if let Some(place) = session.selected_place() {
            field_marks::draw_selection(&pen, screen.to_screen(place));
        }
        if let Some(hovered) = session.hovered_time {
            field_marks::draw_hovered_moment(&pen, &screen, &session.series, hovered);
        }
        if has_layer {
            drawing::draw_distance_scale(&pen, response.rect);
        }
        field_marks::draw_scale(&pen, &screen, response.rect);
        self.drag.draw_measurement(&pen, &screen);
        labels.draw(&pen);
        pen.painter().galley(status_place, status, Color32::WHITE);
        match response.hover_pos() {
            Some(pointer) => {
                let at = screen.to_field(pointer);
                ui.label(format!("{:.2}, {:.2} m{}", at.x, at.y, self.drag.length()));
            }
            None if session.source.simulation().is_some() => {
                ui.weak(
                    "Drag a robot or the ball to move it. Scroll while dragging to rotate a robot.",
                );
            }
            None => {
                ui.weak("Scroll zooms, drag pans, double-click resets.");
            }
        }
    }

    fn switches(&mut self, ui: &mut Ui, session: &Session) {
        let layers = &mut self.layers;
        ui.horizontal_wrapped(|ui| {
            ui.menu_button("Layers", |ui| {
                for (name, shown) in [
                    ("Line points", &mut layers.line_points),
                    ("Trail", &mut layers.trail),
                    ("Truth", &mut layers.truth),
                    ("Covariance", &mut layers.covariance),
                    ("Hypotheses", &mut layers.hypotheses),
                    ("Particles", &mut layers.particles),
                    ("Ball and robots", &mut layers.objects),
                    ("Recomputed run", &mut layers.recomputed),
                ] {
                    ui.checkbox(shown, name);
                }
                ui.add(
                    egui::Slider::new(&mut layers.trail_s, 1.0..=600.0)
                        .logarithmic(true)
                        .suffix(" s")
                        .text("trail"),
                );
            });
            for (name, ground) in [
                ("Carpet", FieldBackground::Carpet),
                ("Distance field", FieldBackground::DistanceField),
                ("Error landscape", FieldBackground::ErrorLandscape),
            ] {
                ui.selectable_value(&mut layers.background, ground, name);
            }
            if ui
                .toggle_value(&mut self.drag.measuring, "Measure")
                .clicked()
            {
                self.drag.measurement = None;
            }
            ui.menu_button("Legend", field_marks::show_legend);
            if session.recompute.is_some() {
                ui.toggle_value(&mut layers.recomputed, "Recomputed");
            }
        });
    }

    /// Draws the background layer; false if there is none.
    fn draw_background(
        &mut self,
        ui: &Ui,
        painter: &egui::Painter,
        session: &Session,
        (scene, screen): (&StaticScene, &FieldTransform),
    ) -> bool {
        let rendered = &session.rendered_layers;
        let image = match self.layers.background {
            FieldBackground::Carpet => None,
            FieldBackground::DistanceField => rendered.distance_field.as_ref(),
            FieldBackground::ErrorLandscape => rendered.error_landscape.as_ref(),
        };
        let Some(image) = image else {
            return false;
        };
        let (cached, handle) = self.layer.get_or_insert_with(|| {
            let handle = ui.load_texture("ground", image.clone(), TextureOptions::LINEAR);
            (image.clone(), handle)
        });
        if !Arc::ptr_eq(cached, image) {
            handle.set(image.clone(), TextureOptions::LINEAR);
            *cached = image.clone();
        }
        let (half_x, half_y) = scene.field.carpet_half_extent();
        let rect = Rect::from_two_pos(
            screen.to_screen(At::new(-half_x, half_y)),
            screen.to_screen(At::new(half_x, -half_y)),
        );
        let uv = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
        painter.image(handle.id(), rect, uv, Color32::WHITE);
        true
    }
}
