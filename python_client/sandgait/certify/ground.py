"""The ground on which a policy must walk, in both engines, and what stands in for ground that MuJoCo does not get."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sandgait_deploy import Policy, Refused

from .. import _native
from ..errors import InvalidRequest
from ..grounds import KINDS, ground_name, make_sand
from ..plant import Conditions
from ..policies import trained


@dataclass(frozen=True)
class Ground:
    """`sand` and `law` as in `Conditions`."""

    sand: str
    law: str
    #: One line if something stands in for the ground that was asked; empty otherwise.
    note: str = ""

    @property
    def name(self) -> str:
        return ground_name(self.sand)

    def conditions(self, **others: Any) -> Conditions:
        """Conditions on this ground."""
        return Conditions(ground=self.sand, law=self.law, **others)

    def options(self) -> dict[str, Any]:
        """Options of LeggedVelocity with which the simulator has this ground, flat as in MuJoCo."""
        text = self.sand if "\n" in self.sand else ""
        ground = "poppy-loose" if text else self.sand  # the text replaces the medium
        return {"ground": ground, "sand": text, "law": self.law, "relief": None, "slope_deg": 0.0}


def ground_of(policy: Policy, given: str | None) -> Ground:
    """The `given` ground (rigid, a name, or the path of a sand.toml), or that of the training."""
    learnt = _settings(policy)
    law = str(learnt.get("law") or "li2013")
    text = str(learnt.get("sand") or "") if given is None else _text(given)
    name = given or str(policy.trained_with["ground"])
    sand, missing = KINDS.get(name, (name, "dunes" if given is None and learnt.get("relief") else ""))
    if text and sand != "rigid":
        sand = text
    if sand != "rigid":
        try:
            make_sand(sand, law)
        except (InvalidRequest, _native.StatusError) as error:
            raise Refused(f"ground: {error}; or rigid, or the path of a sand.toml") from None
    asked = "that of the training" if given is None else "--ground"
    note = f"the ground ({asked}, {name}) is flat {ground_name(sand)} here, without its {missing}" if missing else ""
    return Ground(sand, law, note)


def check_sands(all: Iterable[Conditions]) -> None:
    """Refuses sands that cannot be made, before anything walks."""
    for one in {(c.ground, c.law, c.sand_strength) for c in all if c.ground != "rigid"}:
        try:
            make_sand(*one)
        except (InvalidRequest, _native.StatusError) as error:
            raise Refused(f"ground: with {one[2]:.2f} times the stress: {error}") from None


def _settings(policy: Policy) -> dict[str, Any]:
    settings = policy.folder / "settings.json"
    return trained(settings)[1] if settings.is_file() else {}


def _text(given: str) -> str:
    if not given.endswith(".toml"):
        return ""
    try:
        return Path(given).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"ground: {given} cannot be read: {reason}") from None
