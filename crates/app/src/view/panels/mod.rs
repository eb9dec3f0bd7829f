//! What does each panel show? They draw what the session holds and say what was asked for; they compute nothing.

pub(crate) mod calibration;
pub(crate) mod camera;
pub(crate) mod camera_drawing;
pub(crate) mod field;
pub(crate) mod field_drawing;
pub(crate) mod health;
pub(crate) mod parameters;
pub(crate) mod plots;
pub(crate) mod simulator;
pub(crate) mod timeline;

use eframe::egui::{Ui, WidgetText};
use serde::{Deserialize, Serialize};

use super::brush::Brush;
use super::session::Session;

/// A panel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Pane {
    /// What the robot sees.
    Camera,
    /// Where it takes itself to be.
    Field,
    /// How it went.
    Plots,
    /// When.
    Timeline,
    /// What is done to a simulation.
    Simulator,
    /// Colours, mask, windows, map.
    Calibration,
    /// Every setting.
    Parameters,
    /// The devices.
    Health,
}

/// All of them, in the order of the menu.
pub(crate) const PANES: [Pane; 8] = [
    Pane::Camera,
    Pane::Field,
    Pane::Plots,
    Pane::Timeline,
    Pane::Simulator,
    Pane::Calibration,
    Pane::Parameters,
    Pane::Health,
];

impl Pane {
    /// Its name.
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
        }
    }
}

/// What each panel remembers.
pub(crate) struct Panels {
    pub(crate) camera: camera::CameraPanel,
    pub(crate) field: field::FieldPanel,
    pub(crate) plots: plots::PlotsPanel,
    pub(crate) timeline: timeline::TimelinePanel,
    pub(crate) simulator: simulator::SimulatorPanel,
    pub(crate) calibration: calibration::CalibrationPanel,
    pub(crate) parameters: parameters::ParametersPanel,
    pub(crate) brush: Brush,
}

impl Default for Panels {
    fn default() -> Self {
        Panels {
            camera: camera::CameraPanel::default(),
            field: field::FieldPanel::default(),
            plots: plots::PlotsPanel::default(),
            timeline: timeline::TimelinePanel::default(),
            simulator: simulator::SimulatorPanel::default(),
            calibration: calibration::CalibrationPanel::default(),
            parameters: parameters::ParametersPanel::default(),
            brush: Brush::new(),
        }
    }
}

/// The tiles' way to the panels.
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
                Pane::Camera => panels.camera.show(ui, session, &mut panels.brush),
                Pane::Field => panels.field.show(ui, session),
                Pane::Plots => panels.plots.show(ui, session),
                Pane::Timeline => panels.timeline.show(ui, session),
                Pane::Simulator => panels.simulator.show(ui, session),
                Pane::Calibration => {
                    panels
                        .calibration
                        .show(ui, session, &mut panels.brush, &mut panels.parameters);
                }
                Pane::Parameters => panels.parameters.show(ui, session),
                Pane::Health => health::show(ui, session),
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
            // Each panel keeps its name, and can be closed and dragged.
            all_panes_must_have_tabs: true,
            ..egui_tiles::SimplificationOptions::default()
        }
    }
}
