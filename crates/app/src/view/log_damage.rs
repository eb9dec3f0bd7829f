//! Which parts of a log cannot be read? Known once the whole log has been read; timeline and plots have gaps there.

/// Damaged parts, in the order of the file.
#[derive(Debug, Clone, Default)]
pub(crate) struct LogDamage {
    /// First and last time of each part, seconds.
    parts: Vec<(f64, f64)>,
    /// The chunk read last that is damaged.
    last_chunk: Option<usize>,
}

impl LogDamage {
    /// Adds a chunk that cannot be read, with its first and last time, seconds. Successive ones are one part.
    pub(crate) fn push(&mut self, chunk: usize, (from, to): (f64, f64)) {
        let follows = chunk
            .checked_sub(1)
            .is_some_and(|before| self.last_chunk == Some(before));
        match self.parts.last_mut().filter(|_| follows) {
            Some(part) => *part = (part.0.min(from), part.1.max(to)),
            None => self.parts.push((from, to)),
        }
        self.last_chunk = Some(chunk);
    }

    /// First and last time of each part, seconds.
    pub(crate) fn parts(&self) -> &[(f64, f64)] {
        &self.parts
    }

    /// True if a time lies in a damaged part.
    pub(crate) fn covers(&self, time: f64) -> bool {
        self.parts
            .iter()
            .any(|(from, to)| (*from..=*to).contains(&time))
    }

    /// What is missing, in a sentence. None if the log is intact.
    pub(crate) fn notice(&self) -> Option<String> {
        let ((from, _), (_, to)) = (self.parts.first()?, self.parts.last()?);
        let what = match self.parts.len() {
            1 => format!("{from:.2} to {to:.2} s cannot be read"),
            count => {
                let seconds: f64 = self.parts.iter().map(|(from, to)| to - from).sum();
                format!(
                    "{count} parts from {from:.2} to {to:.2} s cannot be read, together {seconds:.2} s"
                )
            }
        };
        Some(format!(
            "the log is damaged: {what}. `mirrorball recover` saves the rest"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn successive_damaged_chunks_are_one_part() {
        let mut damage = LogDamage::default();
        assert_eq!(damage.notice(), None);
        damage.push(0, (0.0, 1.0));
        damage.push(1, (1.0, 2.0));
        let one = "the log is damaged: 0.00 to 2.00 s cannot be read. `mirrorball recover` saves the rest";
        assert_eq!(damage.notice().as_deref(), Some(one));
        damage.push(4, (4.0, 4.5));
        assert_eq!(damage.parts(), [(0.0, 2.0), (4.0, 4.5)]);
        let two = "the log is damaged: 2 parts from 0.00 to 4.50 s cannot be read, together 2.50 s. `mirrorball recover` saves the rest";
        assert_eq!(damage.notice().as_deref(), Some(two));
        assert!(damage.covers(1.5) && !damage.covers(3.0));
    }
}
