//! Texts that are not quite XML, as tinyxml2 takes them, with which MuJoCo and ROS read robots.

use super::xml_bounds::{SKIPPED, Tag};

/// The text with what tinyxml2 takes: blanks between attributes that touch, comments without `--`, `&` and `<` as plain
/// characters where they begin nothing. Lines keep their numbers.
pub fn mended(text: &str) -> String {
    let (mut out, mut rest) = (String::with_capacity(text.len() + 64), text);
    while let Some(start) = rest.find('<') {
        plain(&rest[..start], &mut out);
        rest = &rest[start..];
        let length = match SKIPPED.iter().find(|[begin, _]| rest.starts_with(begin)) {
            Some([begin, end]) => {
                let found = rest[begin.len()..].find(end);
                let length = found.map_or(rest.len(), |k| begin.len() + k + end.len());
                match *begin == "<!--" && found.is_some() {
                    true => out.extend(rest[..length].chars().filter(|c| *c == '\n')),
                    false => out.push_str(&rest[..length]),
                }
                length
            }
            None => {
                let length = Tag::at(rest).length;
                tag(&rest[..length], &mut out);
                length
            }
        };
        rest = &rest[length..];
    }
    plain(rest, &mut out);
    out
}

/// A tag, from its `<` to its `>`.
fn tag(text: &str, out: &mut String) {
    let mut rest = text;
    while let Some(start) = rest.find(['"', '\'']) {
        let quote = &rest[start..=start];
        let Some(end) = rest[start + 1..].find(quote).map(|k| start + 1 + k) else { break };
        out.push_str(&rest[..=start]);
        plain(&rest[start + 1..end], out);
        out.push_str(quote);
        rest = &rest[end + 1..];
        if !rest.starts_with(|c: char| c.is_whitespace() || matches!(c, '/' | '>')) {
            out.push(' ');
        }
    }
    out.push_str(rest);
}

/// Text between tags, or a value of an attribute.
fn plain(text: &str, out: &mut String) {
    for (i, c) in text.char_indices() {
        match c {
            '&' if !refers(&text[i + 1..]) => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            c => out.push(c),
        }
    }
}

/// Does a reference to a character begin with this text, which follows `&`?
fn refers(text: &str) -> bool {
    // Twelve bytes are more than any reference to a character has.
    let Some(end) = text.bytes().take(12).position(|b| b == b';') else { return false };
    let name = &text[..end];
    let code = match name.strip_prefix("#x") {
        Some(hexadecimal) => u32::from_str_radix(hexadecimal, 16).ok(),
        None => name.strip_prefix('#').and_then(|decimal| decimal.parse().ok()),
    };
    ["amp", "lt", "gt", "quot", "apos"].contains(&name)
        || code.is_some_and(|code| code > 31 && char::from_u32(code).is_some())
}

#[cfg(test)]
mod tests {
    use super::mended;

    #[test]
    fn what_tinyxml2_takes_becomes_xml() {
        for (text, wanted) in [
            (r#"<a b="1"c='2'/>"#, r#"<a b="1" c='2'/>"#),
            ("<a><!-- x -- y\n--->z</a>", "<a>\nz</a>"),
            (
                r#"<a b="R&D, 1<2">x & y &amp; &#65; &foo; &#x41;</a>"#,
                r#"<a b="R&amp;D, 1&lt;2">x &amp; y &amp; &#65; &amp;foo; &#x41;</a>"#,
            ),
            (
                r#"<?xml version="1.0"?><a b=">" c='"'><![CDATA[&<]]></a>"#,
                r#"<?xml version="1.0"?><a b=">" c='"'><![CDATA[&<]]></a>"#,
            ),
            ("<a>&", "<a>&amp;"),
            ("<a>&äöüäöüäöü;", "<a>&amp;äöüäöüäöü;"),
            ("<a b=\"", "<a b=\""),
            ("<!-- open", "<!-- open"),
        ] {
            assert_eq!(mended(text), wanted);
            assert_eq!(mended(wanted), wanted);
        }
    }
}
