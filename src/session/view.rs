//! Operations for viewers: pictures, and moments in the format of recordings.

use crate::env::{EnvView, Spec};
use crate::error::{Error, Result};
use crate::pool::Batch;
use crate::sim::Model;
pub use sandgait_view::CameraOptions;
use sandgait_view::{self as view, About, RecordedState};

/// Largest number of pixels of all pictures of one request together: our choice, 100 MB.
pub const MOST_PIXELS: u64 = 1 << 25;

/// Number of pixels of `count` pictures, each of `size` (width and height).
///
/// # Errors
/// The pixels are more than one request may have.
pub fn check_pixels(count: usize, size: [u32; 2]) -> Result<usize> {
    let [width, height] = size;
    let pixels = (count as u64).saturating_mul(u64::from(width) * u64::from(height));
    if pixels > MOST_PIXELS {
        let reason = format!("{count} pictures of {width} × {height} have more than {MOST_PIXELS} pixels");
        return Err(Error::invalid("indices", reason));
    }
    Ok(pixels as usize)
}

/// Pictures of environments, u8 [indices, height, width, 3]. `ended`: see [`Batch::look`].
pub fn render(batch: &Batch, indices: &[u32], size: [u32; 2], ended: bool, camera: &CameraOptions) -> Result<Vec<u8>> {
    let mut all = Vec::with_capacity(3 * check_pixels(indices.len(), size)?);
    for index in indices {
        all.extend(draw(batch, *index as usize, size, ended, camera)?);
    }
    Ok(all)
}

/// One picture, u8 [height, width, 3].
pub fn draw(batch: &Batch, index: usize, size: [u32; 2], ended: bool, camera: &CameraOptions) -> Result<Vec<u8>> {
    let look = batch.look(index, ended)?;
    view::draw(look.model, &look.whole_state(), look.footing, size, camera, &captions(&look))
}

/// The caption of a picture.
fn captions(look: &EnvView) -> Vec<String> {
    let figure = |name: &str| look.spec.info.iter().position(|c| c.name == name).map(|k| look.info[k]);
    let speed = figure("speed").unwrap_or(0.0);
    let mut first = format!("{:6.2} s   {speed:6.3} m/s (commanded {:.3})", look.time, look.task_state.speed);
    if look.model.scene.slope_deg != 0.0 {
        first += &format!("   slope {}°", look.model.scene.slope_deg);
    }
    vec![first.replace('-', "−")]
}

/// One environment's moment: the header of its section in a recording, and its numbers, f32 little-endian.
pub fn observe(batch: &Batch, index: usize, ended: bool) -> Result<(String, Vec<u8>)> {
    let look = batch.look(index, ended)?;
    let row = row(&look).iter().flat_map(|x| x.to_le_bytes()).collect();
    Ok((header(look.spec, look.model, look.episode), row))
}

/// The header of the section that moments of this episode belong to.
pub fn header(spec: &Spec, model: &Model, episode: (u64, u64)) -> String {
    let about = About {
        task: spec.id,
        rate: spec.control_rate,
        episode: Some(episode),
        info: spec.info.iter().map(|c| (c.name.as_str(), c.unit)).collect(),
        reward_terms: spec.reward.len(),
        actions: spec.action.len(),
    };
    view::header(model, &about)
}

/// The numbers of a moment, in the order of the header's columns.
pub fn row(look: &EnvView) -> Vec<f32> {
    let EnvView { model, footing, time, action, reward, info, .. } = look;
    view::row(model, &RecordedState { time: *time, state: &look.whole_state(), footing, action, reward: *reward, info })
}
