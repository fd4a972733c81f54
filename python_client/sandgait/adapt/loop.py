"""From a robot's log to a policy that was trained on over what the log says, and the gain that this predicts."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Refused, read_policy

from .. import logs
from ..command_line import failure, nine_commands
from ..training import train
from .posterior import Draw, Posterior, posterior
from .servo import motors

#: Standard deviation of the sand's coefficients for the diagnosis, relative: our choice, small, because the training's
#: sand is an assumption: if the robot's sand is weaker, this shall be named and not be taken for scatter.
COEFFICIENT_SD = 0.05

#: Worlds from the posterior in which both policies are evaluated: our choice; the interval of their mean is Student's.
DRAWS = 8
#: 97.5 % quantile of Student's distribution with DRAWS − 1 degrees of freedom (Abramowitz & Stegun 1972, table 26.10).
_STUDENT = 2.365

#: A gain that is worth a training: part of the command. Our choice: trainings with other seeds differ by this much
#: (docs/robots.md: mean errors of 3 to 6 %).
WORTH = 0.03


@dataclass(frozen=True)
class Request:
    """What is asked. `medium`: the sand that the training assumed; None: that of the policy."""

    log: Path
    policy: Path
    robot: Path
    out: Path
    medium: str | None = None
    coefficient_sd: float = COEFFICIENT_SD
    seconds: float = 300.0
    timesteps: int | None = None
    settings: tuple[tuple[str, Any], ...] = ()
    seed: int = 0


@dataclass(frozen=True)
class Gain:
    """Mean errors of the nine commands before and after, one for each world; falls count as errors of 100 %."""

    before: tuple[float, ...]
    after: tuple[float, ...]

    @property
    def mean(self) -> float:
        return float(np.mean(np.subtract(self.before, self.after)))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean over worlds of the posterior."""
        change = np.subtract(self.before, self.after)
        half = _STUDENT * float(change.std(ddof=1)) / math.sqrt(len(change))
        return self.mean - half, self.mean + half


@dataclass(frozen=True)
class Adaptation:
    """The result: what the log says, and what changed."""

    request: Request
    found: Posterior
    #: Mean error of the present policy in the training's world and in that of the log; None: the log does not tell.
    present: tuple[float, float] | None
    #: None: nothing was trained.
    gain: Gain | None
    #: Why nothing changed, or why the new policy should not be used; empty: use it.
    reason: str

    @property
    def adapted(self) -> bool:
        return not self.reason


def adapt(request: Request, told: Callable[[str], None] = lambda _: None) -> Adaptation:
    """Diagnoses the log; trains the policy on if the log tells what differs and this costs the policy something;
    evaluates both policies over the posterior. Raises Refused if something cannot be used."""
    policy = read_policy(request.policy)
    medium = request.medium or str(policy.trained_with["ground"])
    if medium in ("rigid", "mixed", "dunes"):
        raise Refused(f"medium: the policy was trained on {medium}; say on which sand the robot walked: --medium")
    weights = policy.folder / "policy.safetensors"
    if not weights.is_file():
        raise Refused(f"{weights}: there is no such file; give the whole folder that sandgait train wrote")
    if request.out.exists() and any(request.out.iterdir()):
        raise Refused(f"{request.out}: is not empty; give another folder with --out")
    told("the diagnosis of the log")
    with tempfile.TemporaryDirectory() as place:
        made = diagnose(request, medium, Path(place))
        found = posterior(made, motors(request.log, policy))
        shutil.copytree(made, request.out / "diagnosis", dirs_exist_ok=True)
    (request.out / "diagnosis" / "hardware.toml").write_text(found.best.hardware, encoding="utf-8")
    if not found.tells:
        return Adaptation(request, found, None, None, _untold(found))
    told("the present policy in the world of the log")
    present = _error(policy.folder, None), _error(policy.folder, found.best)
    if present[1] - present[0] < WORTH:
        reason = (
            f"nothing to gain: in the log's world the policy's mean error is {present[1]:.1%}, in the training's "
            f"{present[0]:.1%}"
        )
        return Adaptation(request, found, present, None, reason)
    new = _train(request, found, weights, told)
    before, after = [], []
    for k, draw in enumerate(found.draws(DRAWS, request.seed)):
        told(f"evaluation: world {k + 1} of {DRAWS}")
        before.append(_error(policy.folder, draw))
        after.append(_error(new, draw))
    gain = Gain(tuple(before), tuple(after))
    reason = "" if gain.interval[0] > 0.0 else "the training did not help: the interval of its gain reaches 0"
    return Adaptation(request, found, present, gain, reason)


def diagnose(request: Request, medium: str, place: Path) -> Path:
    """Diagnoses the log by `sandgait diagnose`, which reads robots from files; returns the folder of its results."""
    experiment, out, log = place / "experiment.toml", place / "diagnosis", request.log
    experiment.write_text(
        f'kind = "trajectory"\nrobot = {json.dumps(str(request.robot.resolve()))}\nmedium = {json.dumps(medium)}\n'
        f"coefficient_sd = {request.coefficient_sd!r}\n"
    )
    if logs.kind(log) is not None:
        log = place / "log.csv"
        log.write_bytes(logs.to_csv(request.log))
    said = failure("diagnose", str(log), "--experiment", str(experiment), "--out", str(out))
    if said is not None:
        raise Refused((said or "the diagnosis says nothing").removeprefix("sandgait: "))
    return out


def _untold(found: Posterior) -> str:
    said = {
        "noise_floor": "the log does not differ from the training's world beyond its scatter: nothing to adapt to",
        "ambiguous": "the log cannot tell which of several causes it is",
        "insufficient_data": "the log has too few strides",
        "none_of_these": "the log differs from the training's world, but no known cause explains it",
    }
    return said.get(found.verdict, "the log names no cause") + (f"; log next: {found.next}" if found.next else "")


def _train(request: Request, found: Posterior, weights: Path, told: Callable[[str], None]) -> Path:
    """Trains on from the policy's weights in the diagnosed sand, with motors and sensors from their intervals."""
    settings = json.loads((request.policy / "settings.json").read_bytes())
    options = dict(settings["options"])
    drawn = dict(options.get("domain_rand") or {})
    new = request.out / "policy"
    texts = request.out / "diagnosis"
    if "interval" in found.best.hardware:
        drawn["hardware"] = str(texts / "hardware.toml")
    options |= {"sand": str(texts / "sand.toml"), "domain_rand": drawn}
    options["curriculum"] = {**(options.get("curriculum") or {}), "level": 1.0}  # it walks already
    told("training")
    train(
        settings["task"],
        out=new,
        seed=request.seed,
        seconds=None if request.timesteps else request.seconds,
        timesteps=request.timesteps,
        settings=dict(request.settings),
        start_from=weights,
        progress=False,
        **options,
    )
    return new


def _error(folder: Path, draw: Draw | None) -> float:
    """Mean error of the nine commands in a world; None: that of the policy's training."""
    with tempfile.TemporaryDirectory() as place:
        sand, hardware, options = Path(place) / "sand.toml", Path(place) / "hardware.toml", []
        if draw is not None:
            sand.write_text(draw.sand)
            options.append(f"sand={sand}")
            if "interval" in draw.hardware:
                hardware.write_text(draw.hardware)
                options.append(f"hardware={hardware}")
        lines = nine_commands(folder / "policy.onnx", *options)
    return float(np.mean([1.0 if line["falls"] > 0 else line["error"] for line in lines]))
