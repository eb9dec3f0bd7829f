//! What is wrong with a table? The reason and the line of an error of the CSV reader, in the words of all other messages.

/// The reason, without the file and the line.
pub fn reason(error: &csv::Error) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths {
            expected_len, len, ..
        } => {
            format!("has {len} fields, the header has {expected_len}")
        }
        csv::ErrorKind::Io(error) => error.to_string(),
        csv::ErrorKind::Utf8 { .. } => "is not UTF-8 text".to_owned(),
        _ => error.to_string(),
    }
}

/// The line, counted from 1.
pub(crate) fn line(error: &csv::Error) -> u64 {
    error.position().map_or(1, csv::Position::line)
}
