"""Servers on the nodes of a Ray cluster: two nodes on this machine."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

# Without this token, Ray writes one into the home directory of the user who runs the tests.
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))

import numpy as np
import pytest
import ray
from ray.cluster_utils import Cluster

import sandgait
import sandgait.ray
from conftest import ID

EXAMPLES = Path(__file__).parents[2] / "examples"

# Ray does not close its own sockets and files, which would be a warning of the garbage collector.
pytestmark = pytest.mark.filterwarnings(
    "default::ResourceWarning", "default::FutureWarning", "default::DeprecationWarning"
)


@pytest.fixture(scope="module")
def servers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[sandgait.ray.Servers]:
    home = os.environ.get("HOME", "")
    os.environ["HOME"] = str(tmp_path_factory.mktemp("home"))  # RLlib writes results there
    os.environ["PYTHONPATH"] = os.pathsep.join([str(EXAMPLES), os.environ.get("PYTHONPATH", "")])
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    sys.path.insert(0, str(EXAMPLES))
    with sandgait.ray.serve() as servers:
        yield servers
    ray.shutdown()
    cluster.shutdown()
    os.environ["HOME"] = home


def test_one_server_a_node(servers: sandgait.ray.Servers) -> None:
    assert len(set(servers.nodes)) == len(set(servers.addresses)) == 2
    assert servers.threads == [1, 1]


def test_environments_over_the_cluster_give_the_same_numbers(servers: sandgait.ray.Servers) -> None:
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 5, 6)).astype(np.float32)
    rows = []
    for address in (None, servers.addresses):
        env = sandgait.SandgaitVectorEnv(ID, 5, address=address, max_episode_steps=8)
        rows.append([env.reset(seed=3)[0]] + [env.step(a)[0] for a in actions])
        env.close()
    assert np.array_equal(*rows)


def test_the_evolution_strategy_learns(servers: sandgait.ray.Servers) -> None:
    import ray_es

    _, curve = ray_es.evolve(servers, generations=5, population=64)
    assert np.mean(curve[-2:]) > np.mean(curve[:2]) + 5.0, curve


def test_rllib_trains_on_both_nodes(servers: sandgait.ray.Servers) -> None:
    """In some seconds every step reaches the learner, episodes end, and each runner uses the server on its node."""
    import rllib_ppo

    algorithm = rllib_ppo.build(servers, runners=2, envs=16, max_episode_steps=40)
    curve = rllib_ppo.train(algorithm, iterations=2)
    results = algorithm.env_runner_group.foreach_env_runner(
        lambda runner: (runner.env.unwrapped._session.addresses, runner.env.unwrapped.num_envs), local_env_runner=False
    )
    algorithm.stop()
    assert np.isfinite(curve).all(), curve
    assert sorted(results) == sorted(([address], 16) for address in servers.addresses)


def test_only_who_has_the_token_is_served(servers: sandgait.ray.Servers) -> None:
    address = servers.addresses[0]
    for stranger in (str(address), sandgait.Remote(address, ca=address.ca)):
        with pytest.raises(sandgait.SandgaitError, match=r"bearer token|cannot be reached"):
            sandgait.describe(stranger)
    processes = subprocess.run(["ps", "-ewwo", "args"], capture_output=True, text=True, check=True).stdout
    assert "--tls-self-signed" in processes
    assert address.token
    for shown in (processes, repr(servers), str(servers)):
        assert address.token not in shown


def test_wrong_use_is_named(servers: sandgait.ray.Servers) -> None:
    with pytest.raises(sandgait.InvalidRequest, match=r"^nodes\[0\]: 'x' is no node"):
        sandgait.ray.serve(nodes=["x"])
    with pytest.raises(sandgait.InvalidRequest, match=r"^threads: 0 is outside"):
        sandgait.ray.serve(threads=0)


def test_servers_end_when_closed(servers: sandgait.ray.Servers) -> None:
    with sandgait.ray.serve(nodes=servers.nodes[:1], threads=2) as more:
        sandgait.describe(more.addresses[0])
    with pytest.raises(sandgait.ServerLost):
        sandgait.describe(more.addresses[0])
