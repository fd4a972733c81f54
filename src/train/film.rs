//! A recording of an episode of a policy, for `sandgait replay`, and a picture of some of its moments.

use crate::env::Shard;
use crate::env::registry::Blueprint;
use crate::error::{Error, Result};
use crate::policy::Network;
use crate::session::view::{header, row};
use crate::view::{self, RecordingWriter};
use std::path::Path;

/// Number of moments in the picture, and width and height of each moment [px]: our choice. They stand below each other,
/// 1080 px high in all, as high as a usual screen.
const MOMENTS: usize = 4;
const SIZE: [u32; 2] = [480, 270];

/// Plays the episode of `seed` to its end; writes `recording` and, as PNG, `picture`.
pub fn film(blueprint: &Blueprint, network: &Network, seed: u64, recording: &Path, picture: &Path) -> Result<()> {
    let broken = |e: std::io::Error| Error::unwritten(recording, &e);
    let mut shard = Shard::new(blueprint, 1)?;
    shard.reset(|_| true, Some(&[seed]), |_| None);
    let look = shard.look(0, true);
    let mut out = RecordingWriter::new(Vec::new(), &header(look.spec, look.model, look.episode)).map_err(broken)?;
    out.row(&row(&look)).map_err(broken)?;
    let mut action = vec![0.0; shard.actions()];
    let longest = blueprint.task.spec().max_episode_steps as usize;
    let mut pixels = Vec::new();
    for step in 1..=longest {
        network.act(&shard.rows.observations, &mut action)?;
        shard.step(&action);
        let look = shard.look(0, true);
        out.row(&row(&look)).map_err(broken)?;
        // The longest episode has [`MOMENTS`] equal parts, and this step is in the middle of one of them.
        if (0..MOMENTS).any(|k| step == (2 * k + 1) * longest / (2 * MOMENTS)) {
            // Rounded first, so that no place is written as −0.000.
            let x = (look.state.position[0] * 1e3).round() / 1e3 + 0.0;
            let caption = format!("{:6.2} s   x {x:6.3} m", look.time).replace('-', "−");
            pixels.extend(view::draw(
                look.model,
                &look.whole_state(),
                look.footing,
                SIZE,
                &view::CameraOptions::default(),
                &[caption],
            )?);
        }
        if shard.rows.terminated[0] + shard.rows.truncated[0] > 0 {
            break;
        }
    }
    std::fs::write(recording, out.finish().map_err(broken)?).map_err(broken)?;
    let height = (pixels.len() / 3 / SIZE[0] as usize) as u32;
    if height > 0 {
        let image = view::png(&pixels, [SIZE[0], height])?;
        std::fs::write(picture, image).map_err(|e| Error::unwritten(picture, &e))?;
    }
    Ok(())
}
