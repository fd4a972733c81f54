"""The sand of a plant: a medium by its name or the text of a sand.toml, its law, and a factor on its stress."""

from __future__ import annotations

import json
import re
import tempfile
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from .command_line import said_by
from .errors import InvalidRequest
from .sand import Sand

#: Kinds of ground of LeggedVelocity that are no medium, each with its medium and what it has besides
#: (docs/tasks/LeggedVelocity-v1.md).
KINDS = {
    "dunes": ("poppy-loose", "dunes"),
    "mixed": ("poppy-loose", "slabs of hard ground"),
    "any": ("poppy-loose", "stronger sand and hard ground"),
}

#: Names with a number that is proportional to the stress: ζ, and the critical density.
_NUMBERED = re.compile(r"(zeta=|mu=[^,]*,rho=)(.*)")


def make_sand(ground: str, law: str = "li2013", strength: float = 1.0) -> Sand:
    """The sand `ground` with its stress times `strength`. `ground`: a name that `sandgait.Sand` takes, or the text of a
    sand.toml, which has a law of its own. Raises InvalidRequest or StatusError if there is no such sand."""
    numbered = _NUMBERED.fullmatch(ground)
    if numbered is not None and strength != 1.0:
        return Sand(numbered[1] + f"{_number(numbered[2]) * strength:.9g}", law=law)
    if "\n" not in ground and strength == 1.0:
        return Sand(ground, law=law)
    text = sand_toml(ground, law)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sand.toml"
        file.write_text(text if strength == 1.0 else stronger(text, strength), encoding="utf-8")
        return Sand.from_toml(file)


def stronger(text: str, strength: float) -> str:
    """The text of a sand.toml whose stress is multiplied by `strength`, which its mechanism `scale` does (ζ/ζ0 − 1)."""
    scale = (1.0 + _parsed(text).get("mechanisms", {}).get("scale", 0.0)) * strength - 1.0
    return with_mechanisms(text, {"scale": scale})


def with_mechanisms(text: str, values: Mapping[str, float]) -> str:
    """The text of a sand.toml with these values of mechanisms in place of its own."""
    lines = "".join(f"{name} = {value!r}\n" for name, value in values.items())
    table = re.search(r"(?m)^\[mechanisms\].*(\n|$)", text)
    if table is None:
        return f"{text.rstrip()}\n\n[mechanisms]\n{lines}"
    own, start, others = text[table.end() :].partition("\n[")
    kept = re.sub(rf"(?m)^({'|'.join(map(re.escape, values))}) *=.*\n?", "", own)
    return text[: table.start()] + f"[mechanisms]\n{lines}{kept}" + start + others


def ground_name(ground: str) -> str:
    """What a ground is called: its name, or that in the text of its sand.toml."""
    return ground if "\n" not in ground else str(_parsed(ground).get("name", "sand.toml"))


def sand_toml(name: str, law: str) -> str:
    """The text of the sand.toml of a medium that the program lists; such a text is returned as it is."""
    if "\n" in name:
        return name
    medium = next((m for m in _media() if m["name"] == name), None)
    if medium is None:
        Sand(name, law=law)  # raises the error that lists the names
        raise InvalidRequest(f"medium: {name!r} has no coefficients in `sandgait media`")
    numbers = "".join(f"{key} = {value!r}\n" for key, value in medium["coefficients"].items())
    head = {"name": name, "law": law, "bulk_density": medium["bulk_density"], "source": medium["source"]}
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in head.items()) + f"\n[coefficients]\n{numbers}"


@cache
def _media() -> list[dict[str, Any]]:
    return list(json.loads(said_by("media", "--json")))


def _parsed(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InvalidRequest(f"sand: {error}") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidRequest(f"medium: {text!r} is no number") from None
