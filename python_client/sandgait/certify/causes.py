"""What fails first: the contract between policy and robot, the physics, or the task. It is said only if a
counterfactual shows it: with this one thing changed, the robot walks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from sandgait_deploy import Policy

from ..plant import Conditions
from .walk import Command, Job, Outcome, Wiring, outcome


@dataclass(frozen=True)
class Cause:
    """`kind`: contract, physics, task or unknown; `words`: a sentence with the counterfactual."""

    kind: str
    words: str


def of_wiring(job: Job, tried: Iterable[Wiring], told: Callable[[str], None]) -> Cause | None:
    """Tries errors of wiring, one at a time. If the robot walks with some of them undone, the one with which it walks
    best is the cause."""
    made: list[tuple[Wiring, Outcome]] = []
    for wiring in tried:
        told(f"contract: {wiring.name}")
        made.append((wiring, outcome(replace(job, wiring=joined(job.wiring, wiring)))))
    walking = sorted((pair for pair in made if pair[1].holds), key=lambda pair: pair[1].error)
    if not walking:
        return None
    (best, how), others = walking[0], [wiring.name for wiring, _ in walking[1:]]
    also = f"; it also walks, worse, with {', '.join(others)}" if others else ""
    return Cause("contract", f"with {best.name} it walks ({how.words}){also}: check this in the robot's program")


def of_conditions(job: Job, told: Callable[[str], None]) -> Cause | None:
    """Takes away one imperfection of the robot at a time."""
    ideal = Conditions()
    for field, words in (
        ("latency", f"without the latency of {1e3 * job.conditions.latency:.0f} ms"),
        ("noise", "without the noise of sensors"),
        ("motor_strength", "with motors of full strength"),
        ("payload", "without the payload"),
        ("friction", "with the ground's full friction"),
        ("sand_strength", "with sand of the nominal strength"),
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
    "sand_strength": """--option 'domain_rand={"sand_range": [0.2, 4.3]}'""",
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


def joined(first: Wiring, then: Wiring) -> Wiring:
    """The wiring `first`, then `then`; what both reverse or turn is as it should be."""
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
    policy: Policy, nominal: Job, tried: Job, walks: bool, own: Outcome, told: Callable[[str], None]
) -> Cause:
    """Why the policy does not hold. `nominal`: walks of a robot without imperfections, `walks`: do they hold; `tried`:
    walks that do not hold; `own`: those in this simulator."""
    if not own.holds:
        return Cause("task", f"in this simulator it does not follow its commands either ({own.words})")
    if walks:
        cause = of_conditions(replace(tried, commands=few(tried.commands)), told)
    else:
        job = replace(nominal, commands=few(nominal.commands))
        cause = of_wiring(job, wirings(policy), told) or of_ground(job, told)
    unknown = "no single change that was tried makes it walk, so the cause is not known; the imperfections may add up"
    return cause or Cause("unknown", unknown)


def few(commands: Sequence[Command]) -> tuple[Command, ...]:
    """Three of the commands: forward, turning, and both."""
    chosen = [commands[k] for k in (0, 5, 7) if k < len(commands)]
    return tuple(chosen or commands[:1])
