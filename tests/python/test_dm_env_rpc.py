"""DeepMind's own client and compliance tests, run against `sandgait serve --dm-env-rpc`."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
import unittest
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from dm_env_rpc.v1 import compliance, dm_env_adaptor, dm_env_rpc_pb2, error, tensor_utils
from dm_env_rpc.v1.connection import Connection
from google.protobuf import any_pb2, descriptor_pb2
from google.rpc import code_pb2

import sandgait
from conftest import ID, RemoteServer
from sandgait import client

REPOSITORY = Path(__file__).parents[2]

#: Number of tests in the suite of dm_env_rpc 1.1.7. Fewer would mean that some are not run.
COMPLIANCE_TESTS = 40

pack = tensor_utils.pack_tensor
State = dm_env_rpc_pb2.EnvironmentStateType


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with RemoteServer("127.0.0.1:0", "--dm-env-rpc") as server:
        yield server.address


@pytest.fixture
def connections(address: str) -> Iterator[Any]:
    """Makes connections."""
    channels = []

    def connect() -> Connection:
        channels.append(grpc.insecure_channel(address))
        return Connection(channels[-1])

    yield connect
    for channel in channels:
        channel.close()


@pytest.fixture
def connection(connections: Any) -> Connection:
    return connections()


def create(connection: Connection, task: str = ID, **settings: Any) -> str:
    return dm_env_adaptor.create_world(connection, {"task": task, **settings})


def join(connection: Connection, world: str) -> Any:
    return connection.send(dm_env_rpc_pb2.JoinWorldRequest(world_name=world)).specs


def step(connection: Connection, action: Any = None, uids: tuple[int, ...] = (1,)) -> Any:
    actions = {} if action is None else {1: pack(action, dtype=np.float32)}
    return connection.send(dm_env_rpc_pb2.StepRequest(actions=actions, requested_observations=uids))


def row(response: Any) -> Any:
    return tensor_utils.unpack_tensor(response.observations[1])


# --- the compliance suite -----------------------------------------------------------------------------------------


class Connected:
    """Opens a connection for each test."""

    @pytest.fixture(autouse=True)
    def _server(self, address: str) -> None:
        self.address = address

    def setUp(self) -> None:
        super().setUp()  # type: ignore[misc]
        self.channel = grpc.insecure_channel(self.address)
        self.connection = Connection(self.channel)

    def tearDown(self) -> None:
        super().tearDown()  # type: ignore[misc]
        self.channel.close()


class InWorld(Connected):
    """Also creates and joins a world."""

    def setUp(self) -> None:
        super().setUp()
        self.world_name = create(self.connection)


class CreateDestroyWorld(Connected, compliance.CreateDestroyWorld):
    connection = required_world_settings = invalid_world_settings = None
    has_multiple_world_support = True

    def setUp(self) -> None:
        super().setUp()
        self.required_world_settings = {"task": pack(ID)}
        self.invalid_world_settings = {
            "no_such_option": pack(1),
            "slope_deg": pack("steep"),
            "payload": pack(-1.0),
            "command": pack([0.1, 0.2, 0.3]),
            "seed": pack(-1),
            "num_envs": pack(2),
        }


class JoinLeaveWorld(InWorld, compliance.JoinLeaveWorld):
    connection = world_name = None
    invalid_join_settings = {"leg": pack("C")}


class Reset(InWorld, compliance.Reset):
    connection = None
    required_reset_settings = {"slope_deg": pack(5.0), "seed": pack(1)}

    def join_world(self) -> Any:
        return join(self.connection, self.world_name)


class ResetWorld(InWorld, compliance.ResetWorld):
    connection = world_name = None


class Step(InWorld, compliance.Step):
    connection = specs = None
    required_actions = {1: pack(np.zeros(6, np.float32))}

    def setUp(self) -> None:
        super().setUp()
        self.specs = join(self.connection, self.world_name)


COMPLIANCE = (CreateDestroyWorld, JoinLeaveWorld, Reset, ResetWorld, Step)


def test_the_whole_suite_runs() -> None:
    theirs = [getattr(compliance, name) for name in dir(compliance) if isinstance(getattr(compliance, name), type)]
    assert len(theirs) == len(COMPLIANCE)
    assert all(any(issubclass(ours, case) for ours in COMPLIANCE) for case in theirs)
    count = sum(unittest.defaultTestLoader.loadTestsFromTestCase(case).countTestCases() for case in COMPLIANCE)
    assert count == COMPLIANCE_TESTS


# --- the adaptor, and our own client's numbers ---------------------------------------------------------------------


WALKING = {"slope_deg": 4.0, "command": [0.2, 0.3], "weights": {"power": 0.3}}
LEGGED = {"ground": "poppy-loose", "action_scale": 0.3, "slope_deg": 4.0}
STROKE = {"angle_noise": 0.1, "stroke": {"carriage_speed": 0.1}}


@pytest.mark.parametrize("task", sandgait.TASKS)
def test_same_numbers_as_gymnasium(connection: Connection, address: str, task: str) -> None:
    own = {"sandgait/LegStroke-v0": STROKE, "sandgait/LeggedVelocity-v1": LEGGED}.get(task, WALKING)
    options: dict[str, Any] = {"max_episode_steps": 7, **own}
    settings = {"task": task, "seed": 11, **options}
    env, world = dm_env_adaptor.create_and_join_world(connection, settings, {})
    ours = sandgait.SandgaitVectorEnv(task, 1, address, autoreset_mode="SAME_STEP", **options)
    random = np.random.default_rng(0)
    with env:
        assert env.action_spec()["action"].shape == ours.single_action_space.shape
        assert np.array_equal(env.observation_spec()["observation"].maximum, ours.single_observation_space.high)
        timestep = env.reset()
        observations, _ = ours.reset(seed=11)
        ends = 0
        for _ in range(20):
            assert np.array_equal(timestep.observation["observation"], observations[0])
            action = random.uniform(-1, 1, env.action_spec()["action"].shape).astype(np.float32)
            timestep = env.step({"action": action})
            observations, rewards, terminated, truncated, infos = ours.step(action[None])
            assert timestep.reward == np.float32(rewards[0])
            assert timestep.discount == (0.0 if terminated[0] else 1.0)
            assert timestep.last() == (terminated[0] or truncated[0])
            if timestep.last():
                ends += 1
                assert np.array_equal(timestep.observation["observation"], infos["final_obs"][0])
                timestep = env.step({"action": action})  # ignored: ours has begun the next episode already
                assert timestep.first()
        assert ends == 2
    ours.close()
    connection.send(dm_env_rpc_pb2.DestroyWorldRequest(world_name=world))


def test_termination_has_discount_zero(connection: Connection) -> None:
    # On such a steep slope and with such a payload the robot is buried or overturned before its time limit.
    settings = {"task": ID, "seed": 0, "payload": 5.0}
    env, _ = dm_env_adaptor.create_and_join_world(connection, settings, {})
    with env:
        timestep = env.reset()
        while not timestep.last():
            timestep = env.step({"action": np.ones(6, np.float32)})
        assert timestep.discount == 0.0


def test_worlds_without_a_seed_differ(connection: Connection) -> None:
    rows = []
    for _ in range(2):
        join(connection, create(connection))
        rows.append(row(step(connection)))
        connection.send(dm_env_rpc_pb2.LeaveWorldRequest())
    assert not np.array_equal(*rows)


# --- sequences -----------------------------------------------------------------------------------------------------


def test_reset_begins_anew(connection: Connection) -> None:
    join(connection, create(connection, seed=3))
    first, second = row(step(connection)), row(step(connection, 0.5))
    cases: list[tuple[dict[str, Any], bool, bool]] = [
        ({}, False, False),
        ({"seed": pack(3)}, True, True),
        ({"seed": pack(3), "slope_deg": pack(10.0)}, True, False),  # at rest the row does not show the slope
    ]
    for settings, same_start, same_step in cases:
        connection.send(dm_env_rpc_pb2.ResetRequest(settings=settings))
        assert np.array_equal(row(step(connection)), first) == same_start
        assert np.array_equal(row(step(connection, 0.5)), second) == same_step


def test_reset_world_waits_for_the_other_connection(connections: Any) -> None:
    agent, other = connections(), connections()
    world = create(agent, seed=3)
    join(agent, world)
    first = row(step(agent))
    played = row(step(agent, 0.5))
    done = threading.Event()

    def reset_world() -> None:
        other.send(dm_env_rpc_pb2.ResetWorldRequest(world_name=world, settings={"seed": pack(3)}))
        done.set()

    thread = threading.Thread(target=reset_world)
    thread.start()
    assert not done.wait(0.3)
    last = step(agent, 0.5)
    assert last.state == State.INTERRUPTED
    assert np.array_equal(row(last), played)
    assert done.wait(5)
    thread.join()
    begun = step(agent)
    assert begun.state == State.RUNNING
    assert np.array_equal(row(begun), first)


def test_reset_world_goes_on_when_the_other_leaves(connections: Any) -> None:
    agent, other = connections(), connections()
    world = create(agent)
    join(agent, world)
    thread = threading.Thread(target=lambda: other.send(dm_env_rpc_pb2.ResetWorldRequest(world_name=world)))
    thread.start()
    thread.join(0.2)
    assert thread.is_alive()
    agent.send(dm_env_rpc_pb2.LeaveWorldRequest())
    thread.join(5)
    assert not thread.is_alive()


def test_a_lost_connection_leaves_its_world(connection: Connection, address: str) -> None:
    with grpc.insecure_channel(address) as channel:
        lost = Connection(channel)
        world = create(lost, seed=3)
        join(lost, world)
        first = row(step(lost))
        step(lost, 0.5)
    deadline = time.monotonic() + 5.0
    while True:
        try:
            join(connection, world)
            break
        except error.DmEnvRpcError:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    begun = step(connection)
    assert begun.state == State.RUNNING
    assert not np.array_equal(row(begun), first), "it was being played, so another episode begins"


# --- refusals ------------------------------------------------------------------------------------------------------


def refusal(connection: Connection, request: Any) -> tuple[int, str]:
    with pytest.raises(error.DmEnvRpcError) as caught:
        connection.send(request)
    return caught.value.code, caught.value.message


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({7: pack(0.0)}, "actions[7]: there is no such uid; 1 is action"),
        ({}, "actions[1]: missing: a step needs the tensor action"),
        ({1: pack(np.zeros(6))}, "actions[1]: doubles, expected floats"),
        ({1: pack(np.zeros(5, np.float32))}, "actions[1]: shape [5] with 5 numbers, expected [6]"),
        (
            {1: pack(np.array([0, 0, 2, 0, 0, 0], np.float32))},
            r"actions\[1\]\[2\]: 2 \(target hip speed / 5 Hz, .*\) is outside \[-1, 1\]",
        ),
        ({1: pack(np.full(6, np.nan, np.float32))}, r"actions\[1\]\[0\]: NaN .* is outside \[-1, 1\]"),
    ],
)
def test_wrong_actions_are_named_and_change_nothing(
    connection: Connection, actions: dict[int, Any], message: str
) -> None:
    join(connection, create(connection, seed=5))
    step(connection)
    got = refusal(connection, dm_env_rpc_pb2.StepRequest(actions=actions))
    assert got[0] == code_pb2.INVALID_ARGUMENT
    assert got[1] == message or re.fullmatch(message, got[1])
    after = row(step(connection, 0.3))
    connection.send(dm_env_rpc_pb2.ResetRequest(settings={"seed": pack(5)}))
    step(connection)
    assert np.array_equal(row(step(connection, np.full(6, 0.3))), after)


def test_requests_that_cannot_be_met(connections: Any) -> None:
    connection, other = connections(), connections()
    world = create(connection)
    join(connection, world)
    names = dm_env_rpc_pb2
    cases = [
        (
            other,
            names.JoinWorldRequest(world_name=world),
            code_pb2.FAILED_PRECONDITION,
            "another connection has joined",
        ),
        (other, names.DestroyWorldRequest(world_name=world), code_pb2.FAILED_PRECONDITION, "must leave first"),
        (connection, names.DestroyWorldRequest(world_name=world), code_pb2.FAILED_PRECONDITION, "must leave first"),
        (other, names.StepRequest(), code_pb2.FAILED_PRECONDITION, "step: this connection has joined no world"),
        (other, names.JoinWorldRequest(world_name="x"), code_pb2.NOT_FOUND, "x"),
        (connection, names.StepRequest(requested_observations=[9]), code_pb2.INVALID_ARGUMENT, "there is no uid 9"),
        (connection, names.ResetRequest(settings={"dt": pack(1e-3)}), code_pb2.INVALID_ARGUMENT, "dt"),
        (connection, names.CreateWorldRequest(settings={"task": pack("x")}), code_pb2.INVALID_ARGUMENT, "sandgait/"),
        (connection, any_pb2.Any(type_url="type/x.ListProperty"), code_pb2.UNIMPLEMENTED, "x.ListProperty"),
    ]
    for sender, request, code, words in cases:
        got = refusal(sender, request)
        assert got[0] == code
        assert words in got[1]


def test_a_world_has_one_environment(connection: Connection, address: str) -> None:
    session = client.create_session(address, ID, 3, {}).session_id
    got = refusal(connection, dm_env_rpc_pb2.JoinWorldRequest(world_name=session))
    assert got[0] == code_pb2.INVALID_ARGUMENT
    assert "a session of 3 environments" in got[1]
    client.close_session(address, session)


def test_the_protocol_is_off_by_default(remote: RemoteServer) -> None:
    with grpc.insecure_channel(remote.address) as channel, pytest.raises(grpc.RpcError) as caught:
        create(Connection(channel))
    assert caught.value.code() == grpc.StatusCode.UNIMPLEMENTED


# --- documents -----------------------------------------------------------------------------------------------------


def test_our_protocol_file_equals_theirs(tmp_path: Path) -> None:
    """Our .proto file has the same content as the descriptor in DeepMind's wheel."""
    out = tmp_path / "descriptor"
    paths = [f"--proto_path={REPOSITORY / 'proto'}", f"--descriptor_set_out={out}"]
    subprocess.run([sys.executable, "-m", "grpc_tools.protoc", *paths, "dm_env_rpc/v1/dm_env_rpc.proto"], check=True)
    (ours,) = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes()).file
    theirs = descriptor_pb2.FileDescriptorProto()
    dm_env_rpc_pb2.DESCRIPTOR.CopyToProto(theirs)

    def without_json_names(message: Any) -> str:  # protoc derives these names, in the wheel only
        return re.sub(r"\n *json_name: .*", "", str(message))

    assert without_json_names(ours) == without_json_names(theirs)


def test_the_example_of_the_document_runs(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = (REPOSITORY / "docs" / "dm_env_rpc.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.S)
    exec(compile(example.replace("127.0.0.1:50051", address), "docs/dm_env_rpc.md", "exec"), {})
    assert "reward of the last step:" in capsys.readouterr().out


def test_metrics_count_worlds() -> None:
    with RemoteServer("127.0.0.1:0", "--dm-env-rpc", "--metrics", "127.0.0.1:0") as server:
        page = server.address_of("metrics are at /metrics")
        with grpc.insecure_channel(server.address) as channel:
            connection = Connection(channel)
            join(connection, create(connection, max_episode_steps=3))
            for _ in range(6):  # the first and the fifth begin an episode: 3 steps, then 1
                step(connection, 0.1)
            with pytest.raises(error.DmEnvRpcError):
                step(connection, 9.0)
        text = urllib.request.urlopen(f"http://{page}/metrics").read().decode()
    for line in (
        "sandgait_environment_steps_total 4",
        "sandgait_autoresets_total 1",
        'sandgait_batch_seconds_count{operation="step"} 4',
        'sandgait_failures_total{code="InvalidArgument"} 1',
    ):
        assert f"\n{line}\n" in text, text
