//! Requests for pictures and moments, as messages.

use super::proto::{Observation, Observe, Pictures, Render};
use crate::error::Result;
use crate::pool::Batch;
use crate::session::view;

/// Memory of the answer to `request` [bytes]: its pixels, and a second copy in the message.
pub fn size(request: &Render) -> usize {
    let pixels = view::pixels(request.indices.len(), [request.width, request.height]);
    2 * 3 * pixels.min(view::MOST_PIXELS) as usize
}

/// Pictures of environments.
pub fn render(batch: &Batch, request: &Render) -> Result<Pictures> {
    let Render { indices, width, height, ended, camera } = request;
    let camera = camera.as_ref().map_or_else(view::CameraOptions::default, |c| view::CameraOptions {
        azimuth_deg: c.azimuth_deg,
        elevation_deg: c.elevation_deg,
        distance: c.distance,
        fixed: c.fixed,
    });
    let pixels = view::render(batch, indices, [*width, *height], *ended, &camera)?;
    Ok(Pictures { pixels: pixels.into() })
}

/// One environment's moment.
pub fn observe(batch: &Batch, request: &Observe) -> Result<Observation> {
    let (header, row) = view::observe(batch, request.index as usize, request.ended)?;
    Ok(Observation { header, row: row.into() })
}
