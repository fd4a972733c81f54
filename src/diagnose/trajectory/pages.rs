//! Reads the pages of a Parquet column, with limits on their sizes. The page reader of the `parquet` crate is not used, because it
//! allocates whatever size a page's header states, and because it needs decompressors in C.
//!
//! Field numbers are those of parquet.thrift.

use super::compact::{Compact, Numbers};
use super::packed::Packing;
use parquet::basic::Encoding;
use parquet::column::page::{Page, PageMetadata, PageReader};
use parquet::errors::{ParquetError, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Largest header of a page [bytes]: our choice, which leaves room for statistics.
const HEADER: u64 = 16 << 10;
/// Largest number of pages of a file: our choice, so that a file of empty pages does not take hours.
const MOST_PAGES: u64 = 100_000;
/// Largest size of all pages that are in memory at the same time, decompressed [bytes]: our choice.
const AT_ONCE: u64 = 256 << 20;

/// Counts over all columns of a file.
#[derive(Default)]
pub struct Counts {
    pages: AtomicU64,
    /// Decompressed bytes of the pages in memory.
    held: AtomicU64,
}

/// The pages of a column in one row group.
pub struct Pages {
    file: Arc<File>,
    at: u64,
    end: u64,
    packing: Packing,
    counts: Arc<Counts>,
    /// Bytes of the dictionary and of the last page.
    held: [u64; 2],
}

impl Pages {
    /// The pages in bytes `from` to `end` of the file.
    pub fn new(file: Arc<File>, [from, end]: [u64; 2], packing: Packing, counts: Arc<Counts>) -> Self {
        Self { file, at: from, end, packing, counts, held: [0; 2] }
    }

    fn next_page(&mut self) -> std::result::Result<Option<Page>, String> {
        while self.at < self.end {
            let mut bytes = Vec::new();
            self.read(HEADER.min(self.end - self.at), &mut bytes)?;
            let mut compact = Compact { bytes: &bytes, at: 0 };
            let header = Header::read(&mut compact).ok_or("a page's header is broken")?;
            self.at += compact.at as u64;
            if header.packed > self.end - self.at {
                return Err("a page ends beyond the end of its column".into());
            }
            if self.counts.pages.fetch_add(1, Relaxed) >= MOST_PAGES {
                return Err(format!("the file has more than {MOST_PAGES} pages"));
            }
            let from = self.at;
            self.at += header.packed;
            if header.kind == INDEX {
                continue;
            }
            self.hold(&header)?;
            bytes.clear();
            let next = std::mem::replace(&mut self.at, from);
            self.read(header.packed, &mut bytes)?;
            self.at = next;
            return header.page(&bytes, self.packing).map(Some);
        }
        Ok(None)
    }

    fn read(&self, length: u64, bytes: &mut Vec<u8>) -> std::result::Result<(), String> {
        let mut file = &*self.file;
        file.seek(SeekFrom::Start(self.at)).map_err(|e| e.to_string())?;
        match file.take(length).read_to_end(bytes).map_err(|e| e.to_string())? as u64 == length {
            true => Ok(()),
            false => Err("the file ends within a page".into()),
        }
    }

    /// Counts the memory of a new page. It replaces the previous page; a dictionary is kept together with the pages that use it.
    fn hold(&mut self, header: &Header) -> std::result::Result<(), String> {
        let place = &mut self.held[usize::from(header.kind != DICTIONARY)];
        let before = std::mem::replace(place, header.unpacked);
        let held = self.counts.held.fetch_add(header.unpacked, Relaxed).saturating_add(header.unpacked);
        self.counts.held.fetch_sub(before, Relaxed);
        match held > AT_ONCE {
            true => {
                Err(format!("a row group needs {} MiB at once; at most {} MiB are read", held >> 20, AT_ONCE >> 20))
            }
            false => Ok(()),
        }
    }
}

impl Drop for Pages {
    fn drop(&mut self) {
        self.counts.held.fetch_sub(self.held.iter().sum(), Relaxed);
    }
}

impl Iterator for Pages {
    type Item = Result<Page>;

    fn next(&mut self) -> Option<Self::Item> {
        self.get_next_page().transpose()
    }
}

impl PageReader for Pages {
    fn get_next_page(&mut self) -> Result<Option<Page>> {
        self.next_page().map_err(ParquetError::General)
    }

    // Called only to skip pages, which this reader never does.
    fn peek_next_page(&mut self) -> Result<Option<PageMetadata>> {
        Err(ParquetError::NYI("pages are read one after the other".into()))
    }

    fn skip_next_page(&mut self) -> Result<()> {
        Err(ParquetError::NYI("pages are read one after the other".into()))
    }

    /// Columns without lists have one row for each value.
    fn at_record_boundary(&mut self) -> Result<bool> {
        Ok(true)
    }
}

const DATA: i64 = 0;
const INDEX: i64 = 1;
const DICTIONARY: i64 = 2;
const DATA_V2: i64 = 3;

/// A page's header.
struct Header {
    kind: i64,
    unpacked: u64,
    packed: u64,
    /// Fields of the struct for this kind of page, by number; the first is field 1. Booleans are 0 and 1.
    own: Numbers,
}

impl Header {
    /// Reads a header; `compact` then stands at the first byte after it.
    fn read(compact: &mut Compact) -> Option<Self> {
        let (mut sizes, mut own) = ([None; 3], [None; 8]);
        let mut id = 0;
        while let Some(kind) = compact.field(&mut id)? {
            match (id, kind) {
                (1..=3, 5) => sizes[id as usize - 1] = Some(compact.signed()?),
                (5 | 7 | 8, 12) => own = compact.table()?,
                _ => compact.skip(kind, 0)?,
            }
        }
        let [kind, unpacked, packed] = sizes;
        Some(Self { kind: kind?, unpacked: u64::try_from(unpacked?).ok()?, packed: u64::try_from(packed?).ok()?, own })
    }

    fn own(&self, id: usize) -> std::result::Result<i64, String> {
        self.own[id - 1].ok_or_else(|| "a page's header lacks a field".into())
    }

    fn count(&self, id: usize) -> std::result::Result<u32, String> {
        u32::try_from(self.own(id)?).map_err(|_| "a page's header has a negative number".into())
    }

    fn encoding(&self, id: usize) -> std::result::Result<Encoding, String> {
        Ok(match self.own(id)? {
            0 => Encoding::PLAIN,
            2 => Encoding::PLAIN_DICTIONARY,
            3 => Encoding::RLE,
            5 => Encoding::DELTA_BINARY_PACKED,
            6 => Encoding::DELTA_LENGTH_BYTE_ARRAY,
            7 => Encoding::DELTA_BYTE_ARRAY,
            8 => Encoding::RLE_DICTIONARY,
            9 => Encoding::BYTE_STREAM_SPLIT,
            other => return Err(format!("encoding {other} is not read")),
        })
    }

    fn page(&self, bytes: &[u8], packing: Packing) -> std::result::Result<Page, String> {
        // In pages of version 2, the levels come first and are not compressed, and the rest need not be compressed.
        let levels = if self.kind == DATA_V2 { u64::from(self.count(5)?) + u64::from(self.count(6)?) } else { 0 };
        let packed = self.kind != DATA_V2 || self.own[6] != Some(0);
        let packing = if packed { packing } else { Packing::Plain };
        let size = self.unpacked.checked_sub(levels).ok_or("a page's levels are longer than the page")?;
        let (before, rest) = bytes.split_at_checked(levels as usize).ok_or("a page's levels end beyond the page")?;
        // A page without values has no compressed data, not even an empty compressed part.
        let rest = if size == 0 { Vec::new() } else { packing.unpack(rest, size)? };
        let buf = if levels == 0 { rest } else { [before, &rest].concat() }.into();
        let num_values = self.count(1)?;
        Ok(match self.kind {
            DATA => Page::DataPage {
                buf,
                num_values,
                encoding: self.encoding(2)?,
                def_level_encoding: self.encoding(3)?,
                rep_level_encoding: self.encoding(4)?,
                statistics: None,
            },
            DICTIONARY => Page::DictionaryPage { buf, num_values, encoding: self.encoding(2)?, is_sorted: false },
            DATA_V2 => Page::DataPageV2 {
                buf,
                num_values,
                encoding: self.encoding(4)?,
                num_nulls: self.count(2)?,
                num_rows: self.count(3)?,
                def_levels_byte_len: self.count(5)?,
                rep_levels_byte_len: self.count(6)?,
                is_compressed: false,
                statistics: None,
            },
            other => return Err(format!("a page has the unknown type {other}")),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Counts, MOST_PAGES, Page, Pages};
    use crate::trajectory::packed::Packing;
    use std::io::Write;
    use std::sync::Arc;

    /// The last page, or the error.
    fn told(bytes: &[u8]) -> Result<Page, String> {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytes).unwrap();
        let counts = Arc::new(Counts::default());
        let pages = Pages::new(Arc::new(file), [0, bytes.len() as u64], Packing::Plain, counts);
        let all: Result<Vec<Page>, _> = pages.collect();
        all.map_err(|e| e.to_string()).map(|mut pages| pages.pop().unwrap())
    }

    /// A data page of two bytes: its header states 300 values, plain encoding and run-length levels, and has statistics.
    const PAGE: [u8; 22] = [
        0x15, 0x00, 0x15, 0x04, 0x15, 0x04, 0x2c, 0x15, 0xd8, 0x04, 0x15, 0x00, 0x15, 0x06, 0x15, 0x06, 0x1c, 0x00,
        0x00, 0x00, 7, 8,
    ];

    #[test]
    fn pages_are_read() {
        let Ok(Page::DataPage { buf, num_values, .. }) = told(&[PAGE, PAGE].concat()) else { panic!() };
        assert_eq!((&buf[..], num_values), (&[7, 8][..], 300));
    }

    #[test]
    fn pages_with_wrong_sizes_are_refused() {
        assert!(told(&PAGE[..21]).unwrap_err().contains("ends beyond"));
        assert!(told(&PAGE[..9]).unwrap_err().contains("broken"));
        // A page that states 64 MiB and a byte, and one that states three bytes instead of two.
        let large = [&PAGE[..3], &[0x82, 0x80, 0x80, 0x40], &PAGE[4..]].concat();
        assert!(told(&large).unwrap_err().contains("at most"));
        let longer = [&PAGE[..3], &[0x06], &PAGE[4..]].concat();
        assert!(told(&longer).unwrap_err().contains("that the file states"));
        // Index pages are skipped, but count as pages.
        let tiny = [0x15, 0x02, 0x15, 0x00, 0x15, 0x00, 0x00].repeat(MOST_PAGES as usize + 1);
        assert!(told(&tiny).unwrap_err().contains("pages"));
        // A negative size, and a list that states more elements than there are bytes.
        assert!(told(&[0x15, 0x00, 0x15, 0x01, 0x15, 0x00, 0x00]).unwrap_err().contains("broken"));
        assert!(told(&[0x59, 0xf5, 0xff, 0xff, 0xff, 0xff, 0x0f, 0x00]).unwrap_err().contains("broken"));
    }
}
