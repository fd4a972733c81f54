//! What a study gives: tables with units, and files.

use serde_json::{Map, Value, json};

/// The result of a study.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StudyResult {
    /// The result in words; each line ends with a newline.
    pub summary: String,
    /// Lines for people that the work has found.
    pub warnings: Vec<String>,
    /// Why the result is of no use, if it is not. The command then ends with exit code 1.
    pub failure: Option<String>,
    /// What the JSON form states beside the rows.
    pub about: Map<String, Value>,
    /// The first table is the result; others are beside it.
    pub tables: Vec<StudyTable>,
    /// Files for the folder of `--out`.
    pub files: Vec<StudyFile>,
    /// Files whose names the arguments give.
    pub named_files: Vec<StudyFile>,
    /// Time that was simulated [s]; 0: nothing is simulated, or it is not counted.
    pub simulated: f64,
}

/// A file as a result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StudyFile {
    pub name: String,
    pub content: Vec<u8>,
}

impl StudyFile {
    pub fn new(name: impl Into<String>, content: impl Into<Vec<u8>>) -> Self {
        Self { name: name.into(), content: content.into() }
    }
}

/// Columns of equal length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StudyTable {
    pub name: String,
    pub columns: Vec<StudyColumn>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct StudyColumn {
    pub name: String,
    /// SI unit; "1" for dimensionless numbers, "" for names.
    pub unit: String,
    pub values: ColumnValues,
}

#[derive(Clone, Debug, PartialEq)]
pub enum ColumnValues {
    /// NaN where a number is undefined.
    Numbers(Vec<f64>),
    Names(Vec<String>),
}

/// A column of rows of type `R`: its name, its unit, and its value in a row.
pub type RowColumn<'a, R> = (&'a str, &'a str, fn(&R) -> f64);

impl StudyColumn {
    pub fn numbers(name: &str, unit: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let unit = if unit.is_empty() { "1" } else { unit };
        Self { name: name.into(), unit: unit.into(), values: ColumnValues::Numbers(values.into_iter().collect()) }
    }

    pub fn names<S: Into<String>>(name: &str, values: impl IntoIterator<Item = S>) -> Self {
        let values = values.into_iter().map(Into::into).collect();
        Self { name: name.into(), unit: String::new(), values: ColumnValues::Names(values) }
    }

    /// Columns of numbers that functions of the rows give, each with its name and unit.
    pub fn of_rows<R>(rows: &[R], columns: &[RowColumn<R>]) -> Vec<Self> {
        columns.iter().map(|(name, unit, of)| Self::numbers(name, unit, rows.iter().map(of))).collect()
    }

    pub fn rows(&self) -> usize {
        match &self.values {
            ColumnValues::Numbers(numbers) => numbers.len(),
            ColumnValues::Names(names) => names.len(),
        }
    }

    /// A cell as text. A number has as many digits as it needs to be read back to the bit; NaN is blank.
    fn cell(&self, row: usize) -> String {
        match &self.values {
            ColumnValues::Numbers(numbers) if numbers[row].is_nan() => String::new(),
            ColumnValues::Numbers(numbers) => numbers[row].to_string(),
            ColumnValues::Names(names) => quoted(&names[row]),
        }
    }

    fn value(&self, row: usize) -> Value {
        match &self.values {
            ColumnValues::Numbers(numbers) => json!(numbers[row]),
            ColumnValues::Names(names) => json!(names[row]),
        }
    }
}

/// A cell in CSV format.
pub fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n', '\r']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.into() }
}

impl StudyTable {
    pub fn new(name: &str, columns: Vec<StudyColumn>) -> Self {
        Self { name: name.into(), columns }
    }

    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, StudyColumn::rows)
    }

    /// The column of this name.
    pub fn column(&self, name: &str) -> Option<&StudyColumn> {
        self.columns.iter().find(|column| column.name == name)
    }

    /// The heading and the rows as lines of CSV, without the ends of the lines.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let heading = self.columns.iter().map(|column| quoted(&column.name)).collect::<Vec<_>>().join(",");
        let line = |row| self.columns.iter().map(|column| column.cell(row)).collect::<Vec<_>>().join(",");
        std::iter::once(heading).chain((0..self.rows()).map(line))
    }

    pub fn csv(&self) -> String {
        self.lines().map(|line| line + "\n").collect()
    }

    /// A row as an object; NaN is null.
    pub fn row(&self, row: usize) -> Map<String, Value> {
        self.columns.iter().map(|column| (column.name.clone(), column.value(row))).collect()
    }
}

impl StudyResult {
    /// The result as a table.
    pub fn table(table: StudyTable) -> Self {
        Self { tables: vec![table], ..Self::default() }
    }

    /// What is stated beside the rows, and the rows of the first table.
    pub fn json(&self) -> Map<String, Value> {
        let mut all = self.about.clone();
        if let Some(table) = self.tables.first() {
            all.insert("results".into(), (0..table.rows()).map(|row| Value::Object(table.row(row))).collect());
        }
        all
    }
}
