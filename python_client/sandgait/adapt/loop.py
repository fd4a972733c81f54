"""From a robot's log to a policy that was trained on over what the log says, and the gain that this predicts."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Policy, Refused, read_policy

from .. import logs, notebook
from ..command_line import check_folder, failure, nine_commands
from ..errors import InvalidRequest
from ..grounds import KINDS, sand_toml
from ..policies import trained
from ..training import train
from .posterior import Posterior, World, posterior
from .servo import action_delay, motors
from .tracking import Followed, compared, error_of, followed
from .walks import explained

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

#: Error that a new policy may add in one of the posterior's worlds, part of the command: our choice, the most by which
#: trainings with other seeds differ (docs/robots_results.md).
LOSS = 0.05

#: Rounds over the members of an uncertain diagnosis: our choice, so that no member is trained only at the beginning.
ROUNDS = 3

#: Settings with which training goes on, because the policy walks already: it does not imitate a plain gait again, and
#: the learning rate is a third of that of a new policy, which is our choice.
_GOING_ON = {"learning_rate": "lin_3e-4", "gait_prior": 0}

#: What is to be logged if a report proposes nothing.
_MORE = "walks with at least three commands, each for at least six strides and twice, with torques and accelerometer"

#: What is to be measured if a robot follows its commands badly and its log does not say why.
_SAND = "no walk, but pushes of a plate into the sand (sandgait calibrate), and weigh the robot"


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
    #: Error of the log's commands on the robot, over that of the simulated robot; None: the log lacks velocities.
    ratio: float | None = None

    @property
    def mean(self) -> float:
        return float(np.mean(np.subtract(self.before, self.after)))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the gain of one robot, one of the posterior's worlds. Where the simulated errors are
        wrong by a factor, the gain may be, in either direction: our choice, because no theory says how they relate."""
        change = np.subtract(self.before, self.after)
        half = _STUDENT * float(change.std(ddof=1)) * math.sqrt(1.0 + 1.0 / len(change))
        factor = 1.0 if self.ratio is None else max(self.ratio, 1.0 / max(self.ratio, WORTH))
        ends = sorted((self.mean / factor, self.mean * factor))
        return ends[0] - half, ends[1] + half

    @property
    def doubt(self) -> str:
        """Why the new policy should not be used; empty: its mean gain is above 0 with 97.5 % confidence (Student's t),
        and in no world does it lose more than `LOSS`."""
        change = np.subtract(self.before, self.after)
        if self.mean <= _STUDENT * float(change.std(ddof=1)) / math.sqrt(len(change)):
            return "the training did not help: its mean gain is within its error"
        if change.min() < -LOSS:
            return f"the training may harm: in one of the worlds the error rises by {-change.min():.1%}"
        return ""


@dataclass(frozen=True)
class Adaptation:
    """The result: what the log says, and what changed."""

    request: Request
    found: Posterior
    #: Mean error of the present policy in the training's world and in that of the log; None: the log does not tell.
    present: tuple[float, float] | None
    #: Mean error of the log's commands on the robot, and in the simulated world that the log shows; None: the log lacks
    #: commands or velocities.
    tracked: tuple[float, float] | None
    #: None: nothing was trained.
    gain: Gain | None
    #: Why nothing changed, or why the new policy should not be used; empty: use it.
    reason: str

    @property
    def adapted(self) -> bool:
        return not self.reason

    def _repr_html_(self) -> str:
        """The verdict, and what led to it."""
        from .page import summary  # not above, because that module imports this one

        *lines, said = summary(self)
        return notebook.title(said) + "".join(map(notebook.paragraph, lines))


def adapt(request: Request, told: Callable[[str], None] = lambda _: None) -> Adaptation:
    """Diagnoses the log; trains the policy on if the log tells what differs and this costs the policy something;
    evaluates both policies over the posterior. Raises Refused if something cannot be used."""
    policy = read_policy(request.policy)
    learnt = trained(policy.folder / "settings.json")[1]
    medium = _medium(request, policy, learnt)
    check_folder(request.out)
    found = _look(request, policy, medium, told)
    request.out.mkdir(parents=True, exist_ok=True)
    logged = followed(request.log, policy)
    walks = cache(lambda world: _lines(policy.folder, world, learnt))
    found = _walked(policy, (medium, str(learnt.get("law") or "li2013")), found, logged, walks, told)
    if not found.tells:
        tracked = compared(logged, walks(World())) if logged else None
        return Adaptation(request, found, None, tracked, None, _untold(found, tracked))
    if found.best.hardware:
        (request.out / "hardware.toml").write_text(found.best.hardware, encoding="utf-8")
    told("the present policy in the world of the log")
    worlds = [found.world(member, None) for member in found.trained] or [found.best]
    there = [walks(world) for world in worlds]
    weights = [member.weight for member in found.trained] or [1.0]
    present = _mean(walks(World())), float(np.average([_mean(x) for x in there], weights=weights))
    tracked = compared(logged, there[0]) if logged else None
    if present[1] - present[0] < WORTH:
        reason = (
            f"nothing to gain: in the log's world the policy's mean error is {present[1]:.1%}, in the training's "
            f"{present[0]:.1%}"
        )
        return Adaptation(request, found, present, tracked, None, reason)
    if not (policy.folder / "policy.safetensors").is_file():
        reason = (
            f"there is something to gain, but {policy.folder / 'policy.safetensors'} is missing, from which training "
            "goes on: give the whole folder that sandgait train wrote"
        )
        return Adaptation(request, found, present, tracked, None, reason)
    new = _train(request, found, told)
    before, after = [], []
    for k, world in enumerate(found.draws(DRAWS, request.seed)):
        told(f"evaluation: world {k + 1} of {DRAWS}")
        before.append(_error(policy.folder, world, learnt))
        after.append(_error(new, world, learnt))
    gain = Gain(tuple(before), tuple(after), None if tracked is None else tracked[0] / max(tracked[1], WORTH))
    return Adaptation(request, found, present, tracked, gain, gain.doubt)


def _medium(request: Request, policy: Policy, learnt: Mapping[str, Any]) -> str:
    """The sand that the training assumed: "rigid", a name, or the text of a sand.toml."""
    medium = request.medium or str(policy.trained_with["ground"])
    if request.medium is None and medium != "rigid" and learnt.get("sand"):
        return str(learnt["sand"])
    if medium in KINDS:
        raise Refused(f"medium: the policy was trained on {medium}; say on which sand the robot walked: --medium")
    return medium


def _look(request: Request, policy: Policy, medium: str, told: Callable[[str], None]) -> Posterior:
    """What the log says. On hard ground there is no sand to diagnose, so only the motors are compared."""
    if medium == "rigid":
        told("the motors of the log")
        if not request.log.is_file():
            raise Refused(f"{request.log}: there is no such file")
        said = "on hard ground only the motors are compared with the training's"
        fitted = motors(request.log, policy)
        delay = action_delay(fitted, policy)
        return Posterior("rigid", said, (), "", 'source = "sandgait adapt"\n', "", motors=fitted, delay=delay)
    told("the diagnosis of the log")
    with tempfile.TemporaryDirectory() as place:
        made = diagnose(request, medium, Path(place))
        fitted = motors(request.log, policy)
        found = posterior(made, fitted, action_delay(fitted, policy))
        shutil.copytree(made, request.out / "diagnosis", dirs_exist_ok=True)
    return found


def _walked(
    policy: Policy,
    sand: tuple[str, str],
    found: Posterior,
    logged: list[Followed],
    walks: Callable[[World], list[dict[str, Any]]],
    told: Callable[[str], None],
) -> Posterior:
    """`found`, and if it names no cause and the robot follows its commands worse than the simulated one, what its walks
    say of sand and payload. `sand`: medium and law of the training; `walks`: the nine commands of the present policy in
    a world."""
    if found.members or not logged:
        return found
    tracked = compared(logged, walks(found.best))
    if tracked[0] - tracked[1] < WORTH:
        return found
    told("the policy on other sands, and with payloads")
    try:
        base = "" if sand[0] == "rigid" else sand_toml(*sand)
    except InvalidRequest:  # zeta=VALUE and mu=VALUE,rho=VALUE
        untried = f"other sands were not tried, because {sand[0]} is no table of coefficients"
        base, found = "", replace(found, summary=f"{found.summary.rstrip('.')}; {untried}")
    said = explained(found, logged, base, float(policy.robot["mass"]), walks)
    return found if said is None else replace(said, next=f"{_SAND}, to tell what the walks do not")


def diagnose(request: Request, medium: str, place: Path) -> Path:
    """Diagnoses the log by `sandgait diagnose`, which reads robots from files; returns the folder of its results."""
    experiment, out, log = place / "experiment.toml", place / "diagnosis", request.log
    if "\n" in medium:
        (place / "medium.toml").write_text(medium, encoding="utf-8")
        medium = "medium.toml"
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


def _untold(found: Posterior, tracked: tuple[float, float] | None) -> str:
    """Why nothing changes, and what to log next."""
    said = {
        "noise_floor": "the log does not differ from the training's world beyond its scatter: nothing to adapt to",
        "insufficient_data": "the log has too few strides",
        "none_of_these": "the log differs from the training's world, but no known cause explains it",
        "rigid": "the motors give the torque that their servos demand, or the log does not have targets and torques",
    }
    reason = said.get(found.verdict, "the log names no cause")
    unseen = tracked is not None and tracked[0] - tracked[1] >= WORTH
    if unseen and tracked is not None:
        reason += (
            f"; but the robot follows the log's commands with an error of {tracked[0]:.1%}, the simulated one with "
            f"{tracked[1]:.1%}, so something differs that joints and IMU do not show, and no other world that was "
            "tried explains its walks"
        )
    more = found.next or (_MORE if found.verdict in ("insufficient_data", "none_of_these") else _SAND if unseen else "")
    return reason + (f"; log next: {more}" if more else "")


def _train(request: Request, found: Posterior, told: Callable[[str], None]) -> Path:
    """Trains on from the policy's weights. An uncertain diagnosis has a stage for each member in each round, as long as
    the member is probable; the last stage is in the most probable world. Returns the new policy's folder."""
    if len(found.trained) < 2:
        return _stage(request, found.best, request.policy, request.out / "policy", 1.0, told)
    random = np.random.default_rng(request.seed)
    total = sum(member.weight for member in found.trained)
    stages = [
        (found.world(member, None if last and member is found.trained[0] else random), member.weight / total / ROUNDS)
        for last in (False,) * (ROUNDS - 1) + (True,)
        for member in reversed(found.trained)
    ]
    present = request.policy
    with tempfile.TemporaryDirectory(dir=request.out) as place:
        for k, (world, share) in enumerate(stages):
            told(f"stage {k + 1} of {len(stages)}")
            present = _stage(request, world, present, Path(place) / str(k), share, told)
        shutil.move(present, request.out / "policy")
    return request.out / "policy"


def _stage(request: Request, world: World, before: Path, new: Path, share: float, told: Callable[[str], None]) -> Path:
    """Trains the policy in the folder `before` on in a world, for a share of the request's steps or time."""
    settings = json.loads((request.policy / "settings.json").read_bytes())
    options = {**settings["options"], **world.options(settings["options"])}
    if world.hardware:  # each episode draws from its intervals
        options["domain_rand"] = {**(options.get("domain_rand") or {}), "hardware": world.hardware}
        options["hardware"] = settings["options"].get("hardware") or ""
    options["curriculum"] = {**(options.get("curriculum") or {}), "level": 1.0}  # it walks already
    told("training")
    train(
        settings["task"],
        out=new,
        seed=request.seed,
        seconds=None if request.timesteps else share * request.seconds,
        timesteps=max(1, round(share * request.timesteps)) if request.timesteps else None,
        # The networks must be those of the training.
        settings={**settings.get("hyperparameters", {}), **_GOING_ON, **dict(request.settings)},
        start_from=before / "policy.safetensors",
        progress=False,
        **options,
    )
    return new


def _lines(folder: Path, world: World, learnt: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The nine commands in a world, for a policy that was trained with the options `learnt`."""
    return nine_commands(folder / "policy.onnx", world.options(learnt))


def _error(folder: Path, world: World, learnt: Mapping[str, Any]) -> float:
    return _mean(_lines(folder, world, learnt))


def _mean(lines: list[dict[str, Any]]) -> float:
    return float(np.mean([error_of(line) for line in lines]))
