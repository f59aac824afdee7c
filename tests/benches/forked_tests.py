"""Runs tests of other trees one after the other, each in a fork of a program that has loaded the libraries already.

The program is this file. It never imports the project's own code: that comes from the tree which is asked for, also in
processes that a test starts.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

_LIBRARIES = (
    "numpy", "scipy.linalg", "scipy.optimize", "pydantic", "asyncua", "pymodbus.client", "hypothesis", "pytest",
    "_pytest.assertion.rewrite", "pytest_asyncio.plugin",
)  # fmt: skip
_SITE = """
import sys
sys.meta_path = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__.lower()]
"""
"""The environment's editable install directs every import to the tree that it was made from."""
_OPTIONS = (
    "-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", "ignore::pytest.PytestAssertRewriteWarning",
)  # fmt: skip
_NOT_TRIED = 99
"""Exit code of a fork that did not reach its test."""


@dataclass(frozen=True, slots=True)
class TestedApart:
    """What became of a test: pytest's exit code, None if it was ended because it hung; and what pytest printed."""

    code: int | None
    output: str


class ForkedTests:
    """A context: the program runs in it."""

    def __enter__(self) -> Self:
        self._program = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._program.communicate()

    def run(self, tree: Path, test: str, limit_s: float) -> TestedApart:
        """Run one test of a tree with a time limit. No byte code is left there: a file may change between two runs.

        Raises RuntimeError when the program or its fork ended otherwise.
        """
        assert self._program.stdin is not None
        assert self._program.stdout is not None
        self._program.stdin.write(json.dumps([str(tree), test, limit_s]) + "\n")
        self._program.stdin.flush()
        answer = self._program.stdout.readline()
        output = (tree / "output").read_text(encoding="utf-8", errors="replace")
        code = json.loads(answer or str(_NOT_TRIED))
        if code == _NOT_TRIED:
            raise RuntimeError(f"{test} was not run: {output[-3000:]}")
        return TestedApart(code, output)


def _serve() -> None:
    """Answers each line of its standard input, until that ends."""
    del sys.path[0]  # the folder of this file: a bench may be called as a library is
    for name in _LIBRARIES:
        importlib.import_module(name)
    for line in sys.stdin:
        tree, test, limit_s = json.loads(line)
        child = os.fork()
        if child == 0:
            _test(Path(tree), test)
        print(json.dumps(_exit_code(child, limit_s)), flush=True)


def _test(tree: Path, test: str) -> NoReturn:
    """In the fork."""
    import pytest  # loaded already

    code = _NOT_TRIED
    try:
        os.setsid()
        with (tree / "output").open("wb") as output, Path(os.devnull).open("rb") as nothing:
            for descriptor, file in ((0, nothing), (1, output), (2, output)):
                os.dup2(file.fileno(), descriptor)
        site = tree / "site"
        site.mkdir(exist_ok=True)
        (site / "sitecustomize.py").write_text(_SITE, encoding="utf-8")
        exec(_SITE)  # as the processes that the test starts do
        sys.path.insert(0, str(tree))
        sys.dont_write_bytecode = True
        for name in [name for name in os.environ if name.startswith("PYTEST_")]:
            del os.environ[name]
        os.environ |= {"PYTHONPATH": os.pathsep.join([str(site), str(tree)]), "PYTHONDONTWRITEBYTECODE": "1"}
        os.chdir(tree)
        code = int(pytest.main([*_OPTIONS, test]))
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _exit_code(child: int, limit_s: float) -> int | None:
    """None: ended after this time. Nothing that the fork has started outlives it, also when this program is stopped."""
    end_s, pause_s = time.monotonic() + limit_s, 0.005
    try:
        while time.monotonic() < end_s:
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                return os.waitstatus_to_exitcode(status)
            time.sleep(pause_s)
            pause_s = min(0.1, 1.5 * pause_s)
        return None
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(child, 0)


if __name__ == "__main__":
    _serve()
