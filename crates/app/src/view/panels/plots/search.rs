//! Finds a curve by typing: a quantity, a field of a topic, or a formula.

use eframe::egui::{self, Ui};

use crate::view::accessibility::AccessibleLabel;
use crate::view::curves::FORMULA_MARK;
use crate::view::curves::catalogue::CATALOGUE;

/// Width of the menu, points.
const WIDTH: f32 = 380.0;
/// Most fields that are listed.
const LISTED_MAX: usize = 200;

/// A field to type in, and what matches. Returns the name of the chosen curve.
pub(super) fn search_curve(ui: &mut Ui, search: &mut String, paths: &[String]) -> Option<String> {
    ui.set_width(WIDTH);
    let field = ui
        .add(
            egui::TextEdit::singleline(search)
                .hint_text("name, /topic.field or = formula")
                .desired_width(f32::INFINITY),
        )
        .with_accessible_label("name of a curve");
    // The menu has just opened: typing begins at once.
    if ui.memory(|memory| memory.focused().is_none()) {
        field.request_focus();
    }
    let entered = field.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
    let mut chosen = None;
    if search.starts_with(FORMULA_MARK) {
        ui.weak("= 100 * {/truth/error.distance}\nNames stand in braces, {NAME}' is the change per second.\nEnter adds the formula.");
        if entered {
            chosen = Some(search.trim().to_owned());
        }
        // What is typed in the last brace is completed.
        let open = search.rfind('{').filter(|at| !search[*at..].contains('}'));
        if let Some(at) = open {
            let words = search[at + 1..].to_owned();
            if let Some(name) = list(ui, &words, paths) {
                search.truncate(at + 1);
                *search += &format!("{name}}}");
                field.request_focus();
            }
        }
    } else {
        let first = entered.then(|| {
            matching(search, paths)
                .next()
                .map(|(name, _)| name.to_owned())
        });
        chosen = list(ui, search, paths).or(first.flatten());
        // A path that is typed completely, as of a list's tenth element, which is not listed.
        if entered && chosen.is_none() && search.starts_with('/') {
            chosen = Some(search.trim().to_owned());
        }
    }
    if chosen.is_some() {
        search.clear();
        ui.close();
    }
    chosen
}

fn list(ui: &mut Ui, words: &str, paths: &[String]) -> Option<String> {
    let mut chosen = None;
    egui::ScrollArea::vertical()
        .max_height(260.0)
        .show(ui, |ui| {
            for (name, unit) in matching(words, paths).take(LISTED_MAX) {
                let text = match unit {
                    "" => name.to_owned(),
                    unit => format!("{name} ({unit})"),
                };
                if ui.button(text).clicked() {
                    chosen = Some(name.to_owned());
                }
            }
            let more = matching(words, paths).count().saturating_sub(LISTED_MAX);
            if more > 0 {
                ui.weak(format!("{more} more: type a part of the name"));
            }
        });
    chosen
}

/// Quantities, then fields, that contain every word.
fn matching<'a>(words: &str, paths: &'a [String]) -> impl Iterator<Item = (&'a str, &'static str)> {
    let words: Vec<String> = words.split_whitespace().map(str::to_lowercase).collect();
    let quantities = CATALOGUE
        .iter()
        .map(|quantity| (quantity.name, quantity.unit));
    let fields = paths.iter().map(|path| (path.as_str(), ""));
    quantities.chain(fields).filter(move |(name, unit)| {
        let text = format!("{name} {unit}").to_lowercase();
        words.iter().all(|word| text.contains(word.as_str()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_typed_word_narrows_the_list() {
        let paths = [
            "/imu.rate_z".to_owned(),
            "/cycle.estimate.pose.x".to_owned(),
        ];
        let found =
            |words| -> Vec<&str> { matching(words, &paths).map(|(name, _)| name).collect() };
        assert_eq!(found("").len(), CATALOGUE.len() + 2);
        assert_eq!(found("ESTIMATE pose"), ["/cycle.estimate.pose.x"]);
        assert_eq!(found("rate"), ["turn rate", "yaw rate", "/imu.rate_z"]);
        assert_eq!(found("nothing of this name").len(), 0);
    }
}
