//! Pages of a Parquet file, looked at before they are unpacked: a page says itself how large it will be, and whoever unpacks it believes
//! that.
//!
//! Headers are Thrift's compact protocol (Apache Thrift, thrift-compact-protocol.md); fields of a page are those of parquet.thrift.

use std::io::{Read, Seek, SeekFrom};

/// Most bytes that a page may have unpacked: our choice, writers make pages of about a megabyte.
const LARGEST: u64 = 64 << 20;
/// Most bytes of a page's header, which may have statistics: our choice.
const HEADER: u64 = 16 << 10;
/// Pages of a file: our choice, so that tiny ones do not take hours.
pub const MOST_PAGES: usize = 100_000;
/// How deep a header's tables may nest: our choice, those in use are three deep.
const DEEPEST: usize = 16;

type Checked<T> = Result<T, String>;

/// Looks at all pages of a column in bytes `from` … `from` + `length`; `count` counts pages. Gives the largest page's bytes, unpacked.
pub fn check(file: &mut (impl Read + Seek), from: u64, length: u64, count: &mut usize) -> Checked<u64> {
    let (mut at, mut largest) = (0, 0);
    let mut bytes = Vec::new();
    while at < length {
        bytes.clear();
        file.seek(SeekFrom::Start(from + at)).map_err(|e| e.to_string())?;
        file.by_ref().take(HEADER.min(length - at)).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
        let mut compact = Compact { bytes: &bytes, at: 0 };
        let [unpacked, packed] = compact.page().ok_or("a page's header is broken")?;
        *count += 1;
        if *count > MOST_PAGES {
            return Err(format!("more than {MOST_PAGES} pages"));
        }
        if unpacked > LARGEST {
            return Err(format!("a page of {} MiB; at most {} MiB are read", unpacked >> 20, LARGEST >> 20));
        }
        at += compact.at as u64 + packed;
        if at > length {
            return Err("a page ends beyond its column".into());
        }
        largest = largest.max(unpacked);
    }
    Ok(largest)
}

struct Compact<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Compact<'_> {
    /// Unpacked and packed size of a page; leaves off behind its header.
    fn page(&mut self) -> Option<[u64; 2]> {
        let mut sizes = [None; 2];
        let mut id = 0;
        while let Some(kind) = self.field(&mut id)? {
            match (id, kind) {
                (2 | 3, 5) => sizes[id as usize - 2] = Some(u64::try_from(self.signed()?).ok()?),
                _ => self.skip(kind, 0)?,
            }
        }
        Some([sizes[0]?, sizes[1]?])
    }

    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    fn unsigned(&mut self) -> Option<u64> {
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn signed(&mut self) -> Option<i64> {
        let value = self.unsigned()?;
        Some((value >> 1).cast_signed() ^ -((value & 1).cast_signed()))
    }

    fn over(&mut self, count: u64) -> Option<()> {
        let next = self.at.checked_add(usize::try_from(count).ok()?)?;
        self.at = next;
        (next <= self.bytes.len()).then_some(())
    }

    /// Type of the next field, whose number is left in `id`; `Some(None)` at the end.
    fn field(&mut self, id: &mut i64) -> Option<Option<u8>> {
        let byte = self.byte()?;
        if byte == 0 {
            return Some(None);
        }
        *id = match i64::from(byte >> 4) {
            0 => self.signed()?,
            more => id.checked_add(more)?,
        };
        Some(Some(byte & 0x0f))
    }

    fn skip(&mut self, kind: u8, depth: usize) -> Option<()> {
        if depth > DEEPEST {
            return None;
        }
        match kind {
            1 | 2 => Some(()),
            3 => self.over(1),
            4..=6 => self.unsigned().map(drop),
            7 => self.over(8),
            8 => {
                let length = self.unsigned()?;
                self.over(length)
            }
            9 | 10 => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 { self.unsigned()? } else { u64::from(head >> 4) };
                self.elements(&[head & 0x0f], count, depth)
            }
            11 => match self.unsigned()? {
                0 => Some(()),
                count => {
                    let kinds = self.byte()?;
                    self.elements(&[kinds >> 4, kinds & 0x0f], count, depth)
                }
            },
            12 => {
                let mut id = 0;
                while let Some(kind) = self.field(&mut id)? {
                    self.skip(kind, depth + 1)?;
                }
                Some(())
            }
            _ => None,
        }
    }

    fn elements(&mut self, kinds: &[u8], count: u64, depth: usize) -> Option<()> {
        // Each element has at least a byte.
        if count > self.bytes.len() as u64 {
            return None;
        }
        for _ in 0..count {
            for kind in kinds {
                // A truth value has a byte of its own here.
                if matches!(kind, 1 | 2) { self.over(1)? } else { self.skip(*kind, depth + 1)? }
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::{MOST_PAGES, check};
    use std::io::Cursor;

    fn told(bytes: &[u8]) -> Result<u64, String> {
        check(&mut Cursor::new(bytes), 0, bytes.len() as u64, &mut 0)
    }

    #[test]
    fn pages_say_how_large_they_are() {
        // Type 0, 300 bytes unpacked, 2 packed, a table with a list; then the two bytes.
        let page = [0x15, 0x00, 0x15, 0xd8, 0x04, 0x15, 0x04, 0x2c, 0x19, 0x25, 0x02, 0x04, 0x00, 0x00, 7, 7];
        assert_eq!(told(&[page, page].concat()), Ok(300));
        assert!(told(&page[..15]).unwrap_err().contains("ends beyond"));
        assert!(told(&page[..9]).unwrap_err().contains("broken"));
        let large = [0x15, 0x00, 0x15, 0x80, 0x80, 0x80, 0x80, 0x04, 0x15, 0x00, 0x00];
        assert!(told(&large).unwrap_err().contains("at most"));
        let tiny = [0x25, 0x00, 0x15, 0x00, 0x00].repeat(MOST_PAGES + 1);
        assert!(told(&tiny).unwrap_err().contains("pages"));
        // Negative sizes, and a list that claims more than there is.
        assert!(told(&[0x25, 0x01, 0x15, 0x00, 0x00]).is_err());
        assert!(told(&[0x59, 0xf5, 0xff, 0xff, 0xff, 0xff, 0x0f, 0x00]).is_err());
    }
}
