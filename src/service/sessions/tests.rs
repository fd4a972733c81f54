//! Several streams that use the same session.

use super::*;
use crate::env::registry::TASK_IDS;
use std::future::poll_fn;
use std::pin::pin;
use std::task::Poll;

/// The second stream gets the first notification that the environments are back, but has lost the session by then. The
/// third stream also waits, and must get the environments. The second stream handles the notification in one of two
/// ways at random, so the test runs several rounds.
#[tokio::test]
async fn environments_come_back_to_the_third_stream_though_a_second_waited() {
    let sessions = Sessions::new(Limits::default(), crate::pool::Seal::default(), CancellationToken::new());
    let (id, _) = sessions.create(TASK_IDS[0].into(), 1, Value::Null).await.unwrap();
    for round in 0..32 {
        let first = sessions.attach(&id).unwrap();
        let environments = sessions.take(&first).await.unwrap();
        let second = sessions.attach(&id).unwrap();
        let waiting = tokio::spawn({
            let sessions = sessions.clone();
            async move { sessions.take(&second).await.is_none() }
        });
        tokio::task::yield_now().await;
        let third = sessions.attach(&id).unwrap();
        let mut last = pin!(sessions.take(&third));
        // The third stream waits, and the second has not run since it lost the session.
        let waits = poll_fn(|cx| Poll::Ready(last.as_mut().poll(cx).is_pending())).await;
        assert!(waits && !waiting.is_finished());
        drop(environments);
        assert!(waiting.await.unwrap(), "the second has lost the session");
        let taken = poll_fn(|cx| Poll::Ready(last.as_mut().poll(cx))).await;
        let Poll::Ready(Some(environments)) = taken else { panic!("round {round}: nobody told the third") };
        drop(environments);
    }
}
