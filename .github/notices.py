"""Writes THIRD_PARTY_NOTICES.txt: name, version, licence and notices of every crate that the programs contain.

    python .github/notices.py [OUT]

The releases' wheels, archives and images contain this file. Crates that only run while others are compiled (build
scripts, macros) and crates for tests are not part of the programs and are left out. A crate without a file of its
licence in its package has the texts of this licence from other crates.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

#: Names of files with a licence or a notice in a crate's package.
FILES = re.compile(r"(licen[cs]e|copying|notice|unlicense|copyright)", re.IGNORECASE)

#: Every licence is longer [characters]; shorter texts only name a licence.
WHOLE = 400

#: The package with the native module, and the one with the command; both are released.
ROOTS = ("sandgait-native", "sandgait")


def linked(metadata: dict[str, Any]) -> list[dict[str, Any]]:
    """The packages of other authors that the programs link, by name and version."""
    packages = {p["id"]: p for p in metadata["packages"]}
    nodes = {n["id"]: n for n in metadata["resolve"]["nodes"]}
    macro = {i for i, p in packages.items() if any("proc-macro" in t["kind"] for t in p["targets"])}
    waiting = [i for i, p in packages.items() if p["name"] in ROOTS]
    seen: set[str] = set()
    while waiting:
        crate = waiting.pop()
        if crate in seen or crate in macro:
            continue
        seen.add(crate)
        for dependency in nodes[crate]["deps"]:
            if any(kind["kind"] is None for kind in dependency["dep_kinds"]):
                waiting.append(dependency["pkg"])
    others = [packages[i] for i in seen if packages[i]["source"] is not None]
    return sorted(others, key=lambda p: (p["name"], p["version"]))


def texts(package: dict[str, Any]) -> list[str]:
    """The licences and notices in a crate's package."""
    folder = Path(package["manifest_path"]).parent
    files = [
        f for f in sorted(folder.iterdir()) if f.is_file() and FILES.search(f.name) and f.suffix not in (".rs", ".toml")
    ]
    return [f.read_text(encoding="utf-8", errors="replace").strip() for f in files]


def alternatives(package: dict[str, Any]) -> list[str]:
    return re.split(r"\s+OR\s+|\s*/\s*", package["license"] or "", flags=re.IGNORECASE)


def notices(metadata: dict[str, Any]) -> str:
    crates = linked(metadata)
    own = {p["id"]: texts(p) for p in crates}
    # For crates without a text: the text of a crate that has this licence alone.
    known = {}
    for package in crates:
        if own[package["id"]] and len(own[package["id"]]) == 1 and len(alternatives(package)) == 1:
            known.setdefault(package["license"], own[package["id"]][0])
    numbers: dict[str, int] = {}
    lines = [
        "The programs and the native module of sandgait contain the crates of this list. Each line has name, version,",
        "licence, source, and the numbers of the texts below that belong to the crate.",
        "",
    ]
    for package in crates:
        chosen = own[package["id"]]
        if not any(len(text) > WHOLE for text in chosen):
            chosen = [*chosen, *(known[name] for name in alternatives(package) if name in known)]
        if not any(len(text) > WHOLE for text in chosen):
            raise SystemExit(f"{package['name']}: no text for licence {package['license']!r}")
        marks = ", ".join(str(numbers.setdefault(text, len(numbers) + 1)) for text in chosen)
        source = package["repository"] or f"https://crates.io/crates/{package['name']}"
        lines.append(f"{package['name']} {package['version']}: {package['license']}; {source} [{marks}]")
    # The pages of recordings contain three.js.
    three = Path("src/view/page/three.LICENSE").read_text(encoding="utf-8").strip()
    lines.append(f"three.js: MIT; https://github.com/mrdoob/three.js [{numbers.setdefault(three, len(numbers) + 1)}]")
    for text, number in numbers.items():
        lines += ["", f"---- [{number}] ----", "", text]
    return "\n".join(lines) + "\n"


def run(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main() -> None:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "THIRD_PARTY_NOTICES.txt")
    host = re.search(r"host: (.+)", run("rustc", "-vV"))
    assert host
    metadata = json.loads(run("cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", host[1]))
    out.write_text(notices(metadata), encoding="utf-8")
    print(f"{out}: {len(linked(metadata))} crates, {out.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()
