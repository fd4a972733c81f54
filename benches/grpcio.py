"""What grpcio itself takes of a step, by each way that it offers: medians [µs] of an empty message there and back, of a
step as messages alone, and of `env.step`.

usage: taskset -c 0 python benches/grpcio.py [--envs 32] [--seconds 0.3] [--rounds 3]

The ways take turns. An empty message is `Attach`, or `ListSessions` where a call is unary: neither reaches the
simulation.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from collections.abc import Callable
from typing import Any

import grpc
import numpy as np

import sandgait
from sandgait import client, server
from sandgait._proto.sandgait.v1 import sandgait_pb2 as pb

ID = "sandgait/HexapodGait-v1"
SERVICE = "/sandgait.v1.EnvironmentService/"
OPTIONS = [("grpc.default_authority", "localhost")]
RUN = (f"{SERVICE}RunSession", pb.RunSessionRequest.SerializeToString, pb.RunSessionResponse.FromString)
LIST = (f"{SERVICE}ListSessions", pb.ListSessionsRequest.SerializeToString, pb.ListSessionsResponse.FromString)

#: Sends a request and gives the answer.
Ask = Callable[[pb.RunSessionRequest], Any]


def stream(address: str, session_id: str) -> Ask:
    """The client's own stream: grpcio's threads send and receive."""
    joined = client.Stream(address, session_id)

    def ask(request: pb.RunSessionRequest) -> Any:
        joined.send(request)
        return joined.receive()

    return ask


def asyncio_stream(address: str, session_id: str) -> Ask:
    """grpc.aio, driven step by step from a caller that is no coroutine."""
    loop = asyncio.new_event_loop()

    async def join() -> Any:
        return grpc.aio.insecure_channel(address, options=OPTIONS).stream_stream(*RUN)()

    call = loop.run_until_complete(join())

    async def exchange(request: pb.RunSessionRequest) -> Any:
        await call.write(request)
        return await call.read()

    def ask(request: pb.RunSessionRequest) -> Any:
        return loop.run_until_complete(exchange(request))

    ask(empty(session_id))
    return ask


def empty(session_id: str = "") -> pb.RunSessionRequest:
    return pb.RunSessionRequest(session_id=session_id, attach=pb.Attach())


def stepper(ask: Ask, envs: int) -> Callable[[], Any]:
    """Steps with random actions as messages alone, after a reset."""
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (64, envs, 6)).astype(np.float32)
    ask(client.reset_request(range(envs), None, {}))
    turns = iter(range(10**9))
    return lambda: ask(client.step_request(actions[next(turns) % 64]))


def ways(address: str, envs: int) -> dict[str, Callable[[], Any]]:
    """What is measured."""
    table: dict[str, Callable[[], Any]] = {}
    for name, kind in (("stream", stream), ("asyncio stream", asyncio_stream)):
        ask = kind(address, client.create_session(address, ID, envs, {}).session_id)
        table[f"{name}: empty message"] = lambda ask=ask: ask(empty())
        table[f"{name}: step as messages"] = stepper(ask, envs)
    request = pb.ListSessionsRequest()
    alone = [*OPTIONS, (grpc.experimental.ChannelOptions.SingleThreadedUnaryStream, 1)]
    channels = [grpc.insecure_channel(address, options=options) for options in (OPTIONS, alone)]
    unary, single = channels[0].unary_unary(*LIST), channels[1].unary_stream(*LIST)
    table["unary call: empty message"] = lambda: unary(request)
    # A channel that is collected closes: this one keeps them both.
    table["single-threaded unary stream: empty message"] = lambda _keep=channels: list(single(request))
    env = sandgait.SandgaitVectorEnv(ID, envs)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (envs, 6)).astype(np.float32)
    table["env.step"] = lambda: env.step(actions)
    return table


def timed(call: Callable[[], Any], seconds: float) -> float:
    """Median time of a call [µs]."""
    times = []
    end = time.perf_counter() + seconds
    while (start := time.perf_counter()) < end:
        call()
        times.append(time.perf_counter() - start)
    return 1e6 * float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n", maxsplit=1)[0])
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--seconds", type=float, default=0.3, help="length of one measurement")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    table = ways(server.address(), arguments.envs)
    rounds = [{name: timed(call, arguments.seconds) for name, call in table.items()} for _ in range(arguments.rounds)]
    for name in table:
        values = sorted(r[name] for r in rounds)
        print(f"{name:44} {values[len(values) // 2]:6.0f} µs  ({values[0]:.0f} to {values[-1]:.0f})")


if __name__ == "__main__":
    main()
