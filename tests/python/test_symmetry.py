"""Mirrored policies are symmetric in left and right, on every task for which one is trained."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

import sandgait

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples"))

from symmetry import MirroredNetworks, Reflection  # noqa: E402

SETTINGS = yaml.safe_load((ROOT / "examples/hyperparameters/ppo.yml").read_text())


MIRRORED = [task for task, entry in SETTINGS.items() if entry.get("mirror")]


@pytest.mark.parametrize("name", [*MIRRORED, "sandgait/LeggedVelocity-v1"])
def test_mirrored_observations_give_mirrored_actions(name: str) -> None:
    observation, action = sandgait.mirror(name)
    rows = torch.tensor(np.random.default_rng(0).normal(size=(32, len(observation[0]))), dtype=torch.float32)
    seen, done = Reflection(observation), Reflection(action)
    assert torch.equal(seen(seen(rows)), rows)
    assert not torch.equal(seen(rows), rows)
    networks = MirroredNetworks([16, 16], observation, action)
    torch.testing.assert_close(networks.forward_actor(seen(rows)), done(networks.forward_actor(rows)))
    torch.testing.assert_close(networks.forward_critic(seen(rows)), networks.forward_critic(rows))
    assert networks.forward_actor(rows).abs().max() > 0.0


def test_heights_and_legs_change_sides() -> None:
    """A mirrored value moves to the column on the other side. Legs of a robot from a file are found by their places."""
    names = {"sandgait/HexapodTerrain-v1": [("left-", "right-")], "sandgait/LeggedVelocity-v1": [("FL_", "FR_")]}
    for name, sides in names.items():
        env = sandgait.SandgaitVectorEnv(name, 1)
        columns = [c.name for c in env.task.action]
        env.close()
        order, signs = sandgait.mirror(name)[1]
        for left, right in sides:
            for column, image in zip(columns, (columns[k] for k in order), strict=True):
                if left in column:
                    assert image == column.replace(left, right)
        assert set(signs) <= {1.0, -1.0}
