//! Tables: long headers, and readers that stop.

use sandgait::table::{HeaderColumn, Quantity, ReadOptions, parse};
use sandgait::{Error, Result, progress};
use std::cell::Cell;
use std::path::Path;
use std::time::{Duration, Instant};

fn columns() -> [HeaderColumn<'static>; 1] {
    [HeaderColumn::needed("force", Quantity::Force)]
}

/// The file's header is read only once, so a long header takes little time; a file with more than 4096 columns is
/// refused.
#[test]
fn a_long_header_takes_no_time() {
    let columns = columns();
    for (count, refused) in [(4095, false), (1_000_000, true)] {
        let names: Vec<String> = (0..count).map(|k| format!("c{k}")).collect();
        let text = format!("force,{}\n1{}\n", names.join(","), ",0".repeat(count));
        let start = Instant::now();
        let read = parse(Path::new("log.csv"), text.as_bytes(), &ReadOptions::new(&columns), |_| Ok(()));
        assert!(start.elapsed() < Duration::from_secs(2), "{count} columns: {:?}", start.elapsed());
        assert_eq!(read.is_err(), refused);
        if let Err(error) = read {
            assert_eq!(error.to_string(), "log.csv: row 1: 1000001 columns are more than 4096");
        }
    }
}

/// Stops at the third report.
struct Left(std::sync::Mutex<usize>);

impl progress::Progress for Left {
    fn report(&self, _: f64, _: &str) -> Result<()> {
        let mut left = self.0.lock().unwrap();
        *left = left.checked_sub(1).ok_or_else(|| Error::Cancelled("gone".into()))?;
        Ok(())
    }
}

#[test]
fn reading_stops_when_its_client_has_left() {
    let (columns, rows) = (columns(), Cell::new(0));
    let text = format!("force\n{}", "1\n".repeat(100_000));
    let left = Left(std::sync::Mutex::new(2));
    let asked = ReadOptions { progress: &left, ..ReadOptions::new(&columns) };
    let read = parse(Path::new("log.csv"), text.as_bytes(), &asked, |_| {
        rows.set(rows.get() + 1);
        Ok(())
    });
    assert!(matches!(read, Err(Error::Cancelled(_))) && rows.get() < 10_000, "{} rows", rows.get());
}
