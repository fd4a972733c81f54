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

from symmetry import MirroredNetworks, Reflection, mirror  # noqa: E402

SETTINGS = yaml.safe_load((ROOT / "examples/hyperparameters/ppo.yml").read_text())


@pytest.mark.parametrize("name", [task for task, entry in SETTINGS.items() if entry.get("mirror")])
def test_mirrored_observations_give_mirrored_actions(name: str) -> None:
    env = sandgait.SandgaitVectorEnv(name, 1)
    observation, action = (mirror([c.name for c in columns]) for columns in (env.task.observation, env.task.action))
    env.close()
    rows = torch.tensor(np.random.default_rng(0).normal(size=(32, len(observation[0]))), dtype=torch.float32)
    seen, done = Reflection(observation), Reflection(action)
    assert torch.equal(seen(seen(rows)), rows)
    assert not torch.equal(seen(rows), rows)
    networks = MirroredNetworks([16, 16], observation, action)
    torch.testing.assert_close(networks.forward_actor(seen(rows)), done(networks.forward_actor(rows)))
    torch.testing.assert_close(networks.forward_critic(seen(rows)), networks.forward_critic(rows))
    assert networks.forward_actor(rows).abs().max() > 0.0


def test_heights_and_legs_change_sides() -> None:
    names = ["hip speed, right-rear", "hip speed, left-rear", "what lies 5 cm ahead and -5 cm to the left"]
    names += ["what lies 5 cm ahead and 5 cm to the left", "base velocity, body frame, y"]
    names += ["commanded speed", "commanded yaw speed"]
    assert mirror(names) == ([1, 0, 3, 2, 4, 5, 6], [1.0, 1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
