"""Attributes that would not affect the simulation are refused; the error says how to set the value instead."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import pytest
from gymnasium.vector import SyncVectorEnv

import sandgait

ID = sandgait.TASKS[0]

#: Attribute, value, and words of the error message.
REFUSED = [
    ("slope_deg", 8, r"slope_deg: .*reset\(options=\{'slope_deg': 8\}\)"),
    ("engine", "rapier", r"engine: fixed when the environment is made.*gymnasium\.make.*engine='rapier'"),
    ("clip_actions", True, r"clip_actions: fixed when the environment is made"),
    ("stage", 2, r"stage: the simulation has no option of this name; reset\(options=\.\.\.\) takes .*slope_deg"),
]


def setters() -> dict[str, Callable[[str, Any], object]]:
    vec = sandgait.make_sb3(ID, 2)
    many = gymnasium.make_vec(ID, num_envs=2).unwrapped
    one = gymnasium.make(ID)
    raw = sandgait.SandgaitEnv(ID)
    sync = SyncVectorEnv([lambda: gymnasium.make(ID)] * 2)
    return {
        "make_sb3": vec.set_attr,
        "make_sb3, one": lambda name, value: vec.set_attr(name, value, indices=0),
        "make_sb3, by its method": lambda name, value: vec.env_method("set_wrapper_attr", name, value),
        "make_vec": many.set_attr,
        "make": one.set_wrapper_attr,
        "the environment itself": raw.set_wrapper_attr,
        "SyncVectorEnv": sync.set_attr,
    }


@pytest.mark.parametrize(("name", "value", "says"), REFUSED)
def test_attributes_without_effect_are_refused(name: str, value: Any, says: str) -> None:
    for how, set_attribute in setters().items():
        with pytest.raises(sandgait.UnknownAttribute, match=says):
            set_attribute(name, value)
        assert how


def test_options_are_not_attributes() -> None:
    """An environment on level sand has no attribute for the slope."""
    vec, many, one = sandgait.make_sb3(ID, 2), gymnasium.make_vec(ID, num_envs=2).unwrapped, sandgait.SandgaitEnv(ID)
    assert not vec.has_attr("slope_deg")
    with pytest.raises(AttributeError):
        vec.get_attr("slope_deg")
    with pytest.raises(sandgait.UnknownAttribute, match="slope_deg: no attribute"):
        many.get_attr("slope_deg")
    assert not one.has_wrapper_attr("slope_deg")
    for env in (one, many):
        with pytest.raises(sandgait.UnknownAttribute, match=r"reset\(options="):
            env.slope_deg = 8
        assert not hasattr(env, "slope_deg")
    assert many.get_attr("task") == (many.task, many.task)


def test_methods_of_the_whole_batch_are_not_called_for_one() -> None:
    vec = sandgait.make_sb3(ID, 2)
    vec.reset()
    for name in ("save", "close", "step"):
        with pytest.raises(sandgait.UnknownAttribute, match=rf"{name}: .*vec_env\.unwrapped\.envs\.{name}\("):
            vec.env_method(name, indices=0)
    assert vec.unwrapped.envs.save()
    vec.close()


def test_users_can_add_their_own_attributes() -> None:
    class Mine(sandgait.SandgaitEnv):
        stage = 1

    env = Mine(ID)
    env.set_wrapper_attr("stage", 2)
    assert env.stage == 2
    env.label = "a"
    env.set_wrapper_attr("label", "b")
    assert env.label == "b"
    with pytest.raises(sandgait.UnknownAttribute, match="render_mode: fixed"):
        env.set_wrapper_attr("render_mode", "human")
    env.close()
