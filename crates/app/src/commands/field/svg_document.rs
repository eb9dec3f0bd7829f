//! Which elements does an SVG file have? Tags with their attributes, in order, without what is not drawn.

use anyhow::{Context, Result, bail};

/// The start or the end of an element.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Tag {
    /// Name without prefix, attributes, and whether it is empty.
    Start(String, Vec<(String, String)>, bool),
    End(String),
}

/// Reads the tags of a document.
pub(super) fn tags(text: &str) -> Result<Vec<Tag>> {
    let mut tags = Vec::new();
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        rest = &rest[at..];
        let end_of = |pattern: &str, what: &str| {
            rest.find(pattern)
                .map(|end| end + pattern.len())
                .with_context(|| format!("{what} without an end"))
        };
        let end = if rest.starts_with("<!--") {
            end_of("-->", "a comment")?
        } else if rest.starts_with("<![CDATA[") {
            end_of("]]>", "a CDATA section")?
        } else if rest.starts_with("<?") {
            end_of("?>", "a processing instruction")?
        } else if rest.starts_with("<!") {
            // A document type may have an internal subset in brackets.
            let plain = end_of(">", "a declaration")?;
            if rest[..plain].contains('[') {
                end_of("]>", "a document type")?
            } else {
                plain
            }
        } else if let Some(name) = rest.strip_prefix("</") {
            let end = name.find('>').context("an end tag without '>'")?;
            tags.push(Tag::End(local_name(&name[..end])));
            end + 3
        } else {
            let (tag, end) = start_tag(rest)?;
            tags.push(tag);
            end
        };
        rest = &rest[end..];
    }
    if tags.is_empty() {
        bail!("no elements: is it an SVG file?");
    }
    Ok(tags)
}

/// The name without prefix and spaces.
fn local_name(name: &str) -> String {
    let name = name.trim();
    name.rsplit(':').next().unwrap_or(name).to_owned()
}

/// A start tag, and its length.
fn start_tag(text: &str) -> Result<(Tag, usize)> {
    let mut quote = None;
    let end = text.char_indices().find(|&(_, letter)| {
        match (quote, letter) {
            (None, '"' | '\'') => quote = Some(letter),
            (Some(open), _) if open == letter => quote = None,
            (None, '>') => return true,
            _ => {}
        }
        false
    });
    let (end, _) = end.with_context(|| {
        let start: String = text.chars().take(20).collect();
        format!("an element without '>': {start:?}")
    })?;
    let inner = &text[1..end];
    let is_empty = inner.ends_with('/');
    let inner = inner.trim_end_matches('/');
    let (name, mut rest) = inner.split_at(inner.find(char::is_whitespace).unwrap_or(inner.len()));
    let mut attributes = Vec::new();
    loop {
        rest = rest.trim_start();
        let Some((key, value)) = rest.split_once('=') else {
            break;
        };
        let value = value.trim_start();
        let mark = value
            .chars()
            .next()
            .filter(|mark| ['"', '\''].contains(mark));
        let mark = mark.with_context(|| format!("attribute {} without quotes", key.trim()))?;
        let (content, after) = value[1..]
            .split_once(mark)
            .with_context(|| format!("attribute {} without an end", key.trim()))?;
        attributes.push((local_name(key), content.to_owned()));
        rest = after;
    }
    Ok((Tag::Start(local_name(name), attributes, is_empty), end + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_quotes_and_prefixes_are_read() {
        let text = "<?xml version='1.0'?><!-- <line/> --><svg:g id=\"a>b\"><line x1='1'/></svg:g>";
        let read = tags(text).expect("tags");
        assert_eq!(read.len(), 3);
        assert_eq!(
            read[0],
            Tag::Start("g".into(), vec![("id".into(), "a>b".into())], false)
        );
        assert_eq!(read[2], Tag::End("g".into()));
    }

    #[test]
    fn cut_files_are_refused_without_a_panic() {
        let whole = "<svg width=\"1m\"><!-- c --><path d='M 0 0 L 1 é'/></svg>";
        for end in (0..whole.len()).filter(|&end| whole.is_char_boundary(end)) {
            let _ = tags(&whole[..end]);
        }
        assert!(tags("<svg").is_err() && tags("text").is_err());
    }
}
