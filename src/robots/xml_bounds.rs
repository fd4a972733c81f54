//! Bounds of XML that are checked before roxmltree reads it. roxmltree compares each attribute with all others of its
//! element, and copies the name spaces of an element to those in it, so that without them its time grows with the square
//! of a file's size.

/// Largest number of attributes of an element, and of declarations of name spaces in a file: our choice, several times
/// those of real files.
const MOST_ATTRIBUTES: usize = 250;
const MOST_NAME_SPACES: usize = 1000;
/// Deepest nesting: our choice, twice as deep as the readers of robots go.
const DEEPEST: usize = 200;

/// Parts of a file in which `<` begins no tag.
pub const SKIPPED: [[&str; 2]; 4] = [["<!--", "-->"], ["<![CDATA[", "]]>"], ["<?", "?>"], ["<!", ">"]];

/// The reason why a text is not read, and its line. In a text that is no XML the counts may be wrong, but roxmltree ends
/// at the first place that is no XML.
pub fn check(text: &str) -> Result<(), String> {
    let (mut spaces, mut depth, mut at) = (0, 0_usize, 0);
    while let Some(start) = text[at..].find('<').map(|k| at + k) {
        if let Some([_, end]) = SKIPPED.iter().find(|[begin, _]| text[start..].starts_with(begin)) {
            at = text[start..].find(end).map_or(text.len(), |k| start + k + end.len());
            continue;
        }
        let tag = Tag::at(&text[start..]);
        at = start + tag.length;
        spaces += tag.spaces;
        let inner = depth + 1;
        match (text[start..].starts_with("</"), tag.is_empty) {
            (true, _) => depth = depth.saturating_sub(1),
            (false, false) => depth = inner,
            (false, true) => {}
        }
        let reason = if tag.attributes > MOST_ATTRIBUTES {
            format!("an element with more than {MOST_ATTRIBUTES} attributes")
        } else if spaces > MOST_NAME_SPACES {
            format!("more than {MOST_NAME_SPACES} declarations of name spaces")
        } else if inner > DEEPEST {
            format!("elements are nested deeper than {DEEPEST}")
        } else {
            continue;
        };
        let line = text[..start].bytes().filter(|b| *b == b'\n').count() + 1;
        return Err(format!("line {line}: {reason}"));
    }
    Ok(())
}

/// What the text of a tag has, from its `<` to its `>`.
#[derive(Default)]
pub struct Tag {
    attributes: usize,
    spaces: usize,
    /// Does it end with `/>`?
    is_empty: bool,
    pub length: usize,
}

impl Tag {
    pub fn at(text: &str) -> Self {
        let (mut tag, mut at) = (Self::default(), 1);
        // Values have quotes, and may contain `>`.
        while let Some(found) = text[at..].find(['"', '\'', '>']).map(|k| at + k) {
            let quote = &text[found..=found];
            if quote == ">" {
                return Self { is_empty: text[..found].ends_with('/'), length: found + 1, ..tag };
            }
            tag.attributes += 1;
            // Before the first attribute stands the element's name.
            tag.spaces += usize::from(text[at..found].split_whitespace().any(|word| word.starts_with("xmlns")));
            match text[found + 1..].find(quote) {
                Some(k) => at = found + k + 2,
                None => break,
            }
        }
        Self { length: text.len(), ..tag }
    }
}

#[cfg(test)]
mod tests {
    use super::check;

    #[test]
    fn long_elements_are_refused_and_others_are_not() {
        let attributes = |count: usize| (0..count).map(|k| format!(" a{k}='>'")).collect::<String>();
        let spaces = |count: usize| (0..count).map(|k| format!("<b xmlns:s{k}=\"x\"/>")).collect::<String>();
        for (text, said) in [
            (format!("<a>\n<b{}/></a>", attributes(251)), "line 2: an element with more than 250 attributes"),
            (format!("<a>{}</a>", spaces(1001)), "line 1: more than 1000 declarations of name spaces"),
            ("<a>".repeat(201), "line 1: elements are nested deeper than 200"),
        ] {
            assert_eq!(check(&text).unwrap_err(), said);
        }
        for text in [
            format!("<a{}/>", attributes(250)).repeat(2000),
            format!("<?xml version=\"1.0\"?><!-- <a{} --><a><![CDATA[<b{}]]></a>", attributes(300), attributes(300)),
            format!("<a>{}</a>", spaces(1000)),
            "<a><b></b></a>".repeat(1000) + &"<a/>".repeat(1000),
            "<a 'no XML".into(),
        ] {
            assert_eq!(check(&text), Ok(()), "{}", &text[..text.len().min(80)]);
        }
    }
}
