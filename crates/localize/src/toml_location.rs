//! The line of a key in a TOML file, for error messages about its value.

use std::path::Path;

use toml::de::{DeTable, DeValue};

/// `file: line N` of `key` (such as `camera.focal_px` or `faults[2].start`) in `text`, the file's content.
///
/// If the key is missing, the line is that of its deepest existing table; without one, the result is the file alone.
pub fn key_location(path: &Path, text: &str, key: &str) -> String {
    match key_line(text, key) {
        Some(line) => format!("{}: line {line}", path.display()),
        None => path.display().to_string(),
    }
}

fn key_line(text: &str, key: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let mut found = None;
    for step in key.split('.') {
        let (name, index) = match step.split_once('[') {
            Some((name, index)) => (name, index.trim_end_matches(']').parse::<usize>().ok()),
            None => (step, None),
        };
        let Some((key, value)) = table.iter().find(|(key, _)| key.get_ref() == name) else {
            break;
        };
        let (mut span, mut value) = (key.span(), value);
        if let (Some(index), DeValue::Array(values)) = (index, value.get_ref()) {
            let Some(element) = values.get(index) else {
                break;
            };
            (span, value) = (element.span(), element);
        }
        found = Some(span.start);
        match value.get_ref() {
            DeValue::Table(inner) => table = inner,
            _ => break,
        }
    }
    found.map(|start| 1 + text[..start].matches('\n').count())
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "a = 1\n[b]\nc = 2\nd = { e = 3 }\n[[f]]\ng = 4\n[[f]]\ng = 5\n";

    #[test]
    fn missing_key_is_located_at_its_deepest_existing_table() {
        for (key, wanted) in [
            ("a", Some(1)),
            ("b.c", Some(3)),
            ("b.d.e", Some(4)),
            ("b.missing", Some(2)),
            ("f[1].g", Some(8)),
            ("missing", None),
        ] {
            assert_eq!(key_line(TEXT, key), wanted, "{key}");
        }
        assert_eq!(
            key_location(Path::new("x.toml"), TEXT, "b.c"),
            "x.toml: line 3"
        );
        assert_eq!(key_location(Path::new("x.toml"), TEXT, "z"), "x.toml");
    }
}
