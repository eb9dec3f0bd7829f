//! The tiles of the window: each draws its panel.

use eframe::egui::{Frame, StrokeKind, Ui, WidgetText};

use super::current_panel::CurrentPanel;
use super::panels::{PanelId, Panels};
use super::session::Session;

/// Draws the panels in their tiles.
pub(crate) struct PaneBehavior<'a> {
    pub(crate) session: &'a mut Session,
    pub(crate) panels: &'a mut Panels,
    pub(crate) current: &'a mut CurrentPanel,
}

impl egui_tiles::Behavior<PanelId> for PaneBehavior<'_> {
    fn pane_ui(
        &mut self,
        ui: &mut Ui,
        _tile: egui_tiles::TileId,
        id: &mut PanelId,
    ) -> egui_tiles::UiResponse {
        let area = ui.max_rect();
        if ui.input(|input| input.pointer.any_pressed()) && ui.rect_contains_pointer(area) {
            *self.current = CurrentPanel {
                id: Some(*id),
                outlined: false,
            };
        }
        Frame::new()
            .inner_margin(4)
            .show(ui, |ui| self.panels.show(ui, *id, self.session));
        if self.current.outlined && self.current.id == Some(*id) {
            let stroke = ui.visuals().selection.stroke;
            let area = area.shrink(1.0);
            ui.painter()
                .rect_stroke(area, 2.0, stroke, StrokeKind::Inside);
        }
        egui_tiles::UiResponse::None
    }

    fn tab_title_for_pane(&mut self, pane: &PanelId) -> WidgetText {
        pane.title().into()
    }

    fn is_tab_closable(&self, _: &egui_tiles::Tiles<PanelId>, _: egui_tiles::TileId) -> bool {
        true
    }

    fn simplification_options(&self) -> egui_tiles::SimplificationOptions {
        egui_tiles::SimplificationOptions {
            // A single panel keeps its tab, so that it can be closed and dragged.
            all_panes_must_have_tabs: true,
            ..egui_tiles::SimplificationOptions::default()
        }
    }
}
