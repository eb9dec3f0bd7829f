//! Which messages come again and again? A cable with a loose contact says the same a hundred times a second.

use std::collections::BTreeMap;

/// Time over which equal messages count, seconds, and how many of them pass.
const PERIOD: f64 = 10.0;
const PASSED_MAX: u32 = 5;
/// Most kinds of messages that are remembered.
const KINDS_MAX: usize = 64;

/// Lets the first few of equal messages pass, then one each ten seconds that says how many there were. Messages are equal if they
/// differ in digits alone.
#[derive(Debug, Default)]
pub(super) struct RepeatedLines {
    /// By the text without digits: start of the period, seconds, and messages since.
    known: BTreeMap<String, (f64, u32)>,
}

impl RepeatedLines {
    /// The message to show at `now`, seconds. None for one that is only counted.
    pub(super) fn pass(&mut self, text: &str, now: f64) -> Option<String> {
        let kind: String = text.chars().filter(|c| !c.is_ascii_digit()).collect();
        if self.known.len() >= KINDS_MAX && !self.known.contains_key(&kind) {
            self.known.clear();
        }
        let (since, count) = self.known.entry(kind).or_insert((now, 0));
        if now - *since < PERIOD {
            *count += 1;
            return (*count <= PASSED_MAX).then(|| text.to_owned());
        }
        let hidden = count.saturating_sub(PASSED_MAX);
        (*since, *count) = (now, if hidden > 0 { PASSED_MAX } else { 1 });
        Some(match hidden {
            0 => text.to_owned(),
            hidden => format!("{text} (and {hidden} times in between)"),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flood_is_counted_and_seldom_messages_pass() {
        let mut lines = RepeatedLines::default();
        let shown: Vec<String> = (0..3000)
            .filter_map(|k| lines.pass(&format!("base: a jump by {k}"), 0.01 * f64::from(k)))
            .collect();
        assert_eq!(shown.len(), 7, "{shown:?}");
        assert!(
            shown[5].ends_with("(and 995 times in between)"),
            "{shown:?}"
        );
        assert!(lines.pass("camera: absent", 30.0).is_some());
        for k in 0..20 {
            let seldom = lines.pass("camera: running", 40.0 + 3.0 * f64::from(k));
            assert_eq!(seldom.as_deref(), Some("camera: running"));
        }
    }
}
