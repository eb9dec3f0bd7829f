//! The panels: they draw the session's state and pass the user's input to it.

pub(crate) mod calibration;
pub(crate) mod camera;
pub(crate) mod camera_drawing;
pub(crate) mod camera_layers;
mod carpet_boundary;
pub(crate) mod details;
pub(crate) mod field;
mod field_contents;
mod field_drag;
pub(crate) mod field_drawing;
pub(crate) mod field_layers;
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
mod timeline_bar;

use std::collections::BTreeMap;

use eframe::egui::{Ui, Vec2};
use serde::{Deserialize, Serialize};

use super::layer_worker::LayerSelection;
use super::panel_command::PanelCommand;
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
    /// Points that a panel without a picture is to be scrolled by.
    scroll: Option<(PanelId, Vec2)>,
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

/// Scrolled points of a key.
const SCROLL_STEP: f32 = 60.0;

impl Panels {
    /// Draws a panel.
    pub(crate) fn show(&mut self, ui: &mut Ui, id: PanelId, session: &mut Session) {
        if let Some((_, delta)) = self.scroll.take_if(|(of, _)| *of == id) {
            ui.scroll_with_delta(delta);
        }
        let panels = self.of_copy(id.copy);
        match id.pane {
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
        }
    }

    /// Passes a command to a panel.
    pub(crate) fn command(&mut self, id: PanelId, command: PanelCommand, session: &mut Session) {
        let panels = self.of_copy(id.copy);
        match (id.pane, command) {
            (Pane::Camera, _) => panels.camera.pan_zoom.apply(command),
            (Pane::Field, _) => panels.field.pan_zoom.apply(command),
            (Pane::Scene, _) => panels.scene.apply(command),
            (Pane::Timeline, _) => panels.timeline.apply(command, session),
            // The plots themselves move along time only. Their list scrolls.
            (Pane::Plots, PanelCommand::Pan([0.0, _])) => {}
            (Pane::Plots, _) => return panels.plots.take_command(command, session),
            _ => {}
        }
        if let PanelCommand::Pan(step) = command {
            self.scroll = Some((id, -SCROLL_STEP * Vec2::from(step)));
        }
    }
}
