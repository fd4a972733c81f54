"""Results of a reset, step or rollout, as arrays over all environments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt


class Batch(NamedTuple):
    """All environments after a reset or step. The arrays belong to this batch alone, so the caller may change them."""

    #: f32 [num_envs, observation]; if an episode ended, the first observation of the next episode.
    observations: npt.NDArray[np.float32]
    #: f32 [num_envs]
    rewards: npt.NDArray[np.float32]
    #: [num_envs]
    terminated: npt.NDArray[np.bool_]
    #: [num_envs]
    truncated: npt.NDArray[np.bool_]
    #: f32 [info, num_envs]; each info column is a contiguous row
    infos: npt.NDArray[np.float32]
    #: [k]: environments whose episode ended, in ascending order
    final_indices: npt.NDArray[np.intp]
    #: f32 [k, observation]: the last observations of these episodes
    final_observations: npt.NDArray[np.float32]


class Rollout(NamedTuple):
    """Results of a rollout. The rollout of an environment ends early if its episode ends."""

    #: f64 [num_envs]: sum of rewards until the rollout or the episode ended.
    returns: npt.NDArray[np.float64]
    #: [num_envs]: number of steps until the rollout or the episode ended.
    lengths: npt.NDArray[np.intp]
    #: [num_envs]: was the episode terminated, and was it truncated?
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    #: f32 [steps, num_envs, observation] after each step. Zero after an environment's rollout has ended. Empty without
    #: `trajectories`.
    observations: npt.NDArray[np.float32]
    #: f32 [steps, num_envs]; zero and empty in the same cases as `observations`.
    rewards: npt.NDArray[np.float32]
    #: f32 [steps, num_envs, action]: the policy's actions; zero and empty in the same cases as `observations`, and also
    #: empty if the caller gave the actions.
    actions: npt.NDArray[np.float32]
