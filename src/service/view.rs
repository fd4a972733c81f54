//! Requests for pictures and for the moments of recordings, as messages.

use super::building::TURN;
use super::proto::run_session_response::Response;
use super::proto::{Observation, Observe, Pictures, Render};
use super::work::SessionWork;
use crate::error::{Error, Result};
use crate::pool::Batch;
use crate::session::view;
use std::time::Instant;

/// Draws the pictures in turns with other work, until nobody waits for them any more.
pub async fn render(mut work: SessionWork, request: Render) {
    let (sessions, end) = (work.guard.sessions.clone(), work.end.clone());
    let Render { indices, width, height, ended, camera } = request;
    let camera = camera.map_or_else(view::CameraOptions::default, |c| view::CameraOptions {
        azimuth_deg: c.azimuth_deg,
        elevation_deg: c.elevation_deg,
        distance: c.distance,
        fixed: c.fixed,
    });
    let mut pixels = Vec::with_capacity(3 * indices.len() * width as usize * height as usize); // checked by `price`
    let mut left = indices.into_iter();
    while !left.as_slice().is_empty() {
        let turn = move || {
            let begun = Instant::now();
            let drawn = left.by_ref().try_for_each(|index| {
                pixels.extend(view::draw(work.batch(), index as usize, [width, height], ended, &camera)?);
                if begun.elapsed() < TURN { Ok(()) } else { Err(None) }
            });
            Ok((work, left, pixels, drawn))
        };
        // If nobody waits any more, the work is dropped, which returns the environments.
        let Some(Ok((back, rest, done, drawn))) = end.run_until_cancelled(sessions.turn(turn)).await else { return };
        (work, left, pixels) = (back, rest, done);
        if let Err(Some(error)) = drawn {
            let error: Error = error;
            return work.refuse(&error);
        }
    }
    work.finish(Response::Pictures(Pictures { pixels: pixels.into() }), false);
}

/// The present moment of one environment, as in a recording.
pub fn observe(batch: &Batch, request: &Observe) -> Result<Observation> {
    let (header, row) = view::observe(batch, request.index as usize, request.ended)?;
    Ok(Observation { header, row: row.into() })
}
