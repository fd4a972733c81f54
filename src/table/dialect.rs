//! The ways in which programs write tables: separator of the columns, sign of the decimals, mark of the encoding.

use super::header::{ReadOptions, plain};
use std::cell::Cell;
use std::io::{BufRead, Read};

/// Separators that are tried, the usual one first.
const SEPARATORS: [u8; 4] = [b',', b';', b'\t', b'|'];
/// Largest part of a file that is searched for its header [bytes]: our choice; comments may stand before it.
const LONGEST_HEAD: u64 = 1 << 20;
/// The mark with which some programs begin a text in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// The beginning of a file up to the end of its header, without marks that are no part of the table.
pub struct Head {
    pub text: Vec<u8>,
    /// Lines before `text`: spreadsheets write a line `sep=;`.
    pub skipped: u64,
    stated: Option<u8>,
}

impl Head {
    pub fn read(source: &mut impl BufRead) -> std::io::Result<Self> {
        let mut source = source.take(LONGEST_HEAD);
        let mut head = Self { text: Vec::new(), skipped: 0, stated: None };
        loop {
            let begin = head.text.len();
            if source.read_until(b'\n', &mut head.text)? == 0 {
                return Ok(head);
            }
            if begin == 0 && head.text.starts_with(BYTE_ORDER_MARK) {
                head.text.drain(..BYTE_ORDER_MARK.len());
            }
            let line = head.text[begin..].trim_ascii();
            if let (Some(&[separator]), 0) = (line.strip_prefix(b"sep="), begin) {
                (head.skipped, head.stated) = (1, Some(separator));
                head.text.clear();
            } else if !line.is_empty() && !line.starts_with(b"#") {
                return Ok(head);
            }
        }
    }

    /// The separator of the columns: the one that the file states, or the one with which the header has most of the requested columns.
    pub fn separator(&self, asked: &ReadOptions) -> u8 {
        if let Some(stated) = self.stated.filter(|s| SEPARATORS.contains(s)) {
            return stated;
        }
        let likeness = |separator: u8| {
            let header = self.first_row(separator);
            (asked.named_in(&header), header.len())
        };
        let better = |best: (u8, (usize, usize)), separator: u8| {
            let own = likeness(separator);
            if own > best.1 { (separator, own) } else { best }
        };
        SEPARATORS[1..].iter().fold((SEPARATORS[0], likeness(SEPARATORS[0])), |best, s| better(best, *s)).0
    }

    fn first_row(&self, separator: u8) -> Vec<String> {
        let mut reader =
            csv::ReaderBuilder::new().delimiter(separator).comment(Some(b'#')).from_reader(self.text.as_slice());
        let header = reader.headers().map(|h| h.iter().map(|cell| cell.trim().to_owned()).collect());
        header.unwrap_or_default()
    }
}

/// What separates columns, in words.
pub fn in_words(separator: u8) -> String {
    if separator == b'\t' { "tabs".into() } else { format!("{:?}", char::from(separator)) }
}

/// The sign before the decimals, which all numbers of a file share.
#[derive(Default)]
pub struct DecimalSign {
    /// The sign, and the row of the first number that has it.
    seen: Cell<Option<(char, u64)>>,
    /// Can the comma only stand before decimals, and not between thousands?
    certain: Cell<bool>,
}

impl DecimalSign {
    /// The number in a cell of row `line`, or what is wrong.
    pub fn number(&self, cell: &str, line: u64) -> Result<f64, String> {
        let (commas, points) = (cell.matches(',').count(), cell.contains('.'));
        if commas > 1 || (commas > 0 && points) {
            return Err(format!("{cell} has a separator of thousands: write the number without it"));
        }
        let sign = if commas > 0 { ',' } else { '.' };
        if commas > 0 || points {
            match self.seen.get() {
                None => self.seen.set(Some((sign, line))),
                Some((other, row)) if other != sign => {
                    let words = |sign| if sign == ',' { "comma" } else { "point" };
                    let (own, other) = (words(sign), words(other));
                    return Err(format!("{cell} has a decimal {own}, and a number in row {row} has a decimal {other}"));
                }
                Some(_) => (),
            }
        }
        if commas == 0 {
            return plain(cell).ok_or_else(|| format!("{cell:?} is no number"));
        }
        // Between thousands stand up to three digits that are not 0 alone, a comma, and exactly three digits.
        let (whole, rest) = cell.split_once(',').unwrap_or((cell, ""));
        let digits = whole.trim_start_matches(['-', '+']);
        if digits.trim_start_matches('0').is_empty() || digits.len() > 3 || rest.len() != 3 {
            self.certain.set(true);
        }
        plain(&cell.replace(',', ".")).ok_or_else(|| format!("{cell:?} is no number"))
    }

    /// The row of a number with a comma if no number of the file shows whether commas stand before decimals or between thousands.
    pub fn doubtful(&self) -> Option<u64> {
        self.seen.get().filter(|seen| seen.0 == ',' && !self.certain.get()).map(|seen| seen.1)
    }

    pub fn is_comma(&self) -> bool {
        self.seen.get().is_some_and(|seen| seen.0 == ',')
    }
}
