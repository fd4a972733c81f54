"""The certificate of a policy: what was tried, what held, and the verdict."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sandgait_deploy import Controller, Policy, Refused, Verification

from .. import notebook
from ..command_line import nine_commands
from ..plant import Conditions
from .causes import Cause, few, first_failure
from .grid import Case, cases
from .ground import Ground, check_sands, ground_of
from .walk import Command, Job, Line, Outcome, Wiring, all_outcomes, make_plant

#: Latency of a robot that is not stated [s]: our choice, half a control step, for a bus, a driver and a computer.
LATENCY = 0.01


@dataclass(frozen=True)
class Request:
    """What is asked: the policy's folder, the robot's file for MuJoCo, and what robot and ground are like."""

    folder: Path
    robot: Path
    ground: str | None = None
    latency: float = LATENCY
    noise: float = 1.0
    motor_strength: float = 1.0
    payload: float = 0.0
    quick: bool = False
    processes: int | None = None
    seed: int = 0
    #: How the robot is wired, for tests: errors that its program does not know of.
    wiring: Wiring = field(default_factory=Wiring)
    #: What the sheet calls the policy; empty: its folder.
    shown: str = ""


@dataclass(frozen=True)
class Certificate:
    """The result of `certify`."""

    policy: Policy
    request: Request
    ground: Ground
    verification: Verification
    #: Walks in this simulator: on the ground of the verdict, and on hard ground.
    engine: dict[str, tuple[Line, ...]]
    #: Walks in MuJoCo without imperfections, by ground.
    nominal: dict[str, Outcome]
    #: The robot as it is stated, on the ground of the verdict.
    stated: Outcome
    grid: tuple[tuple[Case, Outcome], ...]
    cause: Cause | None
    #: Why it must not be deployed; empty: deploy.
    reasons: tuple[str, ...]

    @property
    def deploy(self) -> bool:
        """The verdict."""
        return not self.reasons

    def _repr_html_(self) -> str:
        """The verdict with its reasons, and a row for each case."""
        from .sheet import verdict  # not above, because that module imports this one

        *reasons, said = verdict(self)
        names = [f"{case.what} {case.value}" for case, _ in self.grid]
        columns = {
            "case": names,
            "required": ["yes" if case.required else "no" for case, _ in self.grid],
            "holds": ["yes" if outcome.holds else "no" for _, outcome in self.grid],
            "walk": [outcome.words for _, outcome in self.grid],
        }
        cases = notebook.table(list(columns), [np.array(column, dtype=str) for column in columns.values()])
        stated = f"the robot as stated: {self.stated.words}" if self.nominal else "nothing was driven"
        return "".join([notebook.title(said), *map(notebook.paragraph, [*reasons, stated]), cases if names else ""])

    def to_json(self) -> str:
        """All numbers as JSON."""
        rows = [
            {"what": c.what, "value": c.value, "required": c.required, "holds": o.holds, "outcome": asdict(o)}
            for c, o in self.grid
        ]
        return json.dumps(
            {
                "deploy": self.deploy,
                "note": self.ground.note,
                "reasons": list(self.reasons),
                "cause": None if self.cause is None else asdict(self.cause),
                "golden": str(self.verification),
                "simulator": {ground: [asdict(line) for line in lines] for ground, lines in self.engine.items()},
                "mujoco": {ground: asdict(outcome) for ground, outcome in self.nominal.items()},
                "stated": asdict(self.stated),
                "grid": rows,
            },
            indent=1,
        )


def certify(request: Request, told: Callable[[str], None] = lambda _: None) -> Certificate:
    """Drives the robot by the policy in MuJoCo and judges it. Raises Refused if policy, robot or ground cannot be
    used."""
    controller = Controller(request.folder)
    policy = controller.policy
    ground = ground_of(policy, request.ground)
    if not request.robot.is_file():
        raise Refused(f"robot: {request.robot} is no file; give the MJCF or URDF with which the policy was trained")
    make_plant(policy, request.robot, Conditions(), request.seed)  # refuses a file that is not this robot
    verification = controller.verify()
    if not verification:
        worst = next(b for b in verification.boundaries if not b.holds)
        broken = Cause("contract", f"policy.json and the golden trace disagree at the boundary {worst.name}: {worst}")
        reason = "the golden trace of the training is not reproduced, so nothing was driven"
        empty = Outcome(ground.conditions(), ())
        return Certificate(policy, request, ground, verification, {}, {}, empty, (), broken, (reason,))
    stated = ground.conditions(
        latency=request.latency,
        noise=request.noise,
        motor_strength=request.motor_strength,
        payload=request.payload,
    )
    rows = cases(policy, stated, request.quick)
    check_sands(case.conditions for case in rows)
    told("this simulator")
    grounds = {one.name: one for one in (ground, Ground("rigid", ground.law))}
    engine = {name: _own(policy, one) for name, one in grounds.items()}
    commands = tuple(line.command for line in engine[ground.name])

    def job(conditions: Conditions, of: tuple[Command, ...]) -> Job:
        return Job(str(request.folder), str(request.robot), conditions, of, request.seed, request.wiring)

    walks = [*(job(one.conditions(), commands) for one in grounds.values()), job(stated, commands)]
    jobs = [*walks, *(job(case.conditions, few(commands)) for case in rows)]
    made = all_outcomes(jobs, lambda done, count: told(f"MuJoCo: {done} of {count}"), request.processes)
    nominal, outcome = dict(zip(engine, made, strict=False)), made[len(engine)]
    grid = tuple(zip(rows, made[len(walks) :], strict=True))
    reasons = _reasons(engine[ground.name], nominal[ground.name], outcome, grid)
    cause = None
    if reasons:
        own = Outcome(Conditions(), engine[ground.name])
        failing = next((jobs[len(walks) + k] for k, (c, o) in enumerate(grid) if c.required and not o.holds), None)
        tried = walks[-1] if not outcome.holds or failing is None else failing
        cause = first_failure(policy, walks[0], tried, nominal[ground.name].holds, own, told)
    return Certificate(policy, request, ground, verification, engine, nominal, outcome, grid, cause, reasons)


def _reasons(
    own: tuple[Line, ...],
    nominal: Outcome,
    stated: Outcome,
    grid: tuple[tuple[Case, Outcome], ...],
) -> tuple[str, ...]:
    """Everything that speaks against it."""
    reasons = []
    trained = Outcome(Conditions(), own)
    if not trained.holds:
        reasons.append(f"in this simulator it does not follow its commands: {trained.words}")
    if not nominal.holds:
        reasons.append(f"in MuJoCo, without any imperfection, it does not hold: {nominal.words}")
    if not stated.holds:
        reasons.append(f"the robot as stated does not hold: {stated.words}")
    for case, outcome in grid:
        if case.required and not outcome.holds:
            reasons.append(f"{case.what} {case.value}, which the training drew, does not hold: {outcome.words}")
    return tuple(reasons)


def _own(policy: Policy, ground: Ground) -> tuple[Line, ...]:
    """The nine commands in this simulator, as `sandgait evaluate --commands` plays them."""
    return tuple(_line(line) for line in nine_commands(policy.network, ground.options()))


def _line(line: dict[str, Any]) -> Line:
    command, velocity = ((float(x), float(y), float(z)) for x, y, z in (line["command"], line["velocity"]))
    return Line(command, velocity, float(line["error"]), line["falls"] > 0)


def ranges(certificate: Certificate) -> list[str]:
    """For each kind of case the values that hold, in words."""
    kinds: dict[str, list[tuple[Case, Outcome]]] = {}
    for case, outcome in certificate.grid:
        kinds.setdefault(case.what, []).append((case, outcome))
    lines = []
    for what, rows in kinds.items():
        held = [case.value for case, outcome in rows if outcome.holds]
        failed = [case.value for case, outcome in rows if not outcome.holds]
        lines.append(
            f"{what}: holds at {', '.join(held) or 'none'}" + (f"; fails at {', '.join(failed)}" if failed else "")
        )
    return lines
