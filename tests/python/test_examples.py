"""What README and examples show works as shown."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

from conftest import RemoteServer

ROOT = Path(__file__).parents[2]


def run(*arguments: str) -> str:
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=True, timeout=300, cwd=ROOT
    ).stdout


def test_readmes_python(remote: RemoteServer) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    assert len(blocks) == 2
    speed = float(re.findall(r"robot: ([\d.]+) m/s", run("-c", blocks[0]))[0])
    assert 0.0 < speed < 1.0
    run("-c", "import gymnasium as gym, sandgait\n" + blocks[1].replace("127.0.0.1:50051", remote.address))


def test_train_gait_writes_what_it_promises(tmp_path: Path) -> None:
    """A few seconds: the files and the table, not the skill."""
    arguments = ["--seconds", "4", "--envs", "16", "--options", json.dumps({"leg": "C", "max_episode_steps": 100})]
    output = run("examples/train_gait.py", *arguments, "--out", str(tmp_path / "run"))
    written = {path.name for path in (tmp_path / "run").iterdir()}
    assert written == {"policy.zip", "normalize.pkl", "settings.json", "curve.csv", "curve.png", "evaluation.txt"}
    for name in ("learnt (PPO)", "the best rate", "random actions"):
        assert re.search(re.escape(name) + r" .*-?\d+\.\d ± \d+\.\d", output)
    settings = json.loads((tmp_path / "run" / "settings.json").read_text())
    assert settings["options"]["leg"] == "C"
    assert settings["seed"] == 0


def test_the_bench_of_the_client_measures() -> None:
    rows = json.loads(run("benches/client.py", "--envs", "8", "--seconds", "0.2", "--json"))
    assert rows[0]["envs"] == 8
    assert rows[0]["env_steps_per_second"] > 0
