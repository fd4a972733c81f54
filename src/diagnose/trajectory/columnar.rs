//! Logs as Parquet. The columns are those of a CSV log; they are read in batches and passed on row by row.

use super::compact::Compact;
use super::packed::Packing;
use super::pages::{Counts, Pages};
use crate::error::{Error, Result};
use crate::table::{Asked, Cells, Row, rows};
use parquet::basic::Compression;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl, get_column_reader};
use parquet::data_type::DataType;
use parquet::file::metadata::{ColumnChunkMetaData, ParquetMetaDataReader};
use std::cell::Cell;
use std::fs::File;
use std::io::{Read as _, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::Path;
use std::sync::{Arc, Once};

/// The first bytes of a file.
pub const MAGIC: &[u8] = b"PAR1";
/// Largest footer [bytes]; it is decoded as a whole. Our choice: with a hundred columns in a hundred row groups it has 2 MB.
const LONGEST_FOOTER: u64 = 4 << 20;
/// Largest number of columns of a file: our choice, those of some ten robots.
const MOST_COLUMNS: u64 = 1000;
/// Field numbers in the footer: the list of columns, and a column's number of children (parquet.thrift).
const SCHEMA: i64 = 2;
const CHILDREN: usize = 5;
/// Number of rows that are read from each column at once: our choice, which needs little memory.
const TOGETHER: usize = 1024;
/// Largest number of characters of a cell: our choice; names of runs are short.
const LONGEST_CELL: usize = 1000;

type Read<T> = std::result::Result<T, String>;

/// Calls `take` with each row of a file.
pub fn read(path: &Path, asked: &Asked, take: impl FnMut(&Row) -> Result<()>) -> Result<()> {
    let wrong = |reason: &dyn std::fmt::Display| Error::file(path, format!("Parquet: {reason}"));
    let mut file = File::open(path).map_err(|e| Error::file(path, e))?;
    let bytes = check_footer(&mut file).map_err(|reason| wrong(&reason))?;
    let parse = || ParquetMetaDataReader::new().parse_and_finish(&file).map_err(|e| e.to_string());
    let metadata = guarded(parse).map_err(|reason| wrong(&reason))?;
    let file = Arc::new(file);
    let columns = metadata.file_metadata().schema_descr().columns();
    let names: Vec<String> = columns.iter().map(|c| c.path().string()).collect();
    let wanted = asked.wanted(path, &names)?;
    let header: Vec<String> = wanted.iter().map(|&k| names[k].clone()).collect();
    let of_values: Vec<i16> = columns.iter().map(|c| c.max_def_level()).collect();
    let mut batch = Batch::default();
    let (mut group, mut row) = (0, 0);
    let counts = Arc::new(Counts::default());
    let mut open: Vec<ColumnReader> = Vec::new();
    let next = |cells: &mut Cells| -> Result<bool> {
        while row == batch.rows {
            row = 0;
            let read = || Batch::read(&mut open, &wanted, &names, &of_values);
            batch = guarded(read).map_err(|reason| wrong(&reason))?;
            if batch.rows > 0 {
                break;
            }
            open.clear();
            let Some(own) = metadata.row_groups().get(group) else { return Ok(false) };
            group += 1;
            for &k in &wanted {
                let reason = |reason: String| wrong(&format!("column {}: {reason}", names[k]));
                let chunk = own.columns().get(k).ok_or_else(|| reason("is not in each group of rows".into()))?;
                let (span, packing) = place(chunk, bytes).map_err(reason)?;
                let pages = Pages::new(file.clone(), span, packing, counts.clone());
                open.push(get_column_reader(columns[k].clone(), Box::new(pages)));
            }
        }
        batch.columns.iter().for_each(|column| cells.push_field(&column[row]));
        row += 1;
        Ok(true)
    };
    rows(path, &header, asked, next, take)
}

/// Calls the `parquet` crate and returns its panics as errors: some of its decoders (60.1.0) panic if a page has fewer bytes than
/// its header states. Nothing is printed.
fn guarded<T>(work: impl FnOnce() -> Read<T>) -> Read<T> {
    static HOOK: Once = Once::new();
    thread_local!(static WITHIN: Cell<bool> = const { Cell::new(false) });
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| {
            if !WITHIN.get() {
                before(info)
            }
        }));
    });
    WITHIN.set(true);
    let done = catch_unwind(AssertUnwindSafe(work));
    WITHIN.set(false);
    done.unwrap_or_else(|_| Err("a page or the footer is damaged".into()))
}

/// Checks the footer before the `parquet` crate decodes it, because the crate allocates memory for as many columns as the footer
/// states, and recurses once for each level of nesting. Returns the length of the file.
fn check_footer(file: &mut File) -> Read<u64> {
    let end = file.seek(SeekFrom::End(-8)).map_err(|_| "the file is too short")?;
    let mut tail = [0; 8];
    file.read_exact(&mut tail).map_err(|e| e.to_string())?;
    if !tail.ends_with(MAGIC) {
        return Err("the file does not end with PAR1: it was cut off".into());
    }
    let [a, b, c, d, ..] = tail;
    let length = u64::from(u32::from_le_bytes([a, b, c, d]));
    if length > LONGEST_FOOTER {
        return Err(format!("the footer has {length} bytes; at most {LONGEST_FOOTER} are read"));
    }
    let from = end.checked_sub(length).ok_or("the footer is longer than the file")?;
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(from)).map_err(|e| e.to_string())?;
    file.take(length).read_to_end(&mut bytes).map_err(|e| e.to_string())?;
    let columns = columns(&bytes).ok_or("the footer is damaged")?;
    match columns > MOST_COLUMNS {
        true => Err(format!("the file has {columns} columns; at most {MOST_COLUMNS} are read")),
        false => Ok(end + 8),
    }
}

/// Number of columns in a footer, or the number of children that a column states, whichever is larger.
fn columns(bytes: &[u8]) -> Option<u64> {
    let mut compact = Compact { bytes, at: 0 };
    let (mut id, mut most) = (0, 0);
    while let Some(kind) = compact.field(&mut id)? {
        if (id, kind) == (SCHEMA, 9) {
            let (_, count) = compact.list()?;
            most = most.max(count);
            for _ in 0..count.min(MOST_COLUMNS) {
                most = most.max(u64::try_from(compact.table()?[CHILDREN - 1].unwrap_or(0)).ok()?);
            }
            if count > MOST_COLUMNS {
                break;
            }
        } else {
            compact.skip(kind, 0)?;
        }
    }
    Some(most)
}

/// First and last byte of a column of one row group, and its compression.
fn place(chunk: &ColumnChunkMetaData, bytes: u64) -> Read<([u64; 2], Packing)> {
    let packing = match chunk.compression() {
        Compression::UNCOMPRESSED => Packing::Plain,
        Compression::SNAPPY => Packing::Snappy,
        Compression::GZIP(_) => Packing::Gzip,
        Compression::LZ4_RAW => Packing::Lz4Block,
        Compression::ZSTD(_) => Packing::Zstd,
        other => return Err(format!("the compression {other} is not read; use snappy, gzip, lz4_raw, zstd or none")),
    };
    if chunk.column_descr().max_rep_level() > 0 {
        return Err("the column has lists, which are not read".into());
    }
    let from = chunk.dictionary_page_offset().unwrap_or_else(|| chunk.data_page_offset());
    let ends = [from, chunk.data_page_offset(), chunk.compressed_size()].map(u64::try_from);
    let [Ok(from), Ok(data), Ok(length)] = ends else {
        return Err("its position in the file is negative".into());
    };
    let end = from.checked_add(length).filter(|end| *end <= bytes && data >= from && data < *end);
    Ok(([from, end.ok_or("it ends beyond the end of the file")?], packing))
}

/// Some rows, column by column, as text.
#[derive(Default)]
struct Batch {
    rows: usize,
    columns: Vec<Vec<String>>,
}

impl Batch {
    fn read(open: &mut [ColumnReader], wanted: &[usize], names: &[String], of_values: &[i16]) -> Read<Self> {
        let mut columns = Vec::with_capacity(open.len());
        for (reader, &k) in open.iter_mut().zip(wanted) {
            columns.push(cells(reader, of_values[k]).map_err(|e| format!("column {}: {e}", names[k]))?);
        }
        let rows = columns.first().map_or(0, Vec::len);
        match columns.iter().all(|c| c.len() == rows) {
            true => Ok(Self { rows, columns }),
            false => Err("columns differ in length".into()),
        }
    }
}

/// The next rows of a column as text. `there` is the definition level of a row that has a value.
fn cells(reader: &mut ColumnReader, there: i16) -> Read<Vec<String>> {
    match reader {
        ColumnReader::BoolColumnReader(own) => some(own, there, |v| Ok(u8::from(*v).to_string())),
        ColumnReader::Int32ColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::Int64ColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::FloatColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::DoubleColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::ByteArrayColumnReader(own) => some(own, there, |v| match std::str::from_utf8(v.data()) {
            Ok(text) if text.len() <= LONGEST_CELL => Ok(text.to_string()),
            Ok(_) => Err(format!("a cell has more than {LONGEST_CELL} characters")),
            Err(_) => Err("a text is not UTF-8".into()),
        }),
        _ => Err("its values are neither numbers nor text".into()),
    }
}

/// The next rows of a column, each by `text`; blank if a row has no value.
fn some<T: DataType>(
    reader: &mut ColumnReaderImpl<T>,
    there: i16,
    text: impl Fn(&T::T) -> Read<String>,
) -> Read<Vec<String>> {
    let (mut levels, mut values) = (Vec::new(), Vec::new());
    let read = reader.read_records(TOGETHER, Some(&mut levels), None, &mut values);
    let (records, ..) = read.map_err(|e| e.to_string())?;
    if there == 0 {
        return values.iter().map(text).collect();
    }
    let mut values = values.iter();
    let mut cell = |level: &i16| match *level == there {
        true => values.next().map_or_else(|| Err("it has fewer values than rows".into()), &text),
        false => Ok(String::new()),
    };
    levels.iter().take(records).map(&mut cell).collect()
}

#[cfg(test)]
mod tests {
    use super::columns;

    /// A footer with a version and two columns: a root that states `children`, and a leaf.
    fn footer(children: &[u8]) -> Vec<u8> {
        let (root, leaf) = ([&[0x48, 1, b'r', 0x15], children, &[0]].concat(), [0x15, 0x0a, 0x38, 1, b'a', 0]);
        [&[0x15, 2, 0x19, 0x2c], &root[..], &leaf, &[0]].concat()
    }

    #[test]
    fn columns_of_a_footer_are_counted() {
        assert_eq!(columns(&footer(&[2])), Some(2));
        // A billion children.
        assert_eq!(columns(&footer(&[0x80, 0xa8, 0xd6, 0xb9, 0x07])), Some(1_000_000_000));
        // A billion columns in a few bytes; a negative number of children; a footer that was cut off.
        assert_eq!(columns(&[0x29, 0xfc, 0x80, 0x94, 0xeb, 0xdc, 0x03]), None);
        assert_eq!(columns(&footer(&[1])), None);
        assert_eq!(columns(&footer(&[2])[..9]), None);
    }
}
