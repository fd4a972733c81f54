"""Results of environments, as arrays over all of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt


class Batch(NamedTuple):
    """All environments after a reset or step; arrays are this batch's own and may be written to."""

    #: f32 [num_envs, observation]; where an episode ended, already the first of the next one.
    observations: npt.NDArray[np.float32]
    #: f32 [num_envs]
    rewards: npt.NDArray[np.float32]
    #: [num_envs]
    terminated: npt.NDArray[np.bool_]
    #: [num_envs]
    truncated: npt.NDArray[np.bool_]
    #: f32 [info, num_envs], one contiguous row a column of the table
    infos: npt.NDArray[np.float32]
    #: [k] environments whose episode ended, ascending
    final_indices: npt.NDArray[np.intp]
    #: f32 [k, observation]
    final_observations: npt.NDArray[np.float32]


class Rollout(NamedTuple):
    """Results of a rollout; an environment's rollout ends with its episode."""

    #: f64 [num_envs]: sum of rewards until the rollout or the episode ended.
    returns: npt.NDArray[np.float64]
    #: [num_envs]: steps until then.
    lengths: npt.NDArray[np.intp]
    #: [num_envs]: how the episode ended, if it did.
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    #: f32 [steps, num_envs, observation] after each step, zero where a rollout had ended; empty unless asked for.
    observations: npt.NDArray[np.float32]
    #: f32 [steps, num_envs], as above.
    rewards: npt.NDArray[np.float32]
    #: f32 [steps, num_envs, action], as above: a policy's choices; empty for given actions.
    actions: npt.NDArray[np.float32]
