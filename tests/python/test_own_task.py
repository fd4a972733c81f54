"""The example of a user's own task in Python: its numbers agree with the simulation."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sandgait

PATH = Path(__file__).parents[2] / "examples/own_task.py"


@pytest.fixture(name="own")
def example() -> Any:
    """The example as a module."""
    spec = importlib.util.spec_from_file_location("own_task", PATH)
    assert spec
    assert spec.loader
    module = sys.modules["own_task"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_rewards_are_computed_from_columns(own: Any) -> None:
    climb = own.Climb(5)
    plain = sandgait.SandgaitVectorEnv("sandgait/HexapodGait-v1", 5, slope_deg=10.0)
    seen, _ = climb.reset(seed=3)
    rows, _ = plain.reset(seed=3)
    assert climb.observation_space.contains(seen)
    for step in range(30):
        actions = np.full((5, 6), 0.1 * (step % 10), np.float32)
        seen, rewards, terminated, truncated, infos = climb.step(actions)
        rows, *_, told = plain.step(actions)
        np.testing.assert_array_equal(seen, rows[:, climb.seen])
        height = told["weight"] * told["x_velocity"] * 0.02 * np.sin(np.radians(10.0))
        np.testing.assert_allclose(infos["height_work"], height, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(rewards, height - own.WORK_PRICE * told["work"], rtol=1e-4, atol=1e-8)
        assert not terminated.any()
        assert not truncated.any()
    climb.close()
    plain.close()


def test_an_environment_that_tilts_too_far_is_reset(own: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own, "LARGEST_TILT", 0.05)
    climb = own.Climb(8)
    climb.reset(seed=0)
    fell, ended = np.zeros(8, np.bool_), np.zeros(8, np.bool_)
    for _ in range(60):
        seen, rewards, terminated, truncated, infos = climb.step(np.ones((8, 6), np.float32))
        assert not (terminated & truncated).any()
        if terminated.any():
            assert (rewards[terminated] < -0.9 * own.FALL_PRICE).all()
            assert (infos["_final_obs"] == terminated).all()
            # The first row of a new episode has no previous action; the last row of the old episode has one.
            assert (seen[terminated][:, -6:] == 0).all()
            assert (infos["final_obs"][terminated][:, -6:] == 1).all()
        fell |= terminated
        ended |= truncated
    assert fell.any()
    climb.close()
