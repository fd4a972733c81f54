//! Saved environments in the middle of their episodes, from which a training continues bit-identically.

use super::collect::RolloutGroup;
use super::remote::{OptionalRemote, Pause};
use super::spec::TrainingSpec;
use crate::env::episode::Episode;
use crate::env::snapshot::SavedEpisode;
use crate::error::{Error, Result};
use parking_lot::Mutex;

/// All environments of a training, saved between two updates.
#[derive(Clone, Debug, PartialEq)]
pub struct SavedEnvironments {
    pub episodes: Episodes,
    /// Discounted sum of rewards of each environment.
    pub discounted: Vec<f64>,
    /// Sum of rewards of each environment's episode so far.
    pub returns: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Episodes {
    /// Episodes of environments in this process.
    Here(Vec<SavedEpisode>),
    /// A server's snapshot.
    OnServer(Vec<u8>),
}

impl Episodes {
    /// The bytes of the episodes' file: CBOR, or the server's snapshot unchanged.
    pub fn bytes(&self) -> Result<Vec<u8>> {
        match self {
            Self::Here(episodes) => {
                let written = SavedEpisode::all_to_cbor(episodes);
                written.map_err(|e| Error::invalid("checkpoint", format!("episodes cannot be written: {e}")))
            }
            Self::OnServer(snapshot) => Ok(snapshot.clone()),
        }
    }

    pub fn read(bytes: Vec<u8>, away: bool) -> Result<Self> {
        if away {
            return Ok(Self::OnServer(bytes));
        }
        let read = SavedEpisode::all_from_cbor(&bytes);
        read.map(Self::Here).map_err(|e| Error::invalid("checkpoint", format!("its episodes cannot be read: {e}")))
    }
}

impl SavedEnvironments {
    /// Saves the environments in `pieces`, or those of `remote`; None if they cannot be saved.
    pub fn of(pieces: &[Mutex<RolloutGroup>], remote: OptionalRemote<'_>, pause: Pause) -> Result<Option<Self>> {
        let mut kept = Self { episodes: Episodes::Here(Vec::new()), discounted: Vec::new(), returns: Vec::new() };
        let mut here = Vec::new();
        for piece in pieces {
            let piece = piece.lock();
            here.extend(piece.episodes());
            kept.discounted.extend(&piece.discounted);
            kept.returns.extend(&piece.running);
        }
        kept.episodes = match remote {
            Some(remote) => match remote.save(pause)? {
                Some(snapshot) => Episodes::OnServer(snapshot),
                None => return Ok(None),
            },
            None => Episodes::Here(here),
        };
        Ok(Some(kept))
    }

    /// Restores the environments in `pieces`.
    pub fn restore(
        &self,
        pieces: &mut [RolloutGroup],
        spec: &TrainingSpec,
        remote: OptionalRemote<'_>,
        pause: Pause,
    ) -> Result<()> {
        let envs: usize = pieces.iter().map(|p| p.envs).sum();
        let resumed = match (&self.episodes, remote) {
            (Episodes::Here(episodes), None) => {
                let task = &spec.task()?.task;
                let resumed = episodes.iter().map(|episode| Episode::resume(episode, task));
                resumed.collect::<Result<Vec<_>>>()?
            }
            (Episodes::OnServer(snapshot), Some(remote)) => {
                let rows = remote.restore(snapshot, pause)?;
                super::collect::deal(pieces.iter_mut(), &rows, |piece, part| piece.take(part));
                Vec::new()
            }
            _ => {
                return Err(Error::invalid(
                    "checkpoint",
                    "its environments were on a server and are now in this process, or the reverse",
                ));
            }
        };
        if self.discounted.len() != envs || self.returns.len() != envs || !(resumed.is_empty() || resumed.len() == envs)
        {
            return Err(Error::invalid("checkpoint", format!("its environments are not {envs}")));
        }
        let mut first = 0;
        for piece in pieces {
            let own = first..first + piece.envs;
            first = own.end;
            piece.discounted.copy_from_slice(&self.discounted[own.clone()]);
            piece.running.copy_from_slice(&self.returns[own.clone()]);
            piece.resume(resumed.get(own).unwrap_or(&[]));
        }
        Ok(())
    }
}
