"""The same steps through every door (in this process, in a separate process, over the network) give equal bits."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sandgait
from conftest import ID, RemoteServer

DATA = Path(__file__).parents[1] / "data"
LEGS = "sandgait/HexapodLegs-v1"


@pytest.fixture(params=["isolated", "tcp", "unix", "two of this process", "two servers"])
def door(request: pytest.FixtureRequest, tmp_path: Path, remote: RemoteServer) -> Any:
    """Keywords that choose another door than the one in this process."""
    if request.param == "unix":
        with RemoteServer(f"unix:{tmp_path}/socket") as local:
            yield {"address": local.address}
        return
    yield {
        "isolated": {"isolated": True},
        "tcp": {"address": remote.address},
        "two of this process": {"address": [None, None]},
        "two servers": {"address": [remote.address, remote.address]},
    }[request.param]


def actions(n: int, width: int, time: int) -> np.ndarray:
    i, j = np.meshgrid(np.arange(n), np.arange(width), indexing="ij")
    return np.sin((i * 7 + j * 3 + time) * 0.37).astype(np.float32)


def refused(call: Callable[[], object]) -> str:
    with pytest.raises(sandgait.SandgaitError) as error:
        call()
    return f"{type(error.value).__name__}: {error.value}"


def vector(keywords: dict[str, Any]) -> list[Any]:
    """All results of a vector environment's functions."""
    options: dict[str, Any] = {"max_episode_steps": 9, "command": np.array([0.1, 0.3]), "turn": (0.0, 0.1)}
    env = sandgait.SandgaitVectorEnv(ID, 19, autoreset_mode="SAME_STEP", **options, **keywords)
    said: list[Any] = [env.task, refused(lambda: env.step(np.zeros((19, 6)))), env.reset(seed=4)[0]]

    def walk(steps: range) -> None:
        for t in steps:
            said.extend(env.send(actions(19, 6, t)) or env.recv_batch())

    walk(range(12))
    wrong = actions(19, 6, 0)
    wrong[3, 2] = 7.0
    said.append(refused(lambda: env.step(wrong)))
    mask = np.arange(19) % 3 == 0
    said.append(env.reset(options={"reset_mask": mask, "slope_deg": 5.0, "leg": "revC"})[0])
    said.append(refused(lambda: env.reset(options={"slope_deg": "steep"})))
    said.append(env.set_command((0.2, 0.0, 0.1)))
    said.append(env.set_command(np.linspace([0.0, 0.0, -0.1], [0.4, 0.0, 0.1], 19)))
    said.append(refused(lambda: env.set_command((0.2, 0.1, 0.0))))
    said.append(refused(lambda: env.set_command((float("nan"), 0.0, 0.0))))
    kept = env.save()
    walk(range(5))
    said.append(env.restore(kept))
    walk(range(5))
    said.append(env.restore(kept, np.arange(19)[::-1].copy()) if len(env._session.addresses) == 1 else None)
    said.append(env.restore(kept))
    said.extend(env.rollout(np.stack([actions(19, 6, t) for t in range(14)]), trajectories=True))
    said.extend(env.rollout(np.stack([actions(19, 6, t) for t in range(3)])))
    said.extend(env.rollout_policy(DATA / "policy_ppo.onnx", 7, trajectories=True))
    said.append(refused(lambda: env.rollout_policy(b"no network", 3)))
    said.append(env._session.render([0, 18], (64, 48), False, (None, None, None, True)))
    said.extend(env._session.observe(11, False))
    fork = env.fork(3, 7) if len(env._session.addresses) == 1 else None
    said.append(None if fork is None else fork.step(actions(3, 6, 1))[0])
    env.close()
    said.append(refused(lambda: env.step(np.zeros((19, 6)))))
    return said


def single(keywords: dict[str, Any]) -> list[Any]:
    """All results of single environments: in NEXT_STEP, after pickling, and with other options."""
    said: list[Any] = []
    env = sandgait.SandgaitEnv(LEGS, max_episode_steps=5, medium="poppy-close", **keywords)
    said.append(env.reset(seed=3)[0])
    for t in range(5):
        said.extend(env.step(actions(1, 18, t)[0]))
        said.append(
            env.set_command((0.1 * t, 0.0, 0.0)) if t < 4 else refused(lambda: env.set_command((0.1, 0.0, 0.0)))
        )
    said.append(env.reset()[0])
    said.extend(pickle.loads(pickle.dumps(env)).step(actions(1, 18, 7)[0]))
    env.close()
    many = sandgait.SandgaitVectorEnv(ID, 3, max_episode_steps=4, **keywords)
    said.append(many.reset(seed=1)[0])
    for t in range(10):
        rows = many.step(actions(3, 6, t))
        said.extend([*rows[:4], *rows[4].values()])
    many.close()
    return said


def test_a_vector_environment_is_the_same_through_every_door(door: dict[str, Any]) -> None:
    same(vector({}), vector(door))


def test_a_single_environment_is_the_same_through_every_door(door: dict[str, Any]) -> None:
    if not isinstance(door.get("address"), list):
        same(single({}), single(door))


def same(ours: list[Any], theirs: list[Any]) -> None:
    assert len(ours) == len(theirs)
    for k, (a, b) in enumerate(zip(ours, theirs, strict=True)):
        if b is None:  # not asked for where there are two places
            continue
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype, k
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), k
        else:
            assert a == b, k


def test_tasks_and_studies_are_the_same(remote: RemoteServer) -> None:
    assert sandgait.describe() == sandgait.describe(remote.address)

    def tables(address: str | None) -> list[sandgait.Table]:
        return [
            sandgait.intrude("revC", medium="zeta=0.4", address=address),
            sandgait.intrude(
                body="cylinder:radius=0.0625,width=0.06",
                rows={"vx": 0.01, "wy": [0.1, 0.2], "load": 20},
                address=address,
            ),
            sandgait.walk([2.0, -1.0], leg="C", slope_deg=3.0, address=address),
            sandgait.sweep({"leg": ["L", "C"], "frequency": [1, 2]}, set={"leg_mass": 0.003}, address=address),
            sandgait.sweep({"xi": [0, 60]}, optimize="speed", address=address),
            sandgait.evaluate("tripod:2", seeds=3, slopes=[0, 5], leg="C", address=address),
        ]

    for ours, theirs in zip(tables(None), tables(remote.address), strict=True):
        assert ours.units == theirs.units
        same(list(ours.values()), list(theirs.values()))
    wrong: list[Callable[[str | None], object]] = [
        lambda address: sandgait.intrude("Q", address=address),
        lambda address: sandgait.intrude(body="sphere:radius=0.1", rows={"depth": 99}, address=address),
        lambda address: sandgait.walk(2, engine="horse", address=address),
        lambda address: sandgait.walk(2, slope_deg=90.0, address=address),
        lambda address: sandgait.sweep({"nothing": [1, 2]}, address=address),
        lambda address: sandgait.evaluate("gallop", address=address),
        lambda address: sandgait.diagnose(DATA / "penetration.csv", {"kind": "none"}, address=address),
    ]
    for call in wrong:
        assert refused(lambda call=call: call(None)) == refused(lambda call=call: call(remote.address))  # type: ignore[misc]
