//! Logs as Parquet, column by column: the same columns as in CSV, handed on row by row.

use super::pages;
use crate::error::{Error, Result};
use crate::table::{Asked, Cells, Row, rows};
use parquet::basic::Compression;
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::DataType;
use parquet::file::metadata::ColumnChunkMetaData;
use parquet::file::reader::{FileReader, SerializedFileReader};
use std::fs::File;
use std::io::{Read as _, Seek, SeekFrom};
use std::path::Path;

/// The first bytes of a file.
pub const MAGIC: &[u8] = b"PAR1";
/// Bytes of the summary at a file's end, which is unpacked whole: our choice.
const LONGEST_SUMMARY: u32 = 16 << 20;
/// Bytes that the pages read at once may have, unpacked: our choice.
const AT_ONCE: u64 = 256 << 20;
/// Rows taken from each column at once: our choice.
const TOGETHER: usize = 1024;
/// Characters of a cell: our choice, names of runs are short.
const LONGEST_CELL: usize = 1000;

type Read<T> = std::result::Result<T, String>;

/// Hands each row of a file to `take`.
pub fn read(path: &Path, asked: &Asked, take: impl FnMut(&Row) -> Result<()>) -> Result<()> {
    let wrong = |reason: &dyn std::fmt::Display| Error::file(path, format!("Parquet: {reason}"));
    let mut file = File::open(path).map_err(|e| Error::file(path, e))?;
    let bytes = summary(&mut file).map_err(|reason| wrong(&reason))?;
    let reader = SerializedFileReader::new(file.try_clone().map_err(|e| Error::file(path, e))?);
    let reader = reader.map_err(|e| wrong(&e))?;
    let columns = reader.metadata().file_metadata().schema_descr().columns();
    let names: Vec<String> = columns.iter().map(|c| c.path().string()).collect();
    let wanted = asked.wanted(path, &names)?;
    let header: Vec<String> = wanted.iter().map(|&k| names[k].clone()).collect();
    let of_values: Vec<i16> = columns.iter().map(|c| c.max_def_level()).collect();
    let mut batch = Batch::default();
    let (mut group, mut row, mut pages) = (0, 0, 0);
    let mut open: Vec<ColumnReader> = Vec::new();
    let next = |cells: &mut Cells| -> Result<bool> {
        while row == batch.rows {
            row = 0;
            batch = Batch::read(&mut open, &wanted, &names, &of_values).map_err(|reason| wrong(&reason))?;
            if batch.rows > 0 {
                break;
            }
            if group == reader.num_row_groups() {
                return Ok(false);
            }
            let metadata = reader.metadata().row_group(group);
            let chunks = wanted.iter().map(|&k| metadata.columns().get(k).map(|chunk| (&names[k], chunk)));
            check(&mut file, bytes, chunks, &mut pages).map_err(|reason| wrong(&reason))?;
            let own = reader.get_row_group(group).map_err(|e| wrong(&e))?;
            open = wanted.iter().map(|&k| own.get_column_reader(k).map_err(|e| wrong(&e))).collect::<Result<_>>()?;
            group += 1;
        }
        batch.columns.iter().for_each(|column| cells.push_field(&column[row]));
        row += 1;
        Ok(true)
    };
    rows(path, &header, asked, next, take)
}

/// Length of a file whose summary is not too long.
fn summary(file: &mut File) -> Read<u64> {
    let end = file.seek(SeekFrom::End(-8)).map_err(|_| "shorter than its own ends")?;
    let mut tail = [0; 8];
    file.read_exact(&mut tail).map_err(|e| e.to_string())?;
    let [a, b, c, d, ..] = tail;
    let length = u32::from_le_bytes([a, b, c, d]);
    match length > LONGEST_SUMMARY {
        true => Err(format!("a summary of {length} bytes; at most {LONGEST_SUMMARY} are read")),
        false => Ok(end + 8),
    }
}

/// Looks at the pages of the columns of one group of rows before any of them is unpacked.
fn check<'a>(
    file: &mut File,
    bytes: u64,
    chunks: impl Iterator<Item = Option<(&'a String, &'a ColumnChunkMetaData)>>,
    pages: &mut usize,
) -> Read<()> {
    let mut together = 0;
    for chunk in chunks {
        let (name, chunk) = chunk.ok_or("a group of rows lacks columns")?;
        if !matches!(chunk.compression(), Compression::UNCOMPRESSED | Compression::SNAPPY | Compression::ZSTD(_)) {
            return Err(format!("column {name}: {} is not read; snappy and zstd are", chunk.compression()));
        }
        if chunk.column_descr().max_rep_level() > 0 {
            return Err(format!("column {name}: lists are not read"));
        }
        let from = chunk.dictionary_page_offset().unwrap_or_else(|| chunk.data_page_offset());
        let ends = [from, chunk.data_page_offset(), chunk.compressed_size()].map(u64::try_from);
        let [Ok(from), Ok(data), Ok(length)] = ends else {
            return Err(format!("column {name}: lies before the file"));
        };
        let end = from.checked_add(length).filter(|end| *end <= bytes && data >= from && data < *end);
        let end = end.ok_or_else(|| format!("column {name}: lies beyond the file"))?;
        let largest = pages::check(file, from, end - from, pages).map_err(|e| format!("column {name}: {e}"))?;
        // A dictionary stays beside the page that it is for.
        together += 2 * largest;
    }
    match together > AT_ONCE {
        true => Err(format!("{} MiB of pages at once; at most {} MiB are read", together >> 20, AT_ONCE >> 20)),
        false => Ok(()),
    }
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

/// `there` is the level at which a row has a value.
fn cells(reader: &mut ColumnReader, there: i16) -> Read<Vec<String>> {
    match reader {
        ColumnReader::BoolColumnReader(own) => some(own, there, |v| Ok(u8::from(*v).to_string())),
        ColumnReader::Int32ColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::Int64ColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::FloatColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::DoubleColumnReader(own) => some(own, there, |v| Ok(v.to_string())),
        ColumnReader::ByteArrayColumnReader(own) => some(own, there, |v| match std::str::from_utf8(v.data()) {
            Ok(text) if text.len() <= LONGEST_CELL => Ok(text.to_string()),
            Ok(_) => Err(format!("a cell of more than {LONGEST_CELL} characters")),
            Err(_) => Err("text is not UTF-8".into()),
        }),
        _ => Err("neither numbers nor text".into()),
    }
}

/// The next rows of a column; blank where there is no value.
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
        true => values.next().map_or_else(|| Err("has fewer values than rows".into()), &text),
        false => Ok(String::new()),
    };
    levels.iter().take(records).map(&mut cell).collect()
}
