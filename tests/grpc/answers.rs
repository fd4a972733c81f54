//! Reads the streams of studies.

use sandgait::service::proto::{DiagnoseResponse, Progress, TableResponse, diagnose_response, table_response};
use tonic::Streaming;

/// What a message has.
pub enum Event {
    Progress(Progress),
    Result,
}

/// A message of any study's stream.
pub trait Message {
    fn event(&self) -> Event;
}

macro_rules! message {
    ($response:ty, $module:ident) => {
        impl Message for $response {
            fn event(&self) -> Event {
                match &self.event {
                    Some($module::Event::Progress(p)) => Event::Progress(p.clone()),
                    _ => Event::Result,
                }
            }
        }
    };
}
message!(TableResponse, table_response);
message!(DiagnoseResponse, diagnose_response);

/// All progress messages of a study, and its last message.
pub async fn whole<T: Message>(mut stream: Streaming<T>) -> (Vec<Progress>, T) {
    let mut told = Vec::new();
    while let Some(message) = stream.message().await.unwrap() {
        match message.event() {
            Event::Progress(progress) => told.push(progress),
            Event::Result => {
                assert!(stream.message().await.unwrap().is_none(), "the result comes last");
                return (told, message);
            }
        }
    }
    panic!("the stream ended without a result");
}

/// The first message, which has to be progress.
pub async fn first_progress<T: Message>(stream: &mut Streaming<T>) -> Progress {
    match stream.message().await.unwrap().unwrap().event() {
        Event::Progress(progress) => progress,
        Event::Result => panic!("a result before any progress"),
    }
}
