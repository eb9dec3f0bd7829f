//! Pan and zoom of a picture: scroll zooms at the pointer, drag pans, double-click resets.

use eframe::egui::{Color32, Pos2, Rect, Response, Ui, Vec2};

use super::panel_command::PanelCommand;
use super::pen::Pen;

/// Zoom limits; 1 fits the whole picture.
const ZOOM_RANGE: [f32; 2] = [0.5, 60.0];
/// Scrolled points per zoom factor of e.
const SCROLL_POINTS_PER_E_FOLD: f32 = 300.0;

/// Share of the visible part that a key moves by.
const PAN_SHARE: f32 = 0.1;

/// The visible part of a picture; its x axis points right, its y axis down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PanZoom {
    /// Zoom factor; 1 fits the whole picture.
    pub(crate) zoom: f32,
    /// Picture position at the panel's centre, as a fraction of the picture's size.
    pub(crate) centre: Vec2,
}

impl Default for PanZoom {
    fn default() -> Self {
        PanZoom {
            zoom: 1.0,
            centre: Vec2::splat(0.5),
        }
    }
}

/// Transform from picture to screen coordinates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScreenTransform {
    /// Screen position of the picture's top left corner.
    pub(crate) origin: Pos2,
    /// Screen points per picture unit.
    pub(crate) scale: f32,
}

impl PanZoom {
    /// Applies pointer and wheel input; `size` is the picture's. Dragging pans if `pans`.
    pub(crate) fn handle_input(
        &mut self,
        ui: &Ui,
        response: &Response,
        size: Vec2,
        pans: bool,
    ) -> ScreenTransform {
        let area = response.rect;
        if pans && response.dragged() {
            let scale = self.scale(area, size);
            self.centre -= response.drag_delta() / (scale * size);
        }
        if let Some(pointer) = response.hover_pos() {
            let scrolled = ui.input(|input| input.smooth_scroll_delta().y);
            let pinched = ui.input(|input| input.zoom_delta());
            let factor = (scrolled / SCROLL_POINTS_PER_E_FOLD).exp() * pinched;
            if factor != 1.0 {
                let before = self.transform(area, size).to_picture(pointer);
                self.zoom = (self.zoom * factor).clamp(ZOOM_RANGE[0], ZOOM_RANGE[1]);
                let after = self.transform(area, size).to_picture(pointer);
                self.centre += (before - after) / size;
            }
        }
        if response.double_clicked() {
            *self = PanZoom::default();
        }
        self.centre = self.centre.clamp(Vec2::ZERO, Vec2::splat(1.0));
        self.transform(area, size)
    }

    /// Does what keys ask for.
    pub(crate) fn apply(&mut self, command: PanelCommand) {
        match command {
            PanelCommand::Pan(step) => self.centre += PAN_SHARE / self.zoom * Vec2::from(step),
            PanelCommand::Zoom(factor) => {
                self.zoom = (self.zoom * factor).clamp(ZOOM_RANGE[0], ZOOM_RANGE[1]);
            }
            PanelCommand::ShowAll => *self = PanZoom::default(),
        }
    }

    /// The transform that places the picture in a screen area.
    pub(crate) fn transform(&self, area: Rect, size: Vec2) -> ScreenTransform {
        let scale = self.scale(area, size);
        ScreenTransform {
            origin: area.center() - self.centre * size * scale,
            scale,
        }
    }

    fn scale(&self, area: Rect, size: Vec2) -> f32 {
        let whole = (area.width() / size.x).min(area.height() / size.y);
        (whole * self.zoom).max(1e-3)
    }
}

/// Fills `outer` except `inner`: a software renderer also pays for pixels that are painted over later.
pub(crate) fn fill_around(pen: &Pen, outer: Rect, inner: Rect, colour: Color32) {
    let inner = inner.intersect(outer);
    if !inner.is_positive() {
        pen.rect(outer, colour);
        return;
    }
    let [left, right] = [outer.left()..=inner.left(), inner.right()..=outer.right()];
    let [above, below] = [outer.top()..=inner.top(), inner.bottom()..=outer.bottom()];
    let bands = [
        Rect::from_x_y_ranges(outer.x_range(), above),
        Rect::from_x_y_ranges(outer.x_range(), below),
        Rect::from_x_y_ranges(left, inner.y_range()),
        Rect::from_x_y_ranges(right, inner.y_range()),
    ];
    for band in bands.into_iter().filter(Rect::is_positive) {
        pen.rect(band, colour);
    }
}

impl ScreenTransform {
    /// Screen position of a picture point.
    pub(crate) fn to_screen(self, x: f32, y: f32) -> Pos2 {
        self.origin + self.scale * Vec2::new(x, y)
    }

    /// Picture point at a screen position.
    pub(crate) fn to_picture(self, at: Pos2) -> Vec2 {
        (at - self.origin) / self.scale
    }

    /// Screen area of the whole picture.
    pub(crate) fn screen_rect(self, size: Vec2) -> Rect {
        Rect::from_min_size(self.origin, size * self.scale)
    }
}
