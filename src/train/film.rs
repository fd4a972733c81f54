//! A recording of an episode of a policy, for `sandgait replay`, and a picture of some of its moments.

use crate::env::registry::Blueprint;
use crate::env::{EnvView, Shard};
use crate::error::{Error, Result};
use crate::plot::png;
use crate::policy::Network;
use crate::view::{self, About, Moment, Writer};
use std::path::Path;

/// Number of moments in the picture, and width and height of each [px].
const MOMENTS: usize = 4;
const SIZE: [u32; 2] = [480, 270];

/// Plays the episode of `seed` to its end; writes `recording` and, as PNG, `picture`.
pub fn film(blueprint: &Blueprint, network: &Network, seed: u64, recording: &Path, picture: &Path) -> Result<()> {
    let broken = |e: std::io::Error| Error::file(recording, e);
    let mut shard = Shard::new(blueprint, 1)?;
    shard.reset(|_| true, Some(&[seed]), |_| None);
    let mut out = Writer::new(Vec::new(), &header(&shard.look(0, true))).map_err(broken)?;
    out.row(&row(&shard.look(0, true))).map_err(broken)?;
    let mut action = vec![0.0; shard.actions()];
    let longest = blueprint.task.spec().max_episode_steps as usize;
    let mut pixels = Vec::new();
    for step in 1..=longest {
        network.act(&shard.rows.observations, &mut action)?;
        shard.step(&action);
        let look = shard.look(0, true);
        out.row(&row(&look)).map_err(broken)?;
        // In the middle of each part of the longest episode.
        if (0..MOMENTS).any(|k| step == (2 * k + 1) * longest / (2 * MOMENTS)) {
            let caption = format!("{:6.2} s   x {:6.3} m", look.time, look.state.position[0]).replace('-', "−");
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
        let image = png::pixels(&pixels, [SIZE[0], height])?;
        std::fs::write(picture, image).map_err(|e| Error::file(picture, e))?;
    }
    Ok(())
}

fn header(look: &EnvView) -> String {
    let spec = look.spec;
    let about = About {
        task: spec.id,
        rate: spec.control_rate,
        episode: Some(look.episode),
        info: spec.info.iter().map(|c| (c.name.as_str(), c.unit)).collect(),
        reward_terms: spec.reward.len(),
        actions: spec.action.len(),
    };
    view::header(look.model, &about)
}

fn row(look: &EnvView) -> Vec<f32> {
    let EnvView { model, footing, time, action, reward, info, .. } = look;
    view::row(model, &Moment { time: *time, state: &look.whole_state(), footing, action, reward: *reward, info })
}
