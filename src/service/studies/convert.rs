//! Studies' files and results as messages, and back.

use crate::error::{Error, Result};
use crate::proto;
use crate::study::{ColumnValues, Content, StudyColumn, StudyFile, StudyResult, StudyTable};
use std::collections::BTreeMap;

/// The message of a file or of a table that stands for one.
pub fn input(name: String, content: Content) -> proto::StudyInput {
    use proto::study_input::Form;
    let form = match content {
        Content::Bytes(bytes) => Form::Content(bytes),
        Content::Table(made) => Form::Table(table(made)),
    };
    proto::StudyInput { name, form: Some(form) }
}

/// The files of a request.
pub fn inputs(messages: Vec<proto::StudyInput>) -> Result<BTreeMap<String, Content>> {
    use proto::study_input::Form;
    let mut all = BTreeMap::new();
    for proto::StudyInput { name, form } in messages {
        let content = match form {
            None => return Err(Error::invalid(name, "a file without content")),
            Some(Form::Content(bytes)) => Content::Bytes(bytes),
            Some(Form::Table(message)) => {
                Content::Table(of_table(message).map_err(|e| Error::invalid(&name, e.to_string()))?)
            }
        };
        if all.insert(name.clone(), content).is_some() {
            return Err(Error::invalid(name, "two files have this name"));
        }
    }
    Ok(all)
}

pub fn result(result: StudyResult) -> proto::StudyResult {
    let StudyResult { summary, warnings, failure, about, tables, files, named_files, simulated } = result;
    let failure = failure.unwrap_or_default();
    let about = if about.is_empty() { String::new() } else { serde_json::Value::Object(about).to_string() };
    let tables = tables.into_iter().map(table).collect();
    let [files, named_files] = [files, named_files].map(|files| files.into_iter().map(file).collect());
    proto::StudyResult { summary, warnings, about, tables, files, named_files, simulated, failure }
}

/// The result that a server sent, and the text of its JSON object `about`, which is empty in the result: a reader of JSON may round
/// numbers.
///
/// # Errors
/// The columns of a table have different lengths, or are cut off.
pub fn of_result(message: proto::StudyResult) -> Result<(StudyResult, String)> {
    let proto::StudyResult { summary, warnings, about, tables, files, named_files, simulated, failure } = message;
    let failure = Some(failure).filter(|reason| !reason.is_empty());
    let tables = tables.into_iter().map(of_table).collect::<Result<_>>()?;
    let [files, named_files] = [files, named_files].map(|files| files.into_iter().map(of_file).collect());
    let result =
        StudyResult { summary, warnings, failure, tables, files, named_files, simulated, ..StudyResult::default() };
    Ok((result, about))
}

fn file(StudyFile { name, content }: StudyFile) -> proto::File {
    proto::File { name, content: content.into() }
}

fn of_file(proto::File { name, content }: proto::File) -> StudyFile {
    StudyFile { name, content: content.into() }
}

fn table(StudyTable { name, columns }: StudyTable) -> proto::Table {
    let series = |StudyColumn { name, unit, values }| match values {
        ColumnValues::Numbers(numbers) => {
            let numbers = numbers.into_iter().flat_map(f64::to_le_bytes).collect::<Vec<_>>().into();
            proto::Series { name, unit, numbers, names: Vec::new() }
        }
        ColumnValues::Names(names) => proto::Series { name, unit, names, ..proto::Series::default() },
    };
    proto::Table { name, columns: columns.into_iter().map(series).collect() }
}

fn of_table(proto::Table { name, columns }: proto::Table) -> Result<StudyTable> {
    let columns = columns.into_iter().map(of_series).collect::<Result<Vec<_>>>()?;
    let table = StudyTable { name, columns };
    match table.columns.iter().find(|column| column.rows() != table.rows()) {
        Some(column) => {
            Err(Error::invalid(&column.name, format!("{} rows where {} are expected", column.rows(), table.rows())))
        }
        None => Ok(table),
    }
}

fn of_series(proto::Series { name, unit, numbers, names }: proto::Series) -> Result<StudyColumn> {
    if !names.is_empty() {
        return Ok(StudyColumn { name, unit, values: ColumnValues::Names(names) });
    }
    let (values, rest) = numbers.as_chunks();
    if !rest.is_empty() {
        return Err(Error::invalid(name, format!("{} bytes are no whole numbers of 8", numbers.len())));
    }
    let values = values.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
    Ok(StudyColumn { name, unit, values: ColumnValues::Numbers(values) })
}
