//! What does a shortcut, or an entry of the search, do?

use eframe::egui;

use super::file_dialog::Purpose;
use super::layout;
use super::panel_command::PanelCommand;
use super::panels::{Pane, PanelId};
use super::search::Target;
use super::shell::View;
use super::shortcut_table::Action;
use super::source::Source;

impl View {
    /// Applies the action of a shortcut.
    pub(crate) fn apply_action(&mut self, ctx: &egui::Context, action: Action) {
        let session = &mut self.session;
        let camera = &mut self.panels.camera;
        match action {
            Action::SaveScreenshot => self.ask(Purpose::SaveScreenshot),
            Action::SaveReport => self.ask(Purpose::SaveReport),
            Action::Open => self.ask(Purpose::Open),
            Action::OpenBeside => self.ask(Purpose::OpenBeside),
            Action::Undo => {
                let edited = self.history.undo();
                self.restore_edit(edited);
            }
            Action::Redo => {
                let edited = self.history.redo();
                self.restore_edit(edited);
            }
            Action::Quit => ctx.send_viewport_cmd(egui::ViewportCommand::Close),
            Action::ToggleHelp => self.help_open = !self.help_open,
            Action::TogglePlayback => session.toggle_playback(),
            Action::SeekBy(seconds) => session.seek(session.playback.time + seconds),
            Action::Step(cycles) => session.step(cycles),
            Action::SeekToStart => {
                if let Some((start, _)) = session.source.span() {
                    session.seek(start);
                }
            }
            Action::SeekToEnd => {
                if let Some((_, end)) = session.source.span() {
                    session.seek(end);
                    session.playback.playing = matches!(session.source, Source::Live(_));
                }
            }
            Action::SeekFinding(ahead) => session.next_finding(ahead),
            Action::SelectNext(ahead) => session.select_next(ahead),
            Action::SeekMark(ahead) => session.next_mark(ahead),
            Action::Search => self.search.open(),
            Action::TogglePointer => {
                let start = ctx.input(|input| input.pointer.latest_pos());
                self.pointer
                    .toggle(start.unwrap_or(ctx.content_rect().center()));
            }
            Action::NextPanel(ahead) => self.current.go(&mut self.tree, ahead),
            Action::ClosePanel => {
                if let Some(id) = self.current.or_first(&self.tree) {
                    layout::close_panel(&mut self.tree, id);
                }
            }
            Action::Pan(step) => self.command(PanelCommand::Pan(step)),
            Action::Zoom(factor) => self.command(PanelCommand::Zoom(factor)),
            Action::ShowAll => self.command(PanelCommand::ShowAll),
            Action::ScalePlottedTime(factor) => self.panels.plots.scale_time(session, factor),
            Action::AddMark => session.add_mark(""),
            Action::ScaleSpeed(factor) => session.set_speed(session.playback.speed * factor),
            Action::ToggleClasses => camera.layers.classes = !camera.layers.classes,
            Action::ToggleFieldLines => camera.layers.field_lines = !camera.layers.field_lines,
            Action::ToggleGrid => camera.layers.grid = !camera.layers.grid,
            Action::ToggleBirdsEye => camera.birds_eye = !camera.birds_eye,
            Action::ToggleTheme => ctx.set_theme(match ctx.theme() {
                egui::Theme::Dark => egui::Theme::Light,
                egui::Theme::Light => egui::Theme::Dark,
            }),
            Action::SetLayout(layout) => self.set_layout(layout),
        }
    }

    /// Draws the search if it is open, and goes where the chosen result leads.
    pub(crate) fn show_search(&mut self, ctx: &egui::Context) {
        let Some(target) = self.search.show(ctx, &mut self.session) else {
            return;
        };
        match target {
            Target::Moment(time) => self.session.seek_stamp(time),
            Target::Setting(name) => {
                self.panels.parameters.find(&name);
                self.show_pane(Pane::Parameters);
            }
            Target::Panel(pane) => self.show_pane(pane),
            Target::Action(action) => self.apply_action(ctx, action),
        }
    }

    /// Brings a panel to the front, opens it if necessary, and makes it the current one.
    fn show_pane(&mut self, pane: Pane) {
        if !layout::contains_pane(&self.tree, pane) {
            layout::open_pane(&mut self.tree, pane);
        }
        let open = layout::open_panels(&self.tree);
        if let Some(id) = open.into_iter().find(|id: &PanelId| id.pane == pane) {
            layout::show_panel(&mut self.tree, id);
            self.current.id = Some(id);
            self.current.outlined = true;
        }
    }

    /// Passes a command to the current panel.
    fn command(&mut self, command: PanelCommand) {
        if let Some(id) = self.current.or_first(&self.tree) {
            self.current.outlined = true;
            self.panels.command(id, command, &mut self.session);
        }
    }
}
