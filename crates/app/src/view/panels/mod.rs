//! The panels: they draw the session's state and pass the user's input to it.

pub(crate) mod calibration;
pub(crate) mod camera;
pub(crate) mod camera_drawing;
pub(crate) mod camera_layers;
pub(crate) mod details;
pub(crate) mod field;
mod field_drag;
pub(crate) mod field_drawing;
mod field_marks;
pub(crate) mod findings;
pub(crate) mod health;
pub(crate) mod parameters;
pub(crate) mod plots;
mod projected_markings;
pub(crate) mod scene;
mod scene_camera;
pub(crate) mod simulator;
pub(crate) mod timeline;

use std::collections::BTreeMap;

use eframe::egui::{Ui, WidgetText};
use serde::{Deserialize, Serialize};

use super::layer_worker::LayerSelection;
use super::session::Session;

/// A panel in a tile: any panel can be open several times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) struct PanelId {
    pub(crate) pane: Pane,
    /// 0 for the first one.
    pub(crate) copy: u32,
}

impl PanelId {
    /// Title of its tab.
    pub(crate) fn title(self) -> String {
        match self.copy {
            0 => self.pane.title().to_owned(),
            copy => format!("{} {}", self.pane.title(), copy + 1),
        }
    }
}

impl From<Pane> for PanelId {
    fn from(pane: Pane) -> Self {
        PanelId { pane, copy: 0 }
    }
}

/// A kind of panel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(crate) enum Pane {
    /// Camera image and detections.
    Camera,
    /// Field, pose estimate and objects.
    Field,
    /// Metrics over time.
    Plots,
    /// Playback, marks and modes.
    Timeline,
    /// Controls of the simulation.
    Simulator,
    /// Colours, mask, virtual sensor windows and ground map.
    Calibration,
    /// All settings.
    Parameters,
    /// State of the devices.
    Health,
    /// Odd moments of the run.
    Findings,
    /// Numbers of the selected object.
    Details,
    /// Field, robots, ball and mirror in space.
    Scene,
}

/// All panels, in menu order.
pub(crate) const PANES: [Pane; 11] = [
    Pane::Camera,
    Pane::Field,
    Pane::Plots,
    Pane::Timeline,
    Pane::Simulator,
    Pane::Calibration,
    Pane::Parameters,
    Pane::Health,
    Pane::Findings,
    Pane::Details,
    Pane::Scene,
];

impl Pane {
    /// Title of its tab and menu entry.
    pub(crate) fn title(self) -> &'static str {
        match self {
            Pane::Camera => "Camera",
            Pane::Field => "Field",
            Pane::Plots => "Plots",
            Pane::Timeline => "Timeline",
            Pane::Simulator => "Simulator",
            Pane::Calibration => "Calibration",
            Pane::Parameters => "Parameters",
            Pane::Health => "Health",
            Pane::Findings => "Findings",
            Pane::Details => "Details",
            Pane::Scene => "Scene",
        }
    }
}

/// State of all panels.
#[derive(Default)]
pub(crate) struct Panels {
    pub(crate) camera: camera::CameraPanel,
    pub(crate) field: field::FieldPanel,
    pub(crate) plots: plots::PlotsPanel,
    pub(crate) timeline: timeline::TimelinePanel,
    pub(crate) simulator: simulator::SimulatorPanel,
    pub(crate) calibration: calibration::CalibrationPanel,
    pub(crate) parameters: parameters::ParametersPanel,
    pub(crate) findings: findings::FindingsPanel,
    pub(crate) details: details::DetailsPanel,
    pub(crate) scene: scene::ScenePanel,
    /// States of further panels of the same kinds, by the number of the copy.
    pub(crate) copies: BTreeMap<u32, Panels>,
}

impl Panels {
    /// The layers that any camera panel, and any field panel, shows.
    pub(crate) fn layer_selections(&self) -> (LayerSelection, LayerSelection) {
        let own = (self.camera.layer_selection(), self.field.layer_selection());
        self.copies.values().fold(own, |(camera, field), copy| {
            let (other_camera, other_field) = copy.layer_selections();
            (camera.union(other_camera), field.union(other_field))
        })
    }

    /// State of the panels of a copy.
    pub(crate) fn of_copy(&mut self, copy: u32) -> &mut Panels {
        match copy {
            0 => self,
            copy => self.copies.entry(copy).or_default(),
        }
    }
}

/// Draws the panels in their tiles.
pub(crate) struct PaneBehavior<'a> {
    pub(crate) session: &'a mut Session,
    pub(crate) panels: &'a mut Panels,
}

impl egui_tiles::Behavior<PanelId> for PaneBehavior<'_> {
    fn pane_ui(
        &mut self,
        ui: &mut Ui,
        _tile: egui_tiles::TileId,
        id: &mut PanelId,
    ) -> egui_tiles::UiResponse {
        let session = &mut *self.session;
        let panels = self.panels.of_copy(id.copy);
        eframe::egui::Frame::new()
            .inner_margin(4)
            .show(ui, |ui| match id.pane {
                Pane::Camera => panels.camera.show(ui, session),
                Pane::Field => panels.field.show(ui, session),
                Pane::Plots => panels.plots.show(ui, session),
                Pane::Timeline => panels.timeline.show(ui, session),
                Pane::Simulator => panels.simulator.show(ui, session),
                Pane::Calibration => panels.calibration.show(ui, session),
                Pane::Parameters => panels.parameters.show(ui, session),
                Pane::Health => health::show(ui, session),
                Pane::Findings => panels.findings.show(ui, session),
                Pane::Details => panels.details.show(ui, session),
                Pane::Scene => panels.scene.show(ui, session),
            });
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
