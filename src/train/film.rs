//! A recording of an episode of a policy, as a file for `sandgait replay`, as a page and as a moving picture.

use crate::env::registry::Blueprint;
use crate::env::{EnvView, Shard};
use crate::error::{Error, Result};
use crate::policy::Network;
use crate::session::view::{header, row};
use crate::view::{self, RecordingWriter};
use std::path::{Path, PathBuf};

/// Width and height of the moving picture [px], its frames a second, and its longest duration [s]: our choice. It has a
/// few megabytes and is ready in some two seconds.
const SIZE: [u32; 2] = [480, 270];
const RATE: u16 = 15;
const LONGEST: f64 = 5.0;

/// The files of an episode.
pub struct Film {
    pub recording: PathBuf,
    pub page: PathBuf,
    pub picture: PathBuf,
}

impl Film {
    /// Names of the three files in a folder.
    pub fn of(folder: &Path) -> Self {
        let [recording, page, picture] = ["walk.rec", "walk.html", "walk.png"].map(|name| folder.join(name));
        Self { recording, page, picture }
    }

    /// Plays the episode of `seed` to its end and writes the files.
    pub fn shoot(&self, blueprint: &Blueprint, network: &Network, seed: u64) -> Result<()> {
        let broken = |e: std::io::Error| Error::unwritten(&self.recording, &e);
        let mut shard = Shard::new(blueprint, 1)?;
        shard.reset(|_| true, Some(&[seed]), |_| None);
        let look = shard.look(0, true);
        let mut out = RecordingWriter::new(Vec::new(), &header(look.spec, look.model, look.episode)).map_err(broken)?;
        let mut frames = Vec::new();
        let mut action = vec![0.0; shard.actions()];
        for step in 0..=blueprint.task.spec().max_episode_steps {
            if step > 0 {
                network.act(&shard.rows.observations, &mut action)?;
                shard.step(&action);
            }
            let look = shard.look(0, true);
            out.row(&row(&look)).map_err(broken)?;
            // The next frame is due.
            if look.time <= LONGEST && look.time * f64::from(RATE) > frames.len() as f64 - 1e-6 {
                frames.push(frame(&look)?);
            }
            if step > 0 && shard.rows.terminated[0] + shard.rows.truncated[0] > 0 {
                break;
            }
        }
        let bytes = out.finish().map_err(broken)?;
        let title = format!("{}, episode of seed {seed}", blueprint.task.spec().id);
        let page = view::page::replay(&bytes, &title).into_bytes();
        let picture = view::animation(&frames, SIZE, RATE)?;
        for (path, bytes) in [(&self.recording, bytes), (&self.page, page), (&self.picture, picture)] {
            std::fs::write(path, bytes).map_err(|e| Error::unwritten(path, &e))?;
        }
        Ok(())
    }
}

/// A frame of the moving picture, with time and place.
fn frame(look: &EnvView<'_>) -> Result<Vec<u8>> {
    // Rounded first, so that no place is written as −0.00.
    let x = (look.state.position[0] * 1e2).round() / 1e2 + 0.0;
    let caption = format!("{:5.2} s   x {x:5.2} m", look.time).replace('-', "−");
    let camera = view::CameraOptions::default();
    view::draw(look.model, &look.whole_state(), look.footing, SIZE, &camera, &[caption])
}
