"""The example programs run and write the documented files."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples"))

import train  # noqa: E402


def run(*arguments: str, cwd: Path = ROOT) -> str:
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, check=True, timeout=300, cwd=cwd
    ).stdout


def test_training_writes_what_it_promises_and_goes_on(tmp_path: Path) -> None:
    """A training of a few seconds: the test checks the files and the table, not the policy's skill."""
    options = json.dumps({"leg": "C", "max_episode_steps": 100})
    arguments = ["--envs", "16", "--options", options, "--checkpoint-every", "1024", "--out", str(tmp_path / "run")]
    output = run("examples/train.py", *arguments, "--steps", "4096")
    written = {path.name for path in (tmp_path / "run").iterdir()}
    files = {"policy.zip", "policy.onnx", "normalize.pkl", "settings.json", "curve.csv", "curve.png", "evaluation.txt"}
    assert written == files | {"checkpoints", "tensorboard", "videos"}
    for name in ("learnt (PPO)", "the best rate", "random actions"):
        assert re.search(re.escape(name) + r" .*-?\d+\.\d ± \d+\.\d", output)
    settings = json.loads((tmp_path / "run" / "settings.json").read_text())
    assert settings["options"]["leg"] == "C"
    assert settings["seed"] == 0
    before = (tmp_path / "run" / "curve.csv").read_text()
    output = run("examples/train.py", *arguments, "--steps", "6144", "--resume")
    after = (tmp_path / "run" / "curve.csv").read_text()
    assert after.startswith(before)
    assert len(after) > len(before)
    assert output.startswith("\n6,144 steps")
    other = [
        "--envs",
        "16",
        "--options",
        options,
        "--out",
        str(tmp_path / "other"),
        "--start-from",
        str(tmp_path / "run"),
    ]
    output = run("examples/train.py", *other, "--steps", "2048", "--set", "learning_rate=1e-12")
    assert output.startswith("\n2,048 steps")
    first, second = (load_policy(tmp_path / name / "policy.zip") for name in ("run", "other"))
    assert all(torch.allclose(first[name], second[name], atol=1e-6) for name in first)


def load_policy(path: Path) -> dict[str, torch.Tensor]:
    """Weights of a policy of stable-baselines3."""
    with zipfile.ZipFile(path) as parts, parts.open("policy.pth") as file:
        weights: dict[str, torch.Tensor] = torch.load(file, weights_only=True)
    return weights


def test_the_proof_of_hardware_compares_trainings(tmp_path: Path) -> None:
    short = ["--tasks", "HexapodGait", "--seeds", "1", "--steps", "20000", "--episodes", "2", "--out", str(tmp_path)]
    first = run("examples/hardware_proof.py", *short)
    assert "| HexapodGait | exact |" in first
    assert "| HexapodGait | randomised |" in first
    assert run("examples/hardware_proof.py", *short) == first, "finished trainings are taken as they are"


def test_sac_trains_and_goes_on_with_its_buffer(tmp_path: Path) -> None:
    sac = ["--algorithm", "sac", "--envs", "8", "--set", "learning_starts=200", "--out", str(tmp_path)]
    options = ["--options", json.dumps({"max_episode_steps": 50}), "--checkpoint-every", "400"]
    run("examples/train.py", *sac, *options, "--steps", "800")
    assert run("examples/train.py", *sac, *options, "--steps", "1200", "--resume").startswith("\n1,200 steps")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--task", "Hexapot"], "ppo.yml has no settings for 'sandgait/Hexapot'"),
        (["--set", "gamma"], "--set 'gamma': expected NAME=VALUE"),
        (["--set", "learning_rate=fast"], "learning_rate: 'fast' is neither a number nor lin_NUMBER"),
        (["--set", "gama=0.9"], "gama"),
        (["--resume"], "--resume: no checkpoint in"),
        (["--start-from", "nowhere"], "--start-from: no policy.zip in nowhere"),
    ],
)
def test_wrong_settings_are_one_line(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["train.py", "--out", str(tmp_path / "run"), *arguments])
    with pytest.raises(SystemExit) as ended:
        train.main()
    assert ended.value.code == 2
    assert says in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("name", "writes", "says"),
    [
        ("leg_forces", ["leg_forces.png"], r"L +lifts +7\.5 N at +-41°"),
        ("design_sweep", ["design_sweep.png"], r"fastest: ξ = \d+° at [\d.]+ Hz: [\d.]+ cm/s"),
        (
            "diagnose_force_log",
            [f"diagnose_force_log/{file}" for file in ("curves.png", "walks.png", "report.html", "sand.toml")],
            r"inertial_drag: 0\.\d+, 95 % interval",
        ),
    ],
)
def test_a_worked_study_draws_its_figures(name: str, writes: list[str], says: str, tmp_path: Path) -> None:
    """Every cell runs without a warning; each study takes less than half a minute."""
    shutil.copytree(ROOT / "examples/data", tmp_path / "examples/data")
    start = time.monotonic()
    output = subprocess.run(
        [sys.executable, "-W", "error", ROOT / f"examples/{name}.py"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg"},
    ).stdout
    assert time.monotonic() - start < 30
    assert re.search(says, output), output
    for file in writes:
        assert (tmp_path / "runs" / file).stat().st_size > 500


def test_close_the_loop_writes_its_figures(tmp_path: Path) -> None:
    """Two generations only: the test checks that there are figures, not their content."""
    short = ["--seeds", "1", "--generations", "2", "--evaluations", "8"]
    output = run("-W", "error", "examples/close_the_loop.py", *short, "--out", str(tmp_path))
    assert "the misfit is explained by" in output
    for name in ("textbook", "diagnosed", "true"):
        assert re.search(rf"^{name} +-?\d+\.\d \(-?\d", output, flags=re.MULTILINE), output
    assert re.search(r"diagnosed minus textbook: [+-]\d+\.\d\d \(", output)
    assert (tmp_path / "diagnosis/sand.toml").exists()


def test_the_loop_study_changes_nothing_where_nothing_is_hidden(tmp_path: Path) -> None:
    """On hard ground, where no sand is diagnosed; a second run takes the results as they are."""
    policy = Path(shutil.copytree(ROOT / "examples/policies/LeggedVelocity-sandcat", tmp_path / "cat"))
    settings, about = (json.loads((policy / name).read_text()) for name in ("settings.json", "policy.json"))
    settings["options"]["ground"] = about["trained_with"]["ground"] = "rigid"
    (policy / "settings.json").write_text(json.dumps(settings))
    (policy / "policy.json").write_text(json.dumps(about))
    short = [str(policy), "--robot", "robots/sandcat.xml", "--out", str(tmp_path / "loop"), "--plants", "nothing"]
    output = run("examples/loop_study.py", *short)
    row = output.splitlines()[-1]
    assert re.match(r"\| nothing \| (\d+\.\d%) \| \1 \| 0.0% \| – \| – \| nothing changed \| \d+ s \|", row), output
    assert (tmp_path / "loop/nothing/adapted/adapt.html").exists()
    assert run("examples/loop_study.py", *short).splitlines()[-1] == row


def test_the_bench_of_the_client_measures() -> None:
    rows = json.loads(run("benches/client.py", "--envs", "8", "--seconds", "0.2", "--json"))
    assert rows[0]["envs"] == 8
    assert rows[0]["env_steps_per_second"] > 0


def run_cell(source: str, names: dict[str, object]) -> str:
    """Runs a cell; returns what a notebook shows of its last expression, unless the cell ends with a semicolon."""
    tree = ast.parse(source)
    last = tree.body[-1] if tree.body and not source.rstrip().endswith(";") else None
    if isinstance(last, ast.Expr):
        tree.body.pop()
    exec(compile(tree, "docs/ten_minutes.ipynb", "exec"), names)
    if not isinstance(last, ast.Expr):
        return ""
    return repr(eval(compile(ast.Expression(last.value), "docs/ten_minutes.ipynb", "eval"), names))


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    cells = json.loads((ROOT / "docs/ten_minutes.ipynb").read_text())["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "the notebook is kept without outputs"
            shown = run_cell("".join(cell["source"]), names)
            assert not re.search(r" at 0x[0-9a-f]+>", shown), f"the cell shows {shown}"
    assert "inertial_drag" in names["report"].summary  # type: ignore[attr-defined]
