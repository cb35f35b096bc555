"""The plugin of pytest by which `scripts.mutants` runs its faults: all tests are collected once, and for each fault a
fork of this process takes the changed code in the place of its functions and runs tests until one fails."""

import ast
import functools
import gc
import json
import os
import resource
import sys
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from scripts.mutants import LIMIT_S, LINKS, Mutant, files_of_tests

# Worlds that use most of what draws and labels; they run first, and once without a fault, which checks all types.
FIRST = "tests/test_frozen.py::test_a_world_is_as_it_was"
# What a fault may do in a test before it counts as an endless loop, in seconds of CPU time.
ENDLESS_S = 60


def runs_in_functions(text: bytes, mutant: Mutant) -> bool:
    """Whether the place is in the body of a function: all else has run when the tests begin."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            first, last = node.body[0], node.body[-1]
            begin = starts[first.lineno - 1] + first.col_offset
            end = starts[(last.end_lineno or 0) - 1] + (last.end_col_offset or 0)
            if begin <= mutant.start and mutant.end <= end:
                return True
    return False


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """The code of all functions within another's."""
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield part
            yield from codes(part)


def places(path: str) -> set[str]:
    """Where a file of the checkout is in the copy, also by the names that it is installed by."""
    linked = {f"{name}{path.removeprefix(target)}" for name, target in LINKS.items() if path.startswith(f"{target}/")}
    return {str(Path.cwd() / name) for name in {path, *linked}}


def loaded(path: str) -> Iterator[types.FunctionType]:
    """The functions of a file."""
    names = places(path)
    return (
        item for item in gc.get_objects() if type(item) is types.FunctionType and item.__code__.co_filename in names
    )


def apply(path: str, text: bytes) -> None:
    """Give the functions of a module that is loaded the code of another text."""
    new: dict[str, list[types.CodeType]] = {}
    for code in codes(compile(text, path, "exec", dont_inherit=True)):
        new.setdefault(code.co_qualname, []).append(code)
    found: dict[str, list[types.FunctionType]] = {}
    for item in loaded(path):
        found.setdefault(item.__code__.co_qualname, []).append(item)
    for name, functions in found.items():
        lines = sorted({function.__code__.co_firstlineno for function in functions})
        for function in functions:
            old, others = function.__code__, new.get(name, [])
            if len(others) == len(lines):
                code = others[lines.index(old.co_firstlineno)]
                if len(code.co_freevars) == len(old.co_freevars):
                    function.__code__ = code


def failed(session: pytest.Session, items: list[pytest.Item]) -> str:
    """The first test that fails within the limit, or nothing."""
    end_s = time.process_time() + LIMIT_S
    for item, after in zip(items, [*items[1:], None], strict=False):
        before = session.testsfailed
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
        if session.testsfailed > before:
            return item.nodeid
        if time.process_time() > end_s:
            break
    return ""


def in_a_fork(session: pytest.Session, mutant: Mutant, items: list[pytest.Item]) -> str:
    """The test that fails with a mutant, in a process of its own."""
    path = Path.cwd() / mutant.path
    text, times = path.read_bytes(), path.stat()
    read, write = os.pipe()
    # Programs that tests start take the fault from the file.
    path.write_bytes(mutant.applied(text))
    pid = os.fork()
    if not pid:
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S + ENDLESS_S, LIMIT_S + ENDLESS_S))
        found = "the end of pytest"
        try:
            apply(mutant.path, mutant.applied(text))
            found = failed(session, items)
        finally:
            os.write(write, f"{found}.".encode())
            if "tests.warm" in sys.modules:
                sys.modules["tests.warm"].stop()
            os._exit(0)
    os.close(write)
    with open(read, "rb") as stream:
        told = stream.read()
    os.waitpid(pid, 0)
    path.write_bytes(text)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    return told.decode()[:-1] if told else "an endless loop"


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool:
    gc.unfreeze()
    folder = Path(os.environ["MUTANTS"])
    by_file: dict[Path, list[pytest.Item]] = {}
    for item in session.items:
        by_file.setdefault(item.path, []).append(item)
    worlds = [item for item in session.items if item.nodeid.startswith(FIRST)]
    failed(session, worlds)
    forget()
    for row in json.loads((folder / "mutants.json").read_text()):
        mutant = Mutant(**row)
        if next(loaded(mutant.path), None) is None:
            continue  # no test imports it: a process of its own may
        files = [
            path for some in files_of_tests(Path.cwd(), Path.cwd() / mutant.path, [mutant.function]) for path in some
        ]
        near = [item for path in files for item in by_file.get(path, [])]
        own = [item for item in near if Path(mutant.path).stem in item.path.stem]
        order = [*own, *(item for item in worlds if item in near), *near]
        found = in_a_fork(session, mutant, list(dict.fromkeys(order)))
        with (folder / "results.jsonl").open("a") as stream:
            stream.write(json.dumps({"key": mutant.key, "killed_by": found, "mutant": str(mutant)}) + "\n")
    return True


def forget() -> None:
    """What our functions have cached without a fault."""
    for item in gc.get_objects():
        name: Any = getattr(item, "__module__", None) if type(item) is functools._lru_cache_wrapper else None
        if isinstance(name, str) and name.startswith(("synth3dlanes", "tests")):
            item.cache_clear()
