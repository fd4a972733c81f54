//! `sandgait robots`

use sandgait::robots::Reading;
use sandgait::robots::named::{NamedRobot, folders, names};
use sandgait::{Error, Result, view};
use serde_json::json;
use std::path::PathBuf;

/// Width and height of pictures [px]: our choice, half of those of `sandgait robot`, because there are many pictures.
const PICTURE: [u32; 2] = [480, 360];

/// List the robots that have a name: option `robot` and `sandgait robot` take these names.
///
/// Their descriptions are not ours: they come from packages (pip install 'sandgait[robots]'), or from a file of yours
/// (NAME=FILE). The names stand for a pose, gains, and what touches sand; --json prints the source of each.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  sandgait robots
  sandgait robots --json
  sandgait robots --pictures robots/")]
pub struct RobotsArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Draw each robot whose description is installed into this folder, which must exist
    #[arg(long, value_name = "FOLDER")]
    pictures: Option<PathBuf>,
}

impl RobotsArgs {
    pub fn run(self) -> Result<String> {
        let folders = folders();
        if let Some(folder) = self.pictures.as_ref().filter(|folder| !folder.is_dir()) {
            return Err(Error::file(folder, "is no folder"));
        }
        let mut all = Vec::new();
        for name in names() {
            let Some(named) = NamedRobot::of(name) else { continue };
            let named = named?;
            let file = named.description(&folders);
            if let (Some(folder), Some(file)) = (&self.pictures, &file) {
                let (import, camera) = (named.load(file, &Reading::default())?, view::CameraOptions::default());
                let (tree, seen) = (&import.tree, import.seen()?);
                let caption = format!("{name}: {:.1} kg, {} joints", tree.mass(), tree.joints().count());
                let png = view::tree::draw(tree, &seen, &[], None, PICTURE, &camera, &[caption])?;
                let path = folder.join(format!("{name}.png"));
                std::fs::write(&path, png).map_err(|e| Error::unwritten(&path, &e))?;
            }
            all.push((name, named, file));
        }
        if self.json {
            let row = |(name, named, file): &(&str, NamedRobot, Option<PathBuf>)| {
                json!({
                    "name": name,
                    "title": named.title,
                    "description": file,
                    "source": named.source,
                    "licence": named.licence,
                })
            };
            return Ok(super::json(&all.iter().map(row).collect::<Vec<_>>().into()));
        }
        let mut rows = vec![["name", "robot", "description"].map(String::from).to_vec()];
        for (name, named, file) in &all {
            let at = match file {
                _ if *name == "sandcat" => "built in",
                Some(_) => "installed",
                None => "not installed",
            };
            rows.push(vec![(*name).into(), named.title.clone(), at.into()]);
        }
        Ok(super::table(&rows))
    }
}
