//! Which part is seen, how large? Scroll to zoom about the pointer, drag to pan, double-click for the whole.

use eframe::egui::{Color32, Painter, Pos2, Rect, Response, Ui, Vec2};

/// Least and most enlargement over the whole picture.
const ZOOM_RANGE: [f32; 2] = [0.5, 60.0];
/// Scrolled points for an enlargement by e.
const SCROLL_POINTS_PER_E_FOLD: f32 = 300.0;

/// A part of a picture whose coordinates are `f32` pairs, x to the right, y down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PanZoom {
    /// Enlargement over the whole picture.
    pub(crate) zoom: f32,
    /// What is in the middle, as a part of the picture's size.
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

/// How a picture lies on the screen.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScreenTransform {
    /// Where its left top corner is.
    pub(crate) origin: Pos2,
    /// Points a unit of the picture.
    pub(crate) scale: f32,
}

impl PanZoom {
    /// Follows pointer and wheel; `size`: the picture's. Dragging pans where `pans`.
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
                let before = self.transform(area, size).from_screen(pointer);
                self.zoom = (self.zoom * factor).clamp(ZOOM_RANGE[0], ZOOM_RANGE[1]);
                let after = self.transform(area, size).from_screen(pointer);
                self.centre += (before - after) / size;
            }
        }
        if response.double_clicked() {
            *self = PanZoom::default();
        }
        self.centre = self.centre.clamp(Vec2::ZERO, Vec2::splat(1.0));
        self.transform(area, size)
    }

    /// How the picture lies in an area.
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

/// Paints what of `outer` lies outside `inner`: a software renderer pays for every pixel, those that are covered later too.
pub(crate) fn fill_around(painter: &Painter, outer: Rect, inner: Rect, colour: Color32) {
    // The edges, which are smoothed, lie under the picture.
    let inner = inner.shrink(1.0).intersect(outer);
    if !inner.is_positive() {
        painter.rect_filled(outer, 0.0, colour);
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
        painter.rect_filled(band, 0.0, colour);
    }
}

impl ScreenTransform {
    /// Where a place of the picture is on the screen.
    pub(crate) fn to_screen(self, x: f32, y: f32) -> Pos2 {
        self.origin + self.scale * Vec2::new(x, y)
    }

    /// Which place of the picture is there.
    pub(crate) fn from_screen(self, at: Pos2) -> Vec2 {
        (at - self.origin) / self.scale
    }

    /// The whole picture on the screen.
    pub(crate) fn screen_rect(self, size: Vec2) -> Rect {
        Rect::from_min_size(self.origin, size * self.scale)
    }
}
