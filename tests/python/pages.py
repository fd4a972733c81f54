"""Runs the fenced code blocks of the documentation's pages. HTML comments before a block say how:

    <!-- not run: WHY -->        the next block is not run
    <!-- test: COMMANDS -->      these commands are run instead of the block, because it takes too long
    <!-- replace: A -> B -->     the block is run with B instead of A, which must occur in it
    <!-- before: CODE -->        this code, in the block's language, is run before the block
    <!-- serve: OPTIONS -->      a server with these options runs from here to the end of the page

The blocks of a page are run from top to bottom in a new directory. Its Python blocks share their variables. A server
runs until the end of the page, or until another server is started at its address.
"""

from __future__ import annotations

import doctest
import random
import re
import socket
import subprocess
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).parents[2]

#: Every page of the site, and the files that GitHub and PyPI show.
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "benches/RESULTS.md"])

#: Languages of blocks that are run, and of blocks that cannot be run.
RUN = ("sh", "console", "python", "pycon")
SHOWN = ("text", "math", "toml", "csv", "json", "ini", "yaml", "rust")

#: Longest time of a block [s].
TIMEOUT = 60.0


@dataclass
class Block:
    """One fenced block with the comments before it."""

    page: Path
    #: Line number of the block's first line of text, counted from 1.
    line: int
    language: str
    text: str
    comments: list[tuple[str, str]] = field(default_factory=list)

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    def said(self, kind: str) -> list[str]:
        """Texts of the comments of one kind."""
        return [text for k, text in self.comments if k == kind]

    @property
    def excuse(self) -> str | None:
        """The reason why the block is not run, if there is one."""
        return next(iter(self.said("not run")), None)

    def to_run(self) -> str:
        """The text that a test runs."""
        text = self.text
        for instead in self.said("test"):
            text = instead + "\n"
        for replacement in self.said("replace"):
            old, _, new = (part.strip() for part in replacement.partition("->"))
            assert old in text, f"{self}: {old!r} is to be replaced and does not stand there"
            text = text.replace(old, new)
        return text


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page, in order."""
    found, comments = [], []
    for token in MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8")):
        if token.type == "html_block" and (said := _comment(token.content)):
            comments.append(said)
            continue
        if token.type == "fence" and token.map is not None:
            found.append(Block(page, token.map[0] + 2, token.info.strip(), token.content, comments))
        else:
            where = f"{page.relative_to(ROOT)}:{(token.map or [0])[0] + 1}"
            assert token.type != "code_block", f"{where}: an indented block; fence it and name its language"
            assert not comments, f"{where}: {comments[0][0]!r} stands before no fenced block"
        comments = []
    return found


def _comment(html: str) -> tuple[str, str] | None:
    match = re.fullmatch(r"<!--\s*(not run|test|replace|before|serve):\s*(.*?)\s*-->\s*", html, flags=re.DOTALL)
    return (match[1], textwrap.dedent(match[2])) if match else None


def inline_code(page: Path) -> Iterator[str]:
    """Every piece of inline `code` in the page's text."""
    yield from (token.content for token in _inline(page) if token.type == "code_inline")


def links(page: Path) -> Iterator[str]:
    """Targets of the page's links and pictures."""
    yield from (str(token.attrs[a]) for token in _inline(page) for a in ("href", "src") if a in token.attrs)


def _inline(page: Path) -> Iterator[Token]:
    for token in MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8")):
        yield from token.children or ()


class Run:
    """Runs the blocks of one page in `directory`, with `environment`."""

    def __init__(self, directory: Path, environment: dict[str, str]) -> None:
        self.directory = directory
        self.environment = environment
        self._names: dict[str, Any] = {"__name__": "__main__"}
        self._servers: list[tuple[str, subprocess.Popen[str]]] = []
        # The ports and paths on the pages may be in use on this machine, so others replace them.
        self._elsewhere = {port: str(_free_port()) for port in ("50051", "8080", "9464")} | {"/tmp/": f"{directory}/"}

    def run(self, block: Block) -> None:
        """Runs a block. If it does not work as shown, the failure states the block's file and line."""
        for options in block.said("serve"):
            self._serve(block, self._moved(f"sandgait serve {options}"))
        for code in block.said("before"):
            self._run(block, code + "\n")
        self._run(block, block.to_run())

    def stop(self, address: str = "") -> None:
        """Ends the servers at an address, or all."""
        for server in [s for s in self._servers if address in s[0]]:
            server[1].terminate()
            assert server[1].wait(10) == 0, f"{server[0]}: {server[1].communicate()}"
            server[1].communicate()
            self._servers.remove(server)

    def _run(self, block: Block, text: str) -> None:
        text = self._moved(text)
        if block.language == "python":
            # Empty lines before the code, so that a traceback has the page's line numbers.
            exec(compile("\n" * (block.line - 1) + text, block.page, "exec"), self._names)
        elif block.language == "pycon":
            self._doctest(block, text)
        elif block.language == "console":
            for command, expected in _console(text):
                output = self._shell(block, command, check=not expected)
                assert not expected or _matches(output, expected), f"{block}: {command}\n{output}is not\n{expected}"
        else:
            self._script(block, text)

    def _moved(self, text: str) -> str:
        for there, here in self._elsewhere.items():
            text = text.replace(there, here)
        return text

    def _script(self, block: Block, text: str) -> None:
        """A shell script whose servers stay in the background."""
        script = ""
        for line in re.findall(r"(?:[^\n]*\\\n)*[^\n]*\n", text):
            if re.match(r"(\w+=\S+ )*sandgait serve(?!.*--help)", line):
                self._shell(block, script)
                self._serve(block, line)
                script = ""
            else:
                script += line
        self._shell(block, script)

    def _shell(self, block: Block, script: str, check: bool = True) -> str:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", script],
            cwd=self.directory,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=TIMEOUT,
        )
        assert not check or done.returncode == 0, f"{block}: exit code {done.returncode}\n{script}\n{done.stdout}"
        return done.stdout

    def _serve(self, block: Block, command: str) -> None:
        for address in re.findall(r"--listen (?:\S*:(?=\d)|unix:)(\S+)", command):
            self.stop(address)
        process = subprocess.Popen(
            ["bash", "-c", f"exec {command}"],
            cwd=self.directory,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        line = process.stdout.readline()
        self._servers.append((line, process))
        assert line.startswith("listening on "), f"{block}: {command}\n{process.communicate()}"

    def _doctest(self, block: Block, text: str) -> None:
        """Runs examples with their answers; `...` stands for text that differs from run to run."""
        example = doctest.DocTestParser().get_doctest(text, self._names, str(block), str(block.page), block.line - 1)
        report: list[str] = []
        runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
        runner.run(example, out=report.append, clear_globs=False)
        self._names.update(example.globs)
        assert example.examples, f"{block}: no examples after `>>> `"
        assert not report, f"{block}:\n" + "".join(report)


def _console(text: str) -> list[tuple[str, str]]:
    """Commands (after `$ `) with their output. A command without output must succeed; the others may fail."""
    found = re.findall(r"^\$ ((?:.*\\\n)*.*)\n((?:(?!\$ ).*\n)*)", text, flags=re.MULTILINE)
    assert found, f"no command after `$ `: {text}"
    return found


def _matches(output: str, expected: str) -> bool:
    """`…` stands for anything on a line; on a line of its own for any lines. Lines of progress do not count: they
    depend on the machine."""
    output = re.sub(r"^sandgait: \d+ % of .*\n", "", output, flags=re.MULTILINE)
    pattern = re.escape(expected.strip()).replace(r"\ ", " ")
    pattern = re.sub(r"^…\n", r"(?:.*\n)*?", pattern.replace("\\\n", "\n"), flags=re.MULTILINE)
    pattern = re.sub(r"\n…$", r"(?:\n.*)*", pattern)
    return re.fullmatch(pattern.replace("…", ".*"), output.strip()) is not None


def _free_port() -> int:
    """A free port below the range from which the kernel chooses ports, so it stays free."""
    lowest = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    while True:
        port = random.randrange(1024, max(lowest, 1025))
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
