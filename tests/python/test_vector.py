"""`gymnasium.make_vec` against gymnasium's own SyncVectorEnv in SAME_STEP mode, value by value."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

import sandgait
from conftest import ID, RemoteServer


def make(num_envs: int, **options: Any) -> sandgait.SandgaitVectorEnv:
    options = {"autoreset_mode": "SAME_STEP", **options}
    env = gymnasium.make_vec(ID, num_envs=num_envs, vectorization_mode="vector_entry_point", **options)
    assert isinstance(env, sandgait.SandgaitVectorEnv)
    return env


def synchronous(num_envs: int, mode: AutoresetMode = AutoresetMode.SAME_STEP, **options: Any) -> SyncVectorEnv:
    def one() -> sandgait.SandgaitEnv:
        return sandgait.SandgaitEnv(ID, **options)

    return SyncVectorEnv([one] * num_envs, autoreset_mode=mode)


def assert_same(ours: Any, theirs: Any) -> None:
    """Equal arrays; `final_obs` is an array of rows and None."""
    if theirs.dtype == object:
        assert [row is None for row in ours] == [row is None for row in theirs]
        assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True) if b is not None)
    else:
        assert ours.shape == theirs.shape
        assert np.array_equal(ours, theirs)


def assert_same_infos(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    """Equal masks, and equal values where they are set; a key that gymnasium leaves out has an empty mask here."""
    assert set(theirs) <= set(ours)
    for key in (key for key in ours if not key.startswith("_")):
        mask = theirs.get(f"_{key}", np.zeros(len(ours[f"_{key}"]), bool))
        assert np.array_equal(ours[f"_{key}"], mask)
        if key == "final_info" and key in theirs:
            assert_same_infos(ours[key], theirs[key])
        elif key in theirs:
            assert_same(ours[key][mask], theirs[key][mask])


def test_what_make_vec_returns() -> None:
    env = make(5)
    assert isinstance(env, VectorEnv)
    assert env.unwrapped is env
    assert env.num_envs == 5
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.spec is not None
    assert env.spec.id == ID
    assert env.observation_space.shape == (5, *env.single_observation_space.shape)
    assert env.action_space.shape == (5, 6)
    default = gymnasium.make_vec(ID, num_envs=1)
    assert isinstance(default, sandgait.SandgaitVectorEnv)
    assert default.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP, "gymnasium's own default"
    default.close()
    env.close()
    env.close()


def test_same_step_semantics_are_syncvectorenvs() -> None:
    """40 steps in episodes of 12 steps. After a masked reset, some steps end no episode, and some end a few."""
    ours, theirs = make(4, max_episode_steps=12), synchronous(4, max_episode_steps=12)
    first, second = ours.reset(seed=5), theirs.reset(seed=5)
    assert_same(first[0], second[0])
    assert_same_infos(first[1], second[1])
    ours.action_space.seed(1)
    ended = set()
    for step in range(40):
        if step == 5:
            mask = np.array([True, False, False, True])
            chosen = [env.reset(seed=[9, 9, 9, 8], options={"reset_mask": mask.copy()})[0] for env in (ours, theirs)]
            assert_same(*chosen)
        actions = ours.action_space.sample()
        mine, reference = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:4], reference[:4], strict=True):
            assert_same(a, b)
        assert_same_infos(mine[4], reference[4])
        ended.add(int(mine[3].sum()))
    assert ended == {0, 2}
    ours.close()
    theirs.close()


@pytest.mark.parametrize("task", sandgait.TASKS)
def test_next_step_semantics_are_syncvectorenvs(task: str) -> None:
    """The bits are equal over many ends of episodes, of all environments or a few, and with wrong actions at resets."""
    mode = AutoresetMode.NEXT_STEP
    ours = sandgait.SandgaitVectorEnv(task, 3, autoreset_mode=mode, max_episode_steps=5)
    theirs = SyncVectorEnv([lambda: sandgait.SandgaitEnv(task, max_episode_steps=5)] * 3, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"] is mode
    assert_same(ours.reset(seed=5)[0], theirs.reset(seed=5)[0])
    ours.action_space.seed(1)
    held = np.zeros(3, bool)
    ended = set()
    for step in range(30):
        if step == 2:
            mask = np.array([True, False, False])
            assert_same(*(e.reset(seed=[9, 9, 9], options={"reset_mask": mask.copy()})[0] for e in (ours, theirs)))
        actions = ours.action_space.sample()
        mine, reference = ours.step(np.where(held[:, None], np.float32(7.0), actions)), theirs.step(actions)
        for a, b in zip(mine[:4], reference[:4], strict=True):
            assert_same(a, b)
        assert_same_infos(mine[4], reference[4])
        held = mine[2] | mine[3]
        ended.add(int(held.sum()))
    assert ended == {0, 1, 2}
    ours.close()
    theirs.close()


def test_next_step_over_several_servers() -> None:
    one, two = (
        make(5, autoreset_mode="NEXT_STEP", max_episode_steps=3, address=address) for address in (None, [None, None])
    )
    assert_same(one.reset(seed=2)[0], two.reset(seed=2)[0])
    for step in range(9):
        actions = np.full((5, 6), 0.1 * step, np.float32)
        for a, b in zip(one.step(actions)[:4], two.step(actions)[:4], strict=True):
            assert_same(a, b)
        if step == 2:
            for what in (one.save, lambda: one.rollout(np.zeros((2, 5, 6)))):
                with pytest.raises(sandgait.OutOfOrder, match="environment 0 has ended its episode"):
                    what()
    one.restore(one.save())
    one.close()
    two.close()
    with pytest.raises(sandgait.InvalidRequest, match=r'^autoreset_mode: "NEVER" is unknown; known: NEXT_STEP, SAME_'):
        make(2, autoreset_mode="NEVER")


@pytest.mark.parametrize("task", sandgait.TASKS)
def test_disabled_semantics_are_syncvectorenvs(task: str) -> None:
    """Environments that have ended are reset by the mask, with and without seeds, some of them or all at once."""
    mode = AutoresetMode.DISABLED
    ours = sandgait.SandgaitVectorEnv(task, 3, autoreset_mode="DISABLED", max_episode_steps=5)
    theirs = SyncVectorEnv([lambda: sandgait.SandgaitEnv(task, max_episode_steps=5)] * 3, autoreset_mode=mode)
    assert ours.autoreset_mode is ours.metadata["autoreset_mode"] is mode

    def reset(mask: np.ndarray, seed: Any = None) -> None:
        mine, reference = (e.reset(seed=seed, options={"reset_mask": mask.copy()}) for e in (ours, theirs))
        assert_same(mine[0], reference[0])
        assert_same_infos(mine[1], reference[1])

    assert_same(ours.reset(seed=5)[0], theirs.reset(seed=5)[0])
    ours.action_space.seed(1)
    ended, ways = np.zeros(3, bool), 0
    for step in range(40):
        if step == 2:
            reset(np.array([True, False, False]), [9, 9, 9])
        actions = ours.action_space.sample()
        mine, reference = ours.step(actions), theirs.step(actions)
        for a, b in zip(mine[:4], reference[:4], strict=True):
            assert_same(a, b)
        assert_same_infos(mine[4], reference[4])
        ended = mine[2] | mine[3]
        if ended.sum() == 2:  # one after the other, and one with a seed
            for i in np.flatnonzero(ended):
                with pytest.raises(sandgait.OutOfOrder, match=f"^step: environment {i} has ended its episode"):
                    ours.step(actions)
                reset(np.arange(3) == i, [7, 7, 7] if i == 1 else None)
                ways |= 1
        elif ended.any():
            reset(ended | (np.arange(3) == 0))
            ways |= 2
    assert ways == 3
    ours.close()
    theirs.close()


def test_disabled_episodes_are_shown_until_their_reset() -> None:
    size = {"render_mode": "rgb_array", "render_size": (64, 48)}
    env = make(2, autoreset_mode="DISABLED", max_episode_steps=25, **size)
    env.reset(seed=3)
    env.reset(seed=[4, None], options={"reset_mask": np.array([True, False])})
    first = env.render()
    assert first is not None
    for _ in range(25):
        ended = env.step(np.full((2, 6), 0.4))[3]
    assert ended.all()
    last = env.render()
    assert last is not None
    env.reset(options={"reset_mask": np.array([True, False])})
    mixed = env.render()
    assert mixed is not None
    assert np.array_equal(mixed[1], last[1])
    assert not np.array_equal(mixed[0], last[0])
    env.close()


def test_a_fork_has_the_keywords_of_its_original(remote: RemoteServer) -> None:
    options = {"clip_actions": True, "render_mode": "rgb_array", "render_size": (64, 48), "leg": "C"}
    camera = {"azimuth_deg": 10.0}
    for more in ({}, {"isolated": True}, {"address": remote.address}, {"address": [None, None, remote.address]}):
        env = make(4, autoreset_mode="DISABLED", render_camera=camera, **options, **more)
        env.reset(seed=1)
        actions = np.full((4, 6), 3.0)
        actions[2] = -3.0
        env.step(actions)
        for n in (1, 5):
            copies = env.fork(n, index=2)
            assert copies.autoreset_mode is AutoresetMode.DISABLED
            assert copies._origin.isolated is bool(more.get("isolated"))
            picture = env.render()
            copied = copies.render()
            assert picture is not None
            assert copied is not None
            assert np.array_equal(copied[-1], picture[2])
            rows = copies.step(np.full((n, 6), 3.0))[0]
            assert np.array_equal(rows, np.repeat(env.fork(1, index=2).step(np.full((1, 6), 1.0))[0], n, axis=0))
            copies.close()
        env.close()
    one = sandgait.SandgaitEnv(ID, **options)
    one.reset(seed=1)
    copies = one.fork(2)
    assert copies.render() is not None
    copies.step(np.full((2, 6), 3.0))
    copies.close()
    one.close()


def test_infos_where_every_episode_ends_at_once() -> None:
    ours, theirs = make(3, max_episode_steps=1), synchronous(3, max_episode_steps=1)
    ours.reset(seed=5)
    theirs.reset(seed=5)
    actions = np.full((3, 6), 0.4, np.float32)
    infos = ours.step(actions)[4]
    assert_same_infos(infos, theirs.step(actions)[4])
    assert infos["_final_info"].all()
    assert infos["final_info"]["speed"].all()
    assert not infos["speed"].any(), "the next episodes have made no step"
    ours.close()
    theirs.close()


def rollout(env: sandgait.SandgaitVectorEnv, seed: Any, steps: int = 30) -> list[np.ndarray]:
    """Observations of a fixed, smooth sequence of actions, the same for every environment."""
    rows = [env.reset(seed=seed)[0]]
    for k in range(steps):
        actions = np.tile(np.sin(0.3 * k + np.arange(6)), (env.num_envs, 1))
        rows.append(env.step(actions)[0])
    return rows


def test_an_environment_depends_on_its_seed_alone() -> None:
    """It depends neither on its index nor on the number of environments; 37 do not fill all lanes."""
    batch = make(37, max_episode_steps=20)
    rows = rollout(batch, 100)
    assert np.array_equal(rows, rollout(batch, list(range(100, 137))))
    alone = rollout(make(1, max_episode_steps=20), 120)
    assert np.array_equal([r[20] for r in rows], [r[0] for r in alone])
    assert not np.array_equal(rows, rollout(batch, 101))


def test_none_in_a_list_of_seeds_lets_that_stream_go_on() -> None:
    mixed, whole = make(2), make(2)
    mixed.reset(seed=3)
    whole.reset(seed=3)
    after = mixed.reset(seed=[None, 50])[0]
    assert np.array_equal(after[0], whole.reset()[0][0])
    assert np.array_equal(after[1], whole.reset(seed=50)[0][0])


def test_reset_mask_leaves_the_others_alone() -> None:
    env = make(3)
    env.reset(seed=0)
    before = env.step(np.full((3, 6), 0.3))[0]
    mask = np.array([False, True, False])
    options = {"reset_mask": mask, "slope_deg": 10.0}
    after, infos = env.reset(options=options)
    assert "reset_mask" in options, "the caller's dictionary is the caller's"
    assert set(infos) == {name for c in env.task.info for name in (c.name, f"_{c.name}")}
    assert np.array_equal(infos["_speed"], mask)
    assert np.array_equal(before[~mask], after[~mask])
    assert not np.array_equal(before[mask], after[mask])
    env.step(np.zeros((3, 6)))


@pytest.mark.parametrize(
    "mask",
    [[True, False, False], np.array([True, False]), np.array([1, 0, 0]), np.zeros(3, bool)],
    ids=["list", "shape", "dtype", "empty"],
)
def test_a_wrong_reset_mask_is_refused(mask: Any) -> None:
    env = make(3)
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": mask})


def test_two_halves_in_flight_equal_one_batch() -> None:
    halves, whole = (make(4, max_episode_steps=9), make(4, max_episode_steps=9)), make(8, max_episode_steps=9)
    halves[0].reset(seed=0)
    halves[1].reset(seed=4)
    whole.reset(seed=0)
    whole.action_space.seed(0)
    for _ in range(20):
        actions = whole.action_space.sample()
        halves[0].send(actions[:4])
        halves[1].send(actions[4:])
        rows = np.concatenate([half.recv()[0] for half in halves])
        assert np.array_equal(rows, whole.step(actions)[0])


def test_send_and_recv_alternate_and_a_reset_drops_a_step_in_flight() -> None:
    env = make(2)
    first, _ = env.reset(seed=0)
    with pytest.raises(sandgait.OutOfOrder, match="send"):
        env.recv()
    env.send(np.zeros((2, 6)))
    with pytest.raises(sandgait.OutOfOrder, match="recv"):
        env.send(np.zeros((2, 6)))
    assert np.array_equal(env.reset(seed=0)[0], first)
    env.step(np.zeros((2, 6)))


def test_results_are_the_callers_to_keep() -> None:
    env = make(2)
    kept = env.reset(seed=0)[0]
    copy = kept.copy()
    results = [env.step(np.full((2, 6), 0.5)) for _ in range(3)]
    assert np.array_equal(kept, copy)
    for array in (kept, *results[0][:4], results[0][4]["speed"]):
        assert array.flags.writeable
    assert not np.shares_memory(results[0][0], results[1][0])


def test_the_reward_is_the_sum_of_its_terms() -> None:
    env = make(6)
    env.reset(seed=0)
    for _ in range(10):
        _, rewards, _, _, infos = env.step(env.action_space.sample())
    terms = [c.name for c in env.task.info[: env.task.reward_terms]]
    assert all(name.startswith("reward_") for name in terms)
    assert rewards == pytest.approx(sum(infos[name] for name in terms), abs=1e-6)
    assert infos["_speed"].all()


def test_gymnasiums_vector_wrappers_take_it() -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(make(3, max_episode_steps=5))
    env.reset(seed=0)
    for _ in range(5):
        infos = env.step(np.zeros((3, 6), np.float32))[4]
    assert list(infos["episode"]["l"]) == [5, 5, 5]


def test_commands_are_set_for_the_rest_of_an_episode() -> None:
    envs: Any = gymnasium.make_vec("sandgait/LeggedVelocity-v1", num_envs=2, ground="rigid", max_episode_steps=30)
    names = [c.name for c in envs.unwrapped.task.observation]
    first = names.index("commanded lin_vel_x")
    envs.reset(seed=0)
    ours = np.array([[0.25, -0.125, 0.5], [0.0, 0.0, -0.25]], np.float32)
    assert (envs.unwrapped.set_command(ours)[:, first : first + 3] == ours).all()
    for _ in range(29):
        rows = envs.step(np.zeros(envs.action_space.shape, np.float32))[0]
        assert (rows[:, first : first + 3] == ours).all()
    for wrong in ([1.0, 2.0], "fast", np.zeros((3, 3))):
        with pytest.raises(sandgait.InvalidRequest, match=r"command: expected numbers \[3\] or \[2, 3\]"):
            envs.unwrapped.set_command(wrong)
    with pytest.raises(sandgait.InvalidRequest, match=r"commands\[1\]: 9 is outside"):
        envs.unwrapped.set_command([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    envs.close()
    stroke: Any = gymnasium.make_vec("sandgait/LegStroke-v0", num_envs=1)
    stroke.reset(seed=0)
    with pytest.raises(sandgait.InvalidRequest, match="has no commands"):
        stroke.unwrapped.set_command([0.0, 0.0, 0.0])
    stroke.close()
