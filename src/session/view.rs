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
    let figure = |name: &str| look.spec.info.iter().position(|c| c.name == name).map(|k| f64::from(look.info[k]));
    let commanded = figure("commanded_speed").or_else(|| figure("command_lin_vel_x"));
    vec![caption(look.time, figure("speed"), commanded, look.model.scene.slope_deg)]
}

/// Time, speed and commanded speed, if the task has them, and the slope, if there is one.
fn caption(time: f64, speed: Option<f64>, commanded: Option<f64>, slope_deg: f64) -> String {
    let mut text = format!("{time:6.2} s");
    if let Some(speed) = speed {
        text += &format!("   {:6.3} m/s", rounded(speed, 3));
    }
    if let Some(commanded) = commanded {
        text += &format!(" (commanded {:.3})", rounded(commanded, 3));
    }
    if rounded(slope_deg, 1) != 0.0 {
        text += &format!("   slope {:.1}°", slope_deg);
    }
    text.replace('-', "−")
}

/// `value` rounded to `digits`, so that a small negative number is written without a minus sign.
fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10.0_f64.powi(digits);
    (value * scale).round() / scale + 0.0
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn captions_have_rounded_numbers_that_the_task_has() {
        let text = caption(1.5, Some(-0.0001), Some(0.3), -1.351_941_55);
        assert_eq!(text, "  1.50 s    0.000 m/s (commanded 0.300)   slope −1.4°");
        assert_eq!(caption(0.0, Some(-0.25), None, 0.01), "  0.00 s   −0.250 m/s");
        assert_eq!(caption(0.0, None, None, 0.0), "  0.00 s");
    }
}
