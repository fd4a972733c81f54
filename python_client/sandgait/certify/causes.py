"""What fails first: the contract between policy and robot, the physics, or the task. It is said only if a
counterfactual shows it: with this one thing changed, the robot walks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from sandgait_deploy import Policy

from ..plant import Conditions
from .walk import Command, Job, Wiring, outcome


@dataclass(frozen=True)
class Cause:
    """`kind`: contract, physics, task or unknown; `words`: a sentence with the counterfactual."""

    kind: str
    words: str


def of_wiring(job: Job, policy: Policy, told: Callable[[str], None]) -> Cause | None:
    """Tries usual errors of wiring, one at a time. If the robot walks with one of them undone, it is the cause."""
    for wiring in wirings(policy):
        told(f"contract: {wiring.name}")
        made = outcome(replace(job, wiring=_with(job.wiring, wiring)))
        if made.holds:
            return Cause("contract", f"with {wiring.name} it walks ({made.words}): check this in the robot's program")
    return None


def of_conditions(job: Job, told: Callable[[str], None]) -> Cause | None:
    """Takes away one imperfection of the robot at a time."""
    ideal = Conditions(ground=job.conditions.ground, slope_deg=job.conditions.slope_deg)
    for field, words in (
        ("latency", f"without the latency of {1e3 * job.conditions.latency:.0f} ms"),
        ("noise", "without the noise of sensors"),
        ("motor_strength", "with motors of full strength"),
        ("payload", "without the payload"),
        ("friction", "with the ground's full friction"),
    ):
        value = getattr(ideal, field)
        if getattr(job.conditions, field) == value:
            continue
        told(f"physics: {words}")
        made = outcome(replace(job, conditions=replace(job.conditions, **{field: value})))
        if made.holds:
            return Cause("physics", f"{words} it walks ({made.words}); train with it: {_REMEDIES[field]}")
    return None


def of_ground(job: Job, told: Callable[[str], None]) -> Cause | None:
    """Hard ground in place of sand."""
    if job.conditions.ground == "rigid":
        return None
    told("physics: hard ground")
    made = outcome(replace(job, conditions=replace(job.conditions, ground="rigid")))
    if not made.holds:
        return None
    return Cause(
        "physics", f"on hard ground it walks ({made.words}): the sand of the two engines differs for this gait"
    )


_REMEDIES = {
    "latency": "sandgait train --option 'action_delay=[0, 0.05]'",
    "noise": "option sensors (docs/hardware.md)",
    "motor_strength": """--option 'domain_rand={"motor_strength_range": [0.7, 1.1]}'""",
    "payload": """--option 'domain_rand={"added_mass_range": [0, 0.3]}'""",
    "friction": """--option 'domain_rand={"friction_range": [0.4, 1.25]}'""",
}


def wirings(policy: Policy) -> Iterator[Wiring]:
    """Usual errors: the order of joints, and the directions and frames of vectors."""
    for name in ("gravity", "gyroscope", "lin_vel"):
        if name in policy.readings:
            yield Wiring(f"{name} reversed", reversed=(name,))
    for name in ("gyroscope", "lin_vel"):
        if name in policy.readings:
            yield Wiring(f"{name} turned from the world's into the base's frame", turned=(name,))
    count = len(policy.joints)
    feet = len(policy.robot.get("feet") or ())
    if feet < 2 or count % feet or len(policy.servos) != count:
        return
    each = count // feet
    legs = [list(range(k * each, (k + 1) * each)) for k in range(feet)]
    if feet == 4:
        for name, order in (("left and right", (1, 0, 3, 2)), ("front and hind", (2, 3, 0, 1))):
            yield Wiring(f"{name} legs exchanged", joints=tuple(j for leg in order for j in legs[leg]))
    # The orders of unitree_sdk2 (leg by leg) and of Isaac Lab (all hips, then all thighs, then all calves).
    by_kind = tuple(legs[leg][k] for k in range(each) for leg in range(feet))
    yield Wiring("joints ordered by kind in place of by leg", joints=by_kind)
    yield Wiring("joints ordered by leg in place of by kind", joints=tuple(by_kind.index(j) for j in range(count)))
    for leg in legs:
        for a, b in pairwise(leg):
            swapped = list(range(count))
            swapped[a], swapped[b] = b, a
            yield Wiring(f"{policy.joints[a]} and {policy.joints[b]} exchanged", joints=tuple(swapped))


def _with(first: Wiring, then: Wiring) -> Wiring:
    joints = then.joints
    if first.joints is not None:
        joints = tuple(first.joints[j] for j in then.joints) if then.joints is not None else first.joints
    return Wiring(
        then.name,
        joints,
        tuple(set(first.reversed) ^ set(then.reversed)),
        tuple(set(first.turned) ^ set(then.turned)),
    )


def first_failure(
    policy: Policy,
    nominal: Job,
    stated: Job,
    holds: tuple[bool, bool],
    engine: tuple[str, bool],
    told: Callable[[str], None],
) -> Cause:
    """Why the policy does not hold. `nominal`: walks of a robot without imperfections, `stated`: those of the robot as
    it is, `holds`: of each; `engine`: what the policy does in its own simulator, and whether it follows its
    commands."""
    said, follows = engine
    if not follows:
        return Cause(
            "task", f"in the simulator in which it was trained it does not follow its commands either ({said})"
        )
    short = few(nominal.commands)
    if not holds[0]:
        job = replace(nominal, commands=short)
        cause = of_wiring(job, policy, told) or of_ground(job, told)
    else:
        cause = of_conditions(replace(stated, commands=short), told)
    unknown = "no single change that was tried makes it walk, so the cause is not known; the imperfections may add up"
    return cause or Cause("unknown", unknown)


def few(commands: Sequence[Command]) -> tuple[Command, ...]:
    """Three of the commands: forward, turning, and both."""
    chosen = [commands[k] for k in (0, 5, 7) if k < len(commands)]
    return tuple(chosen or commands[:1])
