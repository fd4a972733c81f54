//! Texts that fit a terminal of 80 columns.

/// Width of printed tables and texts: the width of a standard terminal.
pub const WIDTH: usize = 80;

/// Blanks between two columns: our choice, because texts with blanks would run together with one.
const GAP: usize = 2;

/// Rows as left-aligned columns.
pub fn table(rows: &[Vec<String>]) -> String {
    let widths = widths(rows);
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(cell, w)| format!("{cell:w$}"));
        format!("{}\n", cells.collect::<Vec<_>>().join(&" ".repeat(GAP)).trim_end())
    };
    rows.iter().map(line).collect()
}

/// Like [`table`], but within [`WIDTH`]: columns that do not fit follow in further tables, each of which begins with
/// the first `keys` columns.
pub fn narrow_table(rows: &[Vec<String>], keys: usize) -> String {
    let widths = widths(rows);
    let wide = |columns: &[usize]| columns.iter().map(|k| widths[*k] + GAP).sum::<usize>() - GAP;
    let begin: Vec<usize> = (0..keys).collect();
    let mut parts = vec![begin.clone()];
    for k in keys..widths.len() {
        let last = parts.len() - 1;
        parts[last].push(k);
        if parts[last].len() > keys + 1 && wide(&parts[last]) > WIDTH {
            parts[last].pop();
            parts.push([&begin[..], &[k]].concat());
        }
    }
    let part = |columns: &Vec<usize>| {
        let cell = |row: &Vec<String>, k: usize| row.get(k).cloned().unwrap_or_default();
        table(&rows.iter().map(|row| columns.iter().map(|k| cell(row, *k)).collect()).collect::<Vec<Vec<String>>>())
    };
    parts.iter().map(part).collect::<Vec<_>>().join("\n")
}

/// Rows as columns within [`WIDTH`]. The last column has a text, whose further lines are indented.
pub fn glossary(rows: &[Vec<String>]) -> String {
    let heads: Vec<Vec<String>> = rows.iter().map(|row| row[..row.len() - 1].to_vec()).collect();
    // A text needs room: if the other columns leave less than 28 characters (our choice) of the line, the text begins
    // on the next line.
    let before: usize = widths(&heads).iter().map(|w| w + GAP).sum();
    let [indent, beside] = if before + 28 <= WIDTH { [before, 1] } else { [6, 0] };
    let mut text = String::new();
    for (head, row) in table(&heads).lines().zip(rows) {
        let lines = wrapped(row.last().map_or("", String::as_str), WIDTH - indent);
        let first = lines.first().filter(|_| beside == 1).map_or("", String::as_str);
        text += format!("{head:indent$}{first}").trim_end();
        text.push('\n');
        lines.iter().skip(beside).for_each(|line| text += &format!("{:indent$}{line}\n", ""));
    }
    text
}

/// Examples of a help text as lines within [`WIDTH`] that can be copied: a remark in brackets behind a command becomes a
/// comment before it, and a long command goes on in further lines after a backslash, each beginning with an option.
pub fn examples(text: &str) -> String {
    let line = |line: &str| {
        let Some(command) = line.strip_prefix("  ") else { return format!("{line}\n") };
        let (command, remark) = match command.trim_end().strip_suffix(')').and_then(|c| c.rsplit_once("  (")) {
            Some((command, remark)) => (command.trim_end(), format!("  # {remark}\n")),
            None => (command, String::new()),
        };
        remark + &broken(command)
    };
    text.lines().map(line).collect::<String>().trim_end().to_owned()
}

/// A command as lines of a shell.
fn broken(command: &str) -> String {
    let mut lines = vec![String::from(" ")];
    for part in command.replace(" --", "\n--").replace(" && ", " &&\n").lines() {
        let room = WIDTH - " \\".len();
        match lines.last_mut() {
            Some(line) if line.trim().is_empty() || line.chars().count() + 1 + part.chars().count() <= room => {
                *line += &format!(" {part}");
            }
            _ => lines.push(format!("      {part}")),
        }
    }
    lines.join(" \\\n") + "\n"
}

/// Lines of at most `width` characters, broken at blanks. A longer word has a line of its own.
pub fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => *line += &format!(" {word}"),
            _ => lines.push(word.into()),
        }
    }
    lines
}

fn widths(rows: &[Vec<String>]) -> Vec<usize> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |k: usize| rows.iter().filter_map(|r| r.get(k)).map(|c| c.chars().count()).max().unwrap_or(0);
    (0..columns).map(width).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(cells: &[&[&str]]) -> Vec<Vec<String>> {
        cells.iter().map(|row| row.iter().map(|c| (*c).to_owned()).collect()).collect()
    }

    /// No line is wider than a terminal, no cell is lost, and each part begins with the key.
    #[test]
    fn a_wide_table_is_divided() {
        let cells: Vec<String> = (0..12).map(|k| format!("column {k:02} [N·m/rad]")).collect();
        let row: Vec<String> = std::iter::once("key".to_owned()).chain(cells.clone()).collect();
        let text = narrow_table(&[row.clone(), row], 1);
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH && (l.is_empty() || l.starts_with("key"))), "{text}");
        assert!(cells.iter().all(|c| text.matches(c.as_str()).count() == 2), "{text}");
        let small = rows(&[&["a", "b"], &["c", "d"]]);
        assert_eq!(narrow_table(&small, 1), table(&small));
    }

    #[test]
    fn long_examples_are_broken_as_a_shell_reads_them() {
        let text = "Examples:\n  sandgait train      (a minute)\n  sandgait serve --listen 0.0.0.0:50051 --tls-cert server.pem --tls-key \
                    server.key --token-file token";
        let wanted = "Examples:\n  # a minute\n  sandgait train\n  sandgait serve --listen 0.0.0.0:50051 --tls-cert server.pem \\\n      \
                      --tls-key server.key --token-file token";
        assert_eq!(examples(text), wanted);
        assert!(examples(text).lines().all(|line| line.chars().count() <= WIDTH));
    }

    #[test]
    fn texts_are_broken_at_blanks() {
        assert_eq!(wrapped("a bc  def", 4), ["a bc", "def"]);
        assert_eq!(wrapped("abcdefg h", 4), ["abcdefg", "h"]);
        let long = "word ".repeat(40);
        for head in ["name", &"n".repeat(60)] {
            let text = glossary(&rows(&[&[head, long.trim()], &["other", "short"]]));
            assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
            assert_eq!(text.matches("word").count(), 40);
        }
    }
}
