//! How does a message reach an operator? Each cause once, and without control characters of foreign texts.

/// The error and its causes, each once: many errors already contain the message of their cause.
pub fn error_message(error: &anyhow::Error) -> String {
    let mut message = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if message.is_empty() {
            message = cause;
        } else if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}

/// A text with its control characters escaped, but for line feeds: those of a file's content or name could command a terminal.
pub fn printable(text: &str) -> String {
    let lines: Vec<String> = text.split('\n').map(printable_line).collect();
    lines.join("\n")
}

/// As [`printable`], with line feeds escaped as well.
pub fn printable_line(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for letter in text.chars() {
        if letter.is_control() {
            shown.extend(letter.escape_default());
        } else {
            shown.push(letter);
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_of_foreign_texts_are_escaped() {
        let text = "a\u{1b}[31m\u{9b}b\nümläut ° c";
        assert_eq!(printable(text), "a\\u{1b}[31m\\u{9b}b\nümläut ° c");
        assert_eq!(printable_line("a\nb"), "a\\nb");
    }

    #[test]
    fn cause_that_the_error_contains_is_stated_once() {
        let error = anyhow::anyhow!("no such file").context("cannot read a.toml: no such file");
        assert_eq!(error_message(&error), "cannot read a.toml: no such file");
        let error = anyhow::anyhow!("no such file").context("cannot read a.toml");
        assert_eq!(error_message(&error), "cannot read a.toml: no such file");
    }
}
