//! The panels: they draw the session's state and pass the user's input to it.

pub(crate) mod calibration;
pub(crate) mod camera;
pub(crate) mod camera_drawing;
pub(crate) mod camera_layers;
pub(crate) mod field;
pub(crate) mod field_drawing;
pub(crate) mod findings;
pub(crate) mod health;
pub(crate) mod parameters;
pub(crate) mod plots;
pub(crate) mod simulator;
pub(crate) mod timeline;

use eframe::egui::{Ui, WidgetText};
use serde::{Deserialize, Serialize};

use super::session::Session;

/// A panel of the view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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
}

/// All panels, in menu order.
pub(crate) const PANES: [Pane; 9] = [
    Pane::Camera,
    Pane::Field,
    Pane::Plots,
    Pane::Timeline,
    Pane::Simulator,
    Pane::Calibration,
    Pane::Parameters,
    Pane::Health,
    Pane::Findings,
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
}

/// Draws the panels in their tiles.
pub(crate) struct PaneBehavior<'a> {
    pub(crate) session: &'a mut Session,
    pub(crate) panels: &'a mut Panels,
}

impl egui_tiles::Behavior<Pane> for PaneBehavior<'_> {
    fn pane_ui(
        &mut self,
        ui: &mut Ui,
        _tile: egui_tiles::TileId,
        pane: &mut Pane,
    ) -> egui_tiles::UiResponse {
        let PaneBehavior { session, panels } = self;
        eframe::egui::Frame::new()
            .inner_margin(4)
            .show(ui, |ui| match pane {
                Pane::Camera => panels.camera.show(ui, session),
                Pane::Field => panels.field.show(ui, session),
                Pane::Plots => panels.plots.show(ui, session),
                Pane::Timeline => panels.timeline.show(ui, session),
                Pane::Simulator => panels.simulator.show(ui, session),
                Pane::Calibration => panels.calibration.show(ui, session),
                Pane::Parameters => panels.parameters.show(ui, session),
                Pane::Health => health::show(ui, session),
                Pane::Findings => panels.findings.show(ui, session),
            });
        egui_tiles::UiResponse::None
    }

    fn tab_title_for_pane(&mut self, pane: &Pane) -> WidgetText {
        pane.title().into()
    }

    fn is_tab_closable(&self, _: &egui_tiles::Tiles<Pane>, _: egui_tiles::TileId) -> bool {
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
