"""Studies from Python: the same numbers and errors as on the command line, and an end when they are interrupted."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest

import sandgait
from conftest import HEARS_CTRL_C, LONG, RemoteServer
from sandgait import logs, notebook, server

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DATA = Path(__file__).parents[2] / "examples/data"
LOG, EXPERIMENT = DATA / "force_log.csv", DATA / "force_log.toml"

TABLES: dict[str, Any] = {
    "kind": "intrusion",
    "medium": "poppy-loose",
    "bulk_density": 640,
    "coefficient_sd": 0.08,
    "shape": {
        name: {"type": "leg", "chord": 0.076, "width": 0.025, "xi_deg": xi}
        for name, xi in (("L", 45), ("revL", -45.0), ("flat", np.float64(0.0)))
    },
}

#: A study that takes minutes.
MINUTES = {"xi": np.arange(-75, 75, 0.5), "frequency": np.linspace(1, 4, 300)}


def command(*arguments: str | Path) -> str:
    run = [*server.command(), *map(str, arguments)]
    return subprocess.run(run, capture_output=True, text=True, check=True).stdout


def rows(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as file:
        return {column[0]: list(column[1:]) for column in zip(*csv.reader(file), strict=True)}


def close(ours: Any, texts: list[str], digits: int = 6) -> None:
    assert len(ours) == len(texts)
    assert np.allclose(ours, [float(t) for t in texts], rtol=0, atol=0.51 * 10.0**-digits, equal_nan=True)


@pytest.fixture(scope="module")
def diagnosis() -> sandgait.Diagnosis:
    return sandgait.diagnose(LOG, EXPERIMENT, progress=False)


@pytest.fixture(autouse=True)
def _no_figures() -> Any:
    yield
    plt.close("all")


@pytest.mark.parametrize(
    "options",
    [
        {"shape": "L"},
        {"shape": "xi=-30", "medium": "quikrete-fine", "hip_height": 0.01, "omega": -3.0},
        {"shape": "revC", "chord": 0.05, "width": 0.03, "law": "agarwal2023", "medium": "poppy-close"},
    ],
)
def test_intrude_is_the_command(options: dict[str, Any], tmp_path: Path) -> None:
    words = [f"--{name.replace('_', '-')}={value}" for name, value in options.items()]
    command("intrude", *words, "--csv", tmp_path / "f.csv")
    forces, theirs = sandgait.intrude(**options), rows(tmp_path / "f.csv")
    assert list(forces) == list(theirs) == ["theta", "Fx", "Fz", "Ty"]
    close(forces.theta, theirs["theta"], 12)
    close(forces.Fx, theirs["Fx"])
    close(forces.Fz, theirs["Fz"])
    close(forces.Ty, theirs["Ty"], 8)
    assert forces.units == {"theta": "rad", "Fx": "N", "Fz": "N", "Ty": "N·m"}


WHEELS = Path(__file__).parents[1] / "data/real_wheel"
MOTIONS = {
    "vx": [0.01, 0.01, 0.0, 0.01],
    "vy": [0.0, -0.005, 0.01, 0.0],
    "vz": -0.001,
    "wy": [0.16, 0.1, 0.0, 1.6],
    "depth": [0.01, np.nan, 0.02, np.nan],
    "load": [np.nan, 20.0, np.nan, 1e5],
}
SPHERE = "sphere:radius=0.1"
BOX = """solid box
{}
endsolid box
"""


def box_file(path: Path) -> Path:
    """A box of 4 × 3 × 2 cm as STL."""
    corners = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (-0.015, 0.015) for z in (-0.01, 0.01)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    facets = []
    for a, b, c, d in quads:
        for triangle in ((a, b, c), (a, c, d)):
            loop = "\n".join("vertex {} {} {}".format(*corners[k]) for k in triangle)
            facets.append(f"facet normal 0 0 0\nouter loop\n{loop}\nendloop\nendfacet")
    path.write_text(BOX.format("\n".join(facets)))
    return path


def test_trials_are_the_command(tmp_path: Path) -> None:
    frame = pd.DataFrame(MOTIONS)
    frame.to_csv(tmp_path / "rows.csv", index=False)
    sand = WHEELS / "sand_discs.toml"
    # A load of 20 N buries the small box.
    bodies: dict[str | Path, str] = {
        "cylinder:radius=0.0625,width=0.06": "ok",
        box_file(tmp_path / "box.stl"): "no_equilibrium",
    }
    for body, under_load in bodies.items():
        options: dict[str, Any] = {"sand": sand, "mu_s": 0.3, "plate_size": 0.004}
        ours = sandgait.intrude(body=body, rows=MOTIONS, **options)
        words = [f"--body={body}", f"--sand={sand}", "--mu-s=0.3", "--plate-size=0.004"]
        command("intrude", *words, "--trials", tmp_path / "rows.csv", "--csv", tmp_path / "f.csv")
        theirs = pd.read_csv(tmp_path / "f.csv")
        for name, digits in (("Fx", 6), ("Fy", 6), ("Fz", 6), ("Tx", 8), ("Ty", 8), ("Tz", 8), ("depth", 8)):
            expected = theirs[name].to_numpy()
            assert np.array_equal(np.isnan(ours[name]), np.isnan(expected))
            assert np.nanmax(np.abs(ours[name] - expected)) <= 0.6 * 10.0**-digits, name
        assert ours.status.tolist() == theirs["status"].tolist() == ["ok", under_load, "ok", "no_equilibrium"]
        assert under_load != "ok" or abs(ours.force[1, 2] - 20.0) < 1e-3
        assert ours.depth[0] == 0.01
        assert ours.units["Tx"] == "N·m"
        same = sandgait.intrude(body=body, rows=frame, **options)
        assert list(same) == ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz", "depth", "status"]
        assert all(np.array_equal(ours[name], same[name], equal_nan=name != "status") for name in ours)


def test_trials_release_the_interpreters_lock() -> None:
    """Another thread of Python runs during the computation."""
    ticks = [0]
    done = threading.Event()

    def tick() -> None:
        while not done.wait(0.001):
            ticks[0] += 1

    thread = threading.Thread(target=tick)
    told: list[float] = []
    rows = {"vx": np.full(8000, 0.01), "load": 20.0}
    thread.start()
    sandgait.intrude(body="cylinder:radius=0.06,width=0.06", rows=rows, progress=lambda share, _: told.append(share))
    done.set()
    thread.join()
    assert ticks[0] > 20
    assert told == sorted(told)
    assert len(told) > 1


def test_walk_is_the_command() -> None:
    walks = sandgait.walk([2.0, -1.5, 0.0], leg="revC", medium="zeta=0.4", slope_deg=-5, dt=2.5e-4)
    for k, frequency in enumerate(walks.frequency):
        words = ["--leg=revC", "--medium=zeta=0.4", "--slope-deg=-5", "--dt=2.5e-4", f"--frequency={frequency}"]
        theirs = json.loads(command("walk", *words, "--json"))
        for name in walks:
            ours = walks[name][k]
            assert ours == theirs[name] if theirs[name] is not None else np.isnan(ours), name
    assert sandgait.walk(2).speed == json.loads(command("walk", "--frequency=2", "--json"))["speed"]
    by_rapier = json.loads(command("walk", "--frequency=2", "--engine=rapier", "--json"))["speed"]
    assert sandgait.walk(2, engine="rapier").speed == by_rapier


def test_sweep_is_the_command(tmp_path: Path) -> None:
    ours = sandgait.sweep(
        {"leg": ["L", "C"], "frequency": [1, 2.5]}, set={"leg_mass": 0.003}, medium="poppy-close", progress=False
    )
    words = ["--vary=leg=L,C", "--vary=frequency=1,2.5", "--set=leg-mass=0.003", "--medium=poppy-close"]
    command("sweep", *words, "--out", tmp_path)
    theirs = rows(tmp_path / "sweep.csv")
    assert ours["leg"].tolist() == theirs["leg"]
    assert ours.parameters == ("leg", "frequency")
    assert list(ours) == list(theirs)
    for name in ours:
        if name != "leg":
            close(ours[name], theirs[name], 12)
    best = ours.best()
    assert best["speed"] == ours.speed.max()
    assert best["frequency"] == 2.5
    assert ours.best("cost-of-transport")["cost_of_transport"] == ours.cost_of_transport.min()


def test_a_search_is_the_command(tmp_path: Path) -> None:
    ours = sandgait.sweep({"xi": [0, 75]}, optimize="cost-of-transport", progress=False)
    command("sweep", "--vary=xi=0:75:2", "--optimize=cost-of-transport", "--out", tmp_path)
    theirs = rows(tmp_path / "optimum.csv")
    close(ours["xi"], theirs["xi"], 12)
    close(ours.cost_of_transport, theirs["cost_of_transport"], 12)
    assert ours.measure == "cost-of-transport"


def test_diagnose_is_the_command(diagnosis: sandgait.Diagnosis, tmp_path: Path) -> None:
    command("diagnose", LOG, "--experiment", EXPERIMENT, "--out", tmp_path / "theirs")
    diagnosis.save(tmp_path / "ours")
    for name in ("report.json", "report.html", "sand.toml"):
        assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes(), name
    assert diagnosis.verdict == "named"
    assert diagnosis.causes[0]["id"] == "inertial_drag"
    assert diagnosis.headline in repr(diagnosis)


def test_data_frames_and_tables_replace_files(diagnosis: sandgait.Diagnosis) -> None:
    told: list[tuple[float, str]] = []
    other = sandgait.diagnose(pd.read_csv(LOG), TABLES, progress=lambda share, stage: told.append((share, stage)))
    for name in ("verdict", "causes", "gain", "candidates"):
        assert other.report[name] == diagnosis.report[name]
    shares = [share for share, _ in told]
    assert len(told) > 4
    assert shares == sorted(shares)
    assert all(stage for _, stage in told)


WALK = Path(__file__).parents[1] / "data/trajectory"


class Taken(Exception):
    """The data have been read, and their diagnosis begins."""


def taken(data: Any, experiment: Any) -> None:
    """A diagnosis that ends after it has read the data."""

    def told(_share: float, stage: str) -> None:
        if "reading" not in stage:
            raise Taken

    with pytest.raises(Taken):
        sandgait.diagnose(data, experiment, progress=told)


def test_a_robots_own_log_in_each_format(diagnosis: sandgait.Diagnosis, tmp_path: Path) -> None:
    """Recordings give the table of which docs/diagnosis_files.md and a test of the command make a whole diagnosis."""
    experiment = tomllib.loads((WALK / "walk_mcap.toml").read_text())
    taken(WALK / "walk.mcap", experiment)
    # What was found is given to the next diagnosis.
    diagnosis.save(tmp_path / "found")
    hardware = tmp_path / "hardware.toml"
    hardware.write_text('source = "a test"\n[actuator.torque_constant]\nvalue = 0.96\ninterval = [0.95, 0.97]\n')
    given = {"medium": str(tmp_path / "found/sand.toml"), "hardware": str(hardware)}
    taken(WALK / "walk.mcap", {**experiment, **given})
    # The report is a function of the table.
    parquet = pd.read_csv(io.BytesIO(logs.to_csv(WALK / "walk.parquet")))
    assert parquet.equals(pd.read_csv(WALK / "walk.csv"))
    if LONG:
        whole_diagnoses_of_a_robots_own_log(experiment, tmp_path)


def whole_diagnoses_of_a_robots_own_log(experiment: dict[str, Any], tmp_path: Path) -> None:
    mcap = sandgait.diagnose(WALK / "walk.mcap", experiment, progress=False)
    table = tmp_path / "walk.csv"
    table.write_bytes(logs.to_csv(WALK / "walk.mcap"))
    command("diagnose", table, "--experiment", WALK / "walk_mcap.toml", "--out", tmp_path)
    assert mcap.report_json == (tmp_path / "report.json").read_text()
    assert (mcap.verdict, [cause["id"] for cause in mcap.causes]) == ("named", ["inertial_drag"])
    # With what was found, nothing more is.
    given = {"medium": str(tmp_path / "sand.toml"), "hardware": str(tmp_path / "hardware.toml")}
    again = sandgait.diagnose(WALK / "walk.mcap", {**experiment, **given}, progress=False)
    assert again.verdict in ("noise_floor", "recalibrated")


def test_curves_contain_the_data(diagnosis: sandgait.Diagnosis) -> None:
    log, frame = pd.read_csv(LOG), diagnosis.to_frame()
    assert len(frame) == len(log)
    assert frame.attrs["units"]["Fz"] == "N"
    for name in ("Fx", "Fz", "Ty"):
        assert sorted(frame[name]) == sorted(log[name])
    plain = np.square(frame["Fx"] - frame["Fx_plain"]).mean()
    assert np.square(frame["Fx"] - frame["Fx_extended"]).mean() < plain


def test_the_diagnosed_sand_goes_into_every_study(diagnosis: sandgait.Diagnosis, tmp_path: Path) -> None:
    diagnosis.save(tmp_path)
    sand = tmp_path / "sand.toml"
    command("intrude", "--shape=L", "--omega=10", "--sand", sand, "--csv", tmp_path / "f.csv")
    forces = sandgait.intrude("L", omega=10, sand=sand)
    close(forces.Fz, rows(tmp_path / "f.csv")["Fz"])
    assert forces.Fz.max() != sandgait.intrude("L", omega=10).Fz.max()
    speed = sandgait.walk(4, sand=sand).speed[0]
    assert speed == json.loads(command("walk", "--frequency=4", "--sand", sand, "--json"))["speed"]
    assert sandgait.sweep({"frequency": [4]}, sand=sand, progress=False).speed[0] == speed


def test_a_robot_file_of_the_client(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "src/sim/robots/xplorer.toml").read_text()
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("mass = 0.138", "mass = 0.2"))
    speed = sandgait.walk(2, robot=str(path)).speed[0]
    assert speed != sandgait.walk(2).speed[0]
    assert speed == json.loads(command("walk", "--frequency=2", "--robot", path, "--json"))["speed"]


def test_another_server(remote: RemoteServer) -> None:
    assert sandgait.walk(2, address=remote.address).speed == sandgait.walk(2).speed
    assert np.array_equal(sandgait.intrude("C", address=remote.address).Fz, sandgait.intrude("C").Fz)
    with pytest.raises(sandgait.ServerLost):
        sandgait.intrude("C", address="127.0.0.1:1")


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: sandgait.intrude("Q"), 'leg shape "Q" is unknown; known: L, revL'),
        (lambda: sandgait.intrude("L", width=-1), r"width: -1 is outside \[0.0001, 10\]"),
        (lambda: sandgait.intrude("L", medium="moon"), "moon"),
        (lambda: sandgait.intrude("L", sand="/no/such/sand.toml"), "/no/such/sand.toml: No such file"),
        (lambda: sandgait.intrude("L", sand=LOG), r"force_log.csv: sand"),
        (
            lambda: sandgait.intrude("L", medium="poppy-loose", sand=EXPERIMENT),
            "cannot be given with",
        ),
        (lambda: sandgait.intrude("L", body="sphere:radius=0.1", rows={"depth": 0}), "cannot be given with"),
        (lambda: sandgait.intrude(body="sphere:radius=0.1"), "rows: missing"),
        (lambda: sandgait.intrude(), "shape: missing"),
        (lambda: sandgait.intrude(body="ball:radius=1", rows={"depth": 0.1}), 'body "ball:radius=1" is unknown'),
        (lambda: sandgait.intrude(body="nowhere.stl", rows={"depth": 0.1}), "nowhere.stl: No such file"),
        (
            lambda: sandgait.intrude(body=SPHERE, rows={"deep": 0.1}),
            'rows: column "deep" is unknown; did you mean "depth"',
        ),
        (lambda: sandgait.intrude(body=SPHERE, rows={"vx": 0.1}), "trial 1: neither depth nor load is given"),
        (lambda: sandgait.intrude(body=SPHERE, rows={"depth": [0, 1], "vx": [1, 2, 3]}), "rows: "),
        (lambda: sandgait.intrude(body=SPHERE, rows={"depth": [0.01, np.inf]}), "trial 2: depth"),
        (lambda: sandgait.intrude(body=SPHERE, rows={"depth": []}), "number of rows: 0"),
        (lambda: sandgait.intrude(body=SPHERE, rows={"depth": 0.1}, mu_s=-1), "mu-s: -1"),
        (lambda: sandgait.intrude(body=SPHERE, rows={"depth": 0.1}, plate_size=1e-5), "plate-size"),
        (lambda: sandgait.walk([1, 30]), r"frequency: 30 is outside \[-20, 20\]"),
        (lambda: sandgait.walk([]), "number of frequencies: 0"),
        (lambda: sandgait.walk(2, legg="C"), "unexpected keyword argument 'legg'; did you mean 'leg'"),
        (lambda: sandgait.walk(1, robot="tank"), 'robot "tank" is unknown'),
        (lambda: sandgait.walk(1, address="nowhere"), "address"),
        (lambda: sandgait.sweep({"mood": [1]}), 'parameter "mood" is unknown'),
        (lambda: sandgait.sweep({"xi": [1, 95]}), "xi_deg: 95"),
        (lambda: sandgait.sweep({"width": [0.01, "wide"]}), "width: .*neither all numbers nor all names"),
        (lambda: sandgait.sweep({"xi": []}), "xi: number of values: 0 is outside"),
        (lambda: sandgait.sweep({"xi": [1], "kp": [1], "chord": [0.04]}), "vary: a grid takes one or two"),
        (lambda: sandgait.sweep({"xi": [1]}, measure="joy"), 'measure "joy" is unknown'),
        (lambda: sandgait.sweep({"xi": [1]}, set={"kp": -1}), "kp: -1 is outside"),
        (lambda: sandgait.diagnose("nowhere.csv", EXPERIMENT), "nowhere.csv: No such file"),
        (lambda: sandgait.diagnose(LOG, "nowhere.toml"), "nowhere.toml: No such file"),
        (lambda: sandgait.diagnose(LOG, {"kind": "digging"}), "experiment: .*digging"),
        (lambda: sandgait.diagnose(LOG, {**TABLES, "mood": 1}), "experiment: .*mood"),
        (lambda: sandgait.diagnose(pd.DataFrame({"trial": [1]}), EXPERIMENT), "data: "),
        (lambda: sandgait.diagnose(EXPERIMENT, EXPERIMENT), "force_log.toml: "),
        (lambda: sandgait.diagnose(WALK / "walk.csv", WALK / "walk_mcap.toml"), "column run: .* lists .*run.* too"),
        (lambda: sandgait.diagnose(WALK / "walk.mcap", WALK / "walk.toml"), "walk.mcap: run 1: .*two runs"),
        (lambda: sandgait.diagnose(WALK / "walk.parquet", EXPERIMENT), "walk.parquet: row 1, column t"),
    ],
)
def test_wrong_use(call: Any, says: str) -> None:
    with pytest.raises(sandgait.InvalidRequest, match=says) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_too_many_data_are_refused(remote: RemoteServer) -> None:
    class Large:
        def to_csv(self, index: bool) -> str:
            return "x" * (66 * 2**20)

    with pytest.raises(sandgait.LimitReached, match="bytes are more than this call takes"):
        sandgait.diagnose(Large(), EXPERIMENT, address=remote.address)


def test_extrapolated_sand_warns() -> None:
    with pytest.warns(UserWarning, match="extrapolated"):
        sandgait.intrude("L", medium="mu=1.3,rho=1500", law="agarwal2023")


def test_an_interrupted_study_frees_the_server() -> None:
    def interrupt(_share: float, _stage: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sandgait.sweep(MINUTES, progress=interrupt)
    with pytest.raises(KeyboardInterrupt):
        sandgait.diagnose(LOG, EXPERIMENT, progress=interrupt)
    start = time.monotonic()
    sandgait.walk(2)
    assert time.monotonic() - start < 10, "the sweep takes minutes"


def test_ctrl_c_while_a_study_computes(remote: RemoteServer) -> None:
    code = f"""
{HEARS_CTRL_C}
import numpy as np, sandgait
told = lambda share, stage: print(stage, flush=True)
try: sandgait.sweep({{"xi": np.arange(-75, 75, 0.5), "frequency": np.linspace(1, 4, 300)}},
                    address={remote.address!r}, progress=told)
except KeyboardInterrupt: print("interrupted")
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout is not None
    assert "walks" in process.stdout.readline()
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=10)[0].split()[-1] == "interrupted"
    start = time.monotonic()
    sandgait.walk(2, address=remote.address)
    assert time.monotonic() - start < 10


def test_figures_have_axes_units_and_legends(diagnosis: sandgait.Diagnosis) -> None:
    forces = sandgait.intrude("L").plot(label="L")
    assert forces.get_ylabel() == "force on the leg [N]"
    assert [t.get_text() for t in forces.get_legend().get_texts()] == ["Fx L", "Fz L"]
    assert sandgait.walk([2, 1]).plot().get_xlabel() == "stride frequency [Hz]"
    grid = sandgait.sweep({"xi": [40, -40, 0], "frequency": [1, 2]}, progress=False)
    lines = grid.plot()
    assert (lines.get_xlabel(), lines.get_ylabel()) == ("frequency [Hz]", "forward speed [cm/s]")
    assert np.array_equal(lines.lines[1].get_ydata(), 100 * grid.speed[2:4])
    # The heat map is that of the command.
    assert grid.figure.startswith("<svg")
    assert "best" not in grid.figure
    assert grid._repr_html_() == notebook.drawing(grid.figure, "speed of xi, frequency")
    lines = sandgait.sweep({"leg": ["L", "C"], "frequency": [1, 2]}, progress=False).plot("cost-of-transport")
    assert lines.get_ylabel() == "cost of transport"
    assert len(lines.get_legend().get_texts()) == 2
    figure = diagnosis.plot(["0", "1", "2"], channels=("Fx", "Fz", "Ty"))
    assert len(figure.axes) == 9
    assert figure.axes[2].get_ylabel() == "Ty [N·m]"
    with pytest.raises(sandgait.InvalidRequest, match="conditions: 'x' is not in the data"):
        diagnosis.plot(["x"])


@pytest.mark.parametrize("module", ["pandas", "matplotlib.pyplot"])
def test_without_the_extra_it_says_what_to_install(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    forces = sandgait.intrude("L")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=r"pip install 'sandgait\[plot\]'"):
        forces.to_frame() if module == "pandas" else forces.plot()


def test_importing_sandgait_imports_neither_pandas_nor_matplotlib() -> None:
    code = "import sys, sandgait; print([m for m in ('pandas', 'matplotlib', 'torch') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
