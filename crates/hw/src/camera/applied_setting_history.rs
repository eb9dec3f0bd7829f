//! With which exposure and gain was an image taken? By what the device reported after each change.

use std::collections::VecDeque;

use localize::Stamp;
use localize::robot::ExposureSetting;

/// More changes than can be on their way: one command per image, five images of delay.
const MAX_CHANGES: usize = 8;

/// The settings that a device reported, each from the first image taken with it.
#[derive(Debug, Default)]
pub(super) struct AppliedSettingHistory {
    current: Option<ExposureSetting>,
    changes: VecDeque<(Stamp, Option<ExposureSetting>)>,
}

impl AppliedSettingHistory {
    /// Starts with the setting of a device that was just opened.
    pub(super) fn new(current: Option<ExposureSetting>) -> Self {
        AppliedSettingHistory {
            current,
            changes: VecDeque::new(),
        }
    }

    /// The device reports `setting` for images exposed after `from`.
    pub(super) fn change(&mut self, from: Stamp, setting: Option<ExposureSetting>) {
        if self.changes.len() == MAX_CHANGES {
            self.changes.pop_front();
        }
        self.changes.push_back((from, setting));
    }

    /// The setting of an image exposed at `stamp`; stamps increase from call to call.
    pub(super) fn at(&mut self, stamp: Stamp) -> Option<ExposureSetting> {
        while let Some((_, setting)) = self.changes.front().filter(|(from, _)| *from < stamp) {
            self.current = *setting;
            self.changes.pop_front();
        }
        self.current
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn change_applies_to_images_exposed_after_it() {
        let setting = |exposure| {
            Some(ExposureSetting {
                exposure,
                gain: 1.0,
            })
        };
        let mut in_force = AppliedSettingHistory::new(setting(1.0));
        assert_eq!(in_force.at(Stamp(10)), setting(1.0));
        in_force.change(Stamp(20), setting(2.0));
        in_force.change(Stamp(40), setting(3.0));
        assert_eq!(in_force.at(Stamp(20)), setting(1.0));
        assert_eq!(in_force.at(Stamp(21)), setting(2.0));
        assert_eq!(in_force.at(Stamp(50)), setting(3.0));
        for from in 60..100 {
            in_force.change(Stamp(from), setting(from as f32));
        }
        assert_eq!(in_force.at(Stamp(200)), setting(99.0));
    }
}
