//! Requests of studies, and their streams.

use sandgait::service::proto::{Progress, StudyInput, StudyRequest, StudyResponse, StudyResult};
use sandgait::service::proto::{study_input, study_response};
use tonic::Streaming;

/// A study with its arguments as words, without files.
pub fn request(name: &str, words: &[&str]) -> StudyRequest {
    let arguments = words.iter().map(|word| (*word).to_owned()).collect();
    StudyRequest { name: name.into(), arguments, files: Vec::new() }
}

/// The same with a file.
pub fn with_file(mut request: StudyRequest, name: &str, content: impl Into<Vec<u8>>) -> StudyRequest {
    let form = Some(study_input::Form::Content(content.into().into()));
    request.files.push(StudyInput { name: name.into(), form });
    request
}

/// All progress messages of a study, and its result.
pub async fn whole(mut stream: Streaming<StudyResponse>) -> (Vec<Progress>, StudyResult) {
    let mut told = Vec::new();
    while let Some(message) = stream.message().await.unwrap() {
        match message.event.unwrap() {
            study_response::Event::Progress(progress) => told.push(progress),
            study_response::Event::Result(result) => {
                assert!(stream.message().await.unwrap().is_none(), "the result comes last");
                return (told, result);
            }
        }
    }
    panic!("the stream ended without a result");
}

/// The first message, which has to be progress.
pub async fn first_progress(stream: &mut Streaming<StudyResponse>) -> Progress {
    match stream.message().await.unwrap().unwrap().event.unwrap() {
        study_response::Event::Progress(progress) => progress,
        study_response::Event::Result(_) => panic!("a result before any progress"),
    }
}
