"""Clients that were not written for this server, unmodified and used as their own documentation says.

The tests of dm_env_rpc, stable-baselines3 and RLlib are in other files.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import grpc
import gymnasium
import numpy as np
import pytest
from google.protobuf import descriptor_pool, message_factory
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

import sandgait
from conftest import ID, RemoteServer


def test_grpcio_health_checking(remote: RemoteServer) -> None:
    with grpc.insecure_channel(remote.address) as channel:
        health = health_pb2_grpc.HealthStub(channel)
        for service in ("", "sandgait.v1.EnvironmentService", "sandgait.v1.StudyService"):
            reply = health.Check(health_pb2.HealthCheckRequest(service=service), timeout=5)
            assert reply.status == health_pb2.HealthCheckResponse.SERVING
        with pytest.raises(grpc.RpcError) as refused:
            health.Check(health_pb2.HealthCheckRequest(service="nothing"), timeout=5)
        assert refused.value.code() is grpc.StatusCode.NOT_FOUND
        watch = health.Watch(health_pb2.HealthCheckRequest(), timeout=10)
        assert next(watch).status == health_pb2.HealthCheckResponse.SERVING
        remote.process.terminate()
        assert next(watch).status == health_pb2.HealthCheckResponse.NOT_SERVING


def test_reflection_replaces_the_proto_files(remote: RemoteServer) -> None:
    """As with grpcurl, services, methods and messages come from the server's reflection."""
    with grpc.insecure_channel(remote.address) as channel:
        database = ProtoReflectionDescriptorDatabase(channel)
        assert "sandgait.v1.EnvironmentService" in database.get_services()
        pool = descriptor_pool.DescriptorPool(database)
        service = pool.FindServiceByName("sandgait.v1.EnvironmentService")

        def method(name: str) -> tuple[str, Callable[..., Any], Callable[..., Any]]:
            kind = service.methods_by_name[name]
            request, reply = (message_factory.GetMessageClass(m) for m in (kind.input_type, kind.output_type))
            return f"/{service.full_name}/{name}", request, reply

        path, create, reply = method("CreateSession")
        call = channel.unary_unary(path, lambda m: m.SerializeToString(), reply.FromString)
        session_id = call(create(task_id=ID, num_envs=3, protocol=1), timeout=10).session_id
        path, request, reply = method("RunSession")
        actions = np.full((3, 6), 0.25, np.float32)
        requests = [
            request(session_id=session_id, reset={"seeds": [5, 6, 7]}),
            request(step={"actions": actions.tobytes()}),
        ]
        stream = channel.stream_stream(path, lambda m: m.SerializeToString(), reply.FromString)
        rows = [np.frombuffer(answer.batch.observations, "<f4") for answer in stream(iter(requests), timeout=10)]
    env = sandgait.SandgaitVectorEnv(ID, 3)
    expected = [env.reset(seed=5)[0], env.step(actions)[0]]
    env.close()
    assert [row.tobytes() for row in rows] == [row.tobytes() for row in expected]


def test_a_loop_as_cleanrl_writes_it() -> None:
    """The environments and the loop of CleanRL's ppo_continuous_action.py, with random actions."""

    def make_env(gamma: float) -> Callable[[], gymnasium.Env[Any, Any]]:
        def thunk() -> gymnasium.Env[Any, Any]:
            env: gymnasium.Env[Any, Any] = gymnasium.make(ID, max_episode_steps=20)
            env = gymnasium.wrappers.FlattenObservation(env)
            env = gymnasium.wrappers.RecordEpisodeStatistics(env)
            env = gymnasium.wrappers.ClipAction(env)
            env = gymnasium.wrappers.NormalizeObservation(env)
            env = gymnasium.wrappers.TransformObservation(env, lambda obs: np.clip(obs, -10, 10), env.observation_space)
            env = gymnasium.wrappers.NormalizeReward(env, gamma=gamma)
            return gymnasium.wrappers.TransformReward(env, lambda reward: float(np.clip(reward, -10, 10)))

        return thunk

    envs = gymnasium.vector.SyncVectorEnv([make_env(0.99) for _ in range(4)])
    assert isinstance(envs.single_action_space, gymnasium.spaces.Box), "only continuous action space is supported"
    random = np.random.default_rng(1)
    returns = []
    next_obs, _ = envs.reset(seed=1)
    for _ in range(70):
        action = random.normal(size=envs.action_space.shape or ())
        next_obs, reward, terminations, truncations, infos = envs.step(action)
        next_done = np.logical_or(terminations, truncations)
        assert next_obs.shape == (4, 41)
        assert np.isfinite(next_obs).all()
        assert np.isfinite(reward).all()
        if "episode" in infos:
            assert (infos["_episode"] == next_done).all()
            returns += [float(r) for r in infos["episode"]["r"][infos["_episode"]]]
    assert len(returns) >= 4 * (70 // 21)
    envs.close()


FROM_PROTO = """
import sys
import grpc, numpy as np
sys.path.insert(0, sys.argv[2])
from sandgait.v1 import sandgait_pb2 as pb
channel = grpc.insecure_channel(sys.argv[1])
service = "/sandgait.v1.EnvironmentService/"
packed = lambda message: message.SerializeToString()
create = channel.unary_unary(service + "CreateSession", packed, pb.CreateSessionResponse.FromString)
session = create(pb.CreateSessionRequest(task_id=sys.argv[3], num_envs=3, protocol=1)).session_id
run = channel.stream_stream(service + "RunSession", packed, pb.RunSessionResponse.FromString)
requests = [
    pb.RunSessionRequest(session_id=session, reset=pb.Reset(seeds=[5, 6, 7])),
    pb.RunSessionRequest(step=pb.Step(actions=np.full((3, 6), 0.3, "<f4").tobytes())),
]
print(*(answer.batch.observations.hex() for answer in run(iter(requests))), sep="\\n")
"""


def test_a_grpcio_client_made_from_the_protos(remote: RemoteServer, tmp_path: Path) -> None:
    """Runs in a process without this package, because the generated messages have the same package name."""
    made = [
        sys.executable,
        "-m",
        "grpc_tools.protoc",
        f"--proto_path={Path(__file__).parents[2]}/proto",
        f"--python_out={tmp_path}",
    ]
    subprocess.run([*made, "sandgait/v1/sandgait.proto"], check=True)
    for package in ("sandgait", "sandgait/v1"):
        (tmp_path / package / "__init__.py").touch()
    arguments = [remote.address, str(tmp_path), ID]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run = [sys.executable, "-c", FROM_PROTO, *arguments]
    told = subprocess.run(run, capture_output=True, text=True, check=True, env=environment, cwd=tmp_path).stdout
    env = sandgait.SandgaitVectorEnv(ID, 3)
    expected = [env.reset(seed=5)[0], env.step(np.full((3, 6), 0.3, np.float32))[0]]
    env.close()
    assert told.split() == [rows.tobytes().hex() for rows in expected]
