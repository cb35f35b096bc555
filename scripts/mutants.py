"""How much the quick tests notice: `python -m scripts.mutants FOLDER --n 100`; FOLDER keeps a copy and the results.

A mutant is the code with one small fault: another sign or operator, a comparison off by one, a changed constant,
swapped axes or arguments, a dropped condition. Tests are run in the copy until one fails: files of tests that are
called like the mutant's module, then in the order of how far their imports are from it, and as many as LIMIT_S of CPU
time allows. So what survives may still fail a test that is far away. Faults in functions are run by forks of one
process that has all tests (`scripts.mutants_run`), all others by a process each. Prints each mutant with the test that
killed it, the survivors and the share killed.

Which mutants a subject has follows from a hash of each place: edits of other places do not change them. A mutant with a
result in FOLDER/results.jsonl is not run again; with --killed only those are run that have one and were killed there.
"""

import ast
import hashlib
import json
import os
import re
import resource
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import click

ROOT = Path(__file__).parents[1]
# Where the faults are planted, in equal numbers.
SUBJECTS = {
    "geometry": ("synth3dlanes/geometry/*.py",),
    "labels": ("synth3dlanes/labels/*.py", "synth3dlanes/truth/*.py"),
    "roads": ("synth3dlanes/roads/**/*.py",),
    "world": ("synth3dlanes/world/*.py",),
    "sampling": ("synth3dlanes/draw/**/*.py",),
    "dataset": ("synth3dlanes/dataset/*.py",),
    "formats": ("synth3dlanes/formats/**/*.py",),
    "validate": ("synth3dlanes/validate/*.py",),
    "metrics": ("baseline_model/metrics.py", "baseline_model/matching.py", "baseline_model/curves.py"),
    "lift": ("synth3dlanes/recorded/lift/*.py",),
}
# Limits of a mutant, in seconds of CPU time, and of a test, in seconds: a fault may make a loop endless.
LIMIT_S, TEST_LIMIT_S = 60, 300
# A start of pytest takes some five seconds, a file more one.
FILES_AT_ONCE = 5
# Names under which folders of the checkout are installed.
LINKS = {
    "synth3dlanes_baseline": "baseline_model",
    "synth3dlanes_cli": "cli",
    "synth3dlanes/_params": "../params",
    "synth3dlanes/_assets": "../blender_assets",
}
OPERATORS: dict[type[ast.AST], str] = {
    **{ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "/", ast.Mod: "//", ast.Pow: "*"},
    **{ast.BitAnd: "|", ast.BitOr: "&", ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!="},
    **{ast.NotEq: "==", ast.In: "not in", ast.NotIn: "in", ast.Is: "is not", ast.IsNot: "is"},
}
NAMES = {"min": "max", "any": "all", "sin": "cos", "floor": "ceil", "minimum": "maximum", "argmin": "argmax"}
NAMES |= {new: old for old, new in NAMES.items()}
# Swapped arguments that no program survives, or that change nothing.
NOT_SWAPPED = {"isinstance", "issubclass", "getattr", "hasattr", "cast", "zip", "min", "max", "partial"}
Source = Callable[[ast.AST], str]


@dataclass(frozen=True)
class Mutant:
    """A file with the bytes `[start:end]` replaced; `key` names the place without numbers of lines."""

    path: str
    function: str
    line: int
    start: int
    end: int
    old: str
    new: str
    key: str

    def applied(self, text: bytes) -> bytes:
        """The text of the file with the fault."""
        return text[: self.start] + self.new.encode() + text[self.end :]

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.old} -> {self.new}"


def mutants(path: str, text: bytes) -> Iterator[Mutant]:
    """All mutants of a file."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    seen: Counter[str] = Counter()

    def span(node: Any) -> tuple[int, int]:
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def source(node: ast.AST) -> str:
        return text[slice(*span(node))].decode()

    for parent, function in _code(ast.parse(text), ""):
        for node, new in _changed(parent, source):
            name = f"{path} {function} {source(node)} -> {new}"
            seen[name] += 1
            key = hashlib.sha1(f"{name} {seen[name]}".encode()).hexdigest()
            yield Mutant(path, function, node.lineno, *span(node), source(node), new, key)  # type: ignore[attr-defined]


def _code(node: ast.AST, function: str) -> Iterator[tuple[ast.AST, str]]:
    """What runs and decides: neither types nor texts nor errors, with the function that it is in."""
    yield node, function
    for name, child in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases"):
            continue
        for part in child if isinstance(child, list) else [child]:
            if isinstance(part, ast.AST) and not isinstance(part, ast.JoinedStr | ast.Raise | ast.Assert):
                named = isinstance(part, ast.FunctionDef | ast.ClassDef)
                yield from _code(part, f"{function}.{part.name}" if named else function)  # type: ignore[attr-defined]


def _changed(node: ast.AST, source: Source) -> Iterator[tuple[ast.AST, str]]:
    """What to replace at a node, by what."""
    match node:
        case ast.BinOp(left, operator, right) if type(operator) in OPERATORS and not _is_text_or_type(left, right):
            yield node, f"(({source(left)}) {OPERATORS[type(operator)]} ({source(right)}))"
        case ast.Compare(left, [operator], [right]) if type(operator) in OPERATORS:
            yield node, f"(({source(left)}) {OPERATORS[type(operator)]} ({source(right)}))"
        case ast.BoolOp(operator, values):
            other = " or " if isinstance(operator, ast.And) else " and "
            yield node, f"({other.join(f'({source(value)})' for value in values)})"
            yield node, f"({source(values[0])})"
            yield node, f"({source(values[-1])})"
        case ast.UnaryOp(ast.USub() | ast.Not() | ast.Invert(), operand):
            yield node, f"({source(operand)})"
        case ast.Constant(bool(value)):
            yield node, str(not value)
        case ast.Constant(int(value)):
            yield node, str(value + 1)
        case ast.Constant(float(value)):
            yield node, str(1.25 * value or 1.0)
        case ast.If(test) if ast.unparse(test) != "TYPE_CHECKING":
            yield test, "True"
            yield test, "False"
        case ast.IfExp(_, body, other):
            yield node, f"({source(body)})"
            yield node, f"({source(other)})"
        case ast.comprehension(_, _, [condition, *_]):
            yield condition, "True"
        case ast.Call(called, [first, second, *rest], keywords) if _is_swapped(called, first, second):
            parts = [source(second), source(first), *map(source, rest), *map(source, keywords)]
            yield node, f"{source(called)}({', '.join(parts)})"
        case ast.Tuple([first, second], ast.Load()) if not _is_text_or_type(first, second) and _differ(first, second):
            swapped = f"{source(second)}, {source(first)}"
            # Axes have no brackets, and slices may have none.
            yield node, swapped if isinstance(first, ast.Slice) or isinstance(second, ast.Slice) else f"({swapped})"
        case ast.Attribute(value, name, ast.Load()) if name in NAMES:
            yield node, f"({source(value)}).{NAMES[name]}"
        case ast.Name(name, ast.Load()) if name in NAMES:
            yield node, NAMES[name]


def _is_swapped(called: ast.AST, first: ast.AST, second: ast.AST) -> bool:
    return _last_name(called) not in NOT_SWAPPED and _differ(first, second)


def _differ(one: ast.AST, other: ast.AST) -> bool:
    return ast.unparse(one) != ast.unparse(other)


def _last_name(node: ast.AST) -> str:
    return ast.unparse(node).rpartition(".")[2]


def _is_text_or_type(*nodes: ast.AST) -> bool:
    def is_one(node: ast.AST) -> bool:
        if isinstance(node, ast.Constant):
            return not isinstance(node.value, int | float)
        name = _last_name(node) if isinstance(node, ast.Name | ast.Attribute) else ""
        return isinstance(node, ast.JoinedStr) or (name[:1].isupper() and not name.isupper())

    return any(map(is_one, nodes))


def sampled(tree: Path, n: int, subjects: list[str]) -> Iterator[tuple[str, Mutant]]:
    """The fixed sample of n mutants of all subjects, of those that are asked for."""
    for subject in subjects:
        paths = sorted({path for pattern in SUBJECTS[subject] for path in tree.glob(pattern)})
        found = [m for path in paths for m in mutants(str(path.relative_to(tree)), path.read_bytes())]
        valid = (m for m in sorted(found, key=lambda m: m.key) if _is_python(m.applied((tree / m.path).read_bytes())))
        yield from ((subject, mutant) for mutant in islice(valid, n // len(SUBJECTS)))


def _is_python(text: bytes) -> bool:
    try:
        ast.parse(text)
    except SyntaxError:
        return False
    return True


def copy_checkout(tree: Path) -> None:
    """The files of the checkout that git does not ignore, under the names that they are installed by too."""
    listed = subprocess.run(
        ["git", "ls-files", "-zco", "--exclude-standard"], cwd=ROOT, check=True, capture_output=True
    )
    names = {name for name in listed.stdout.decode().split("\0") if (ROOT / name).is_file()}
    for old in tree.rglob("*.py"):
        if str(old.relative_to(tree)) not in names and not any(part.is_symlink() for part in old.parents):
            old.unlink()
    for name in names:
        target = tree / name
        if not target.exists() or target.read_bytes() != (ROOT / name).read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, target)
    for name, place in LINKS.items():
        if not (tree / name).is_symlink():
            (tree / name).symlink_to(place)


@cache
def imports(tree: Path, path: Path) -> frozenset[Path]:
    """The files of ours that a file imports."""
    found = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        match node:
            case ast.ImportFrom(module, names, level):
                place = (path.parent if level else tree).joinpath(*(module or "").split("."))
                found += [place, *(place / name.name for name in names)]
            case ast.Import(names):
                found += [tree.joinpath(*name.name.split(".")) for name in names]
    files = [(tree / _real(name.relative_to(tree))).with_suffix(".py") for name in found]
    return frozenset(filter(Path.is_file, files))


def _real(name: Path) -> Path:
    """Where a package is in the checkout, if it is installed by another name."""
    return Path(LINKS.get(name.parts[0], name.parts[0]), *name.parts[1:]) if name.parts else name


def files_of_tests(tree: Path, path: Path, names: list[str]) -> Iterator[list[Path]]:
    """Files of tests that reach a file by imports, a few at a time: first those that are called like it, then the
    nearest; of these, those that render last, and first those that have one of the names or import little."""
    folders = ("tests", "synth3dlanes", "cli", "baseline_model")
    everything = [file for folder in folders for file in (tree / folder).rglob("*.py")]
    distances, near = {path: 0}, {path}
    while near:
        near = {file for file in everything if file not in distances and imports(tree, file) & near}
        distances |= dict.fromkeys(near, max(distances.values()) + 1)

    def order(file: Path) -> tuple[bool, int, bool, bool, int]:
        text = file.read_text()
        is_named = bool({*names} & {*re.findall(r"\w+", text)} - {""})
        is_called_like_it = path.stem in file.stem
        renders = "mark.render" in text
        return not is_called_like_it, distances[file], renders, not is_named, len(imports(tree, file))

    found = sorted((file for file in distances if file.name.startswith("test_")), key=order)
    yield from (found[i : i + FILES_AT_ONCE] for i in range(0, len(found), FILES_AT_ONCE))


def kill(mutant: Mutant, tree: Path) -> str:
    """The test that fails with a mutant, or nothing."""
    path = tree / mutant.path
    text = path.read_bytes()
    end_s = cpu_s() + LIMIT_S
    try:
        path.write_bytes(mutant.applied(text))
        for files in files_of_tests(tree, path, mutant.function.split(".")):
            if cpu_s() > end_s:
                break
            names = [str(file.relative_to(tree)) for file in files]
            options = ["-p", "no:cacheprovider", "-qx", "-rfE", "--timeout", str(TEST_LIMIT_S), *names]
            done = subprocess.run(
                [sys.executable, "-m", "pytest", *options],
                cwd=tree,
                env={**os.environ, "PYTHONPATH": str(tree), "MPLBACKEND": "Agg"},
                capture_output=True,
                text=True,
            )
            if done.returncode not in (0, 5):  # 5: all tests of these files are thorough
                failed = re.findall(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", done.stdout, re.M)
                return str(failed[0]) if failed else f"exit {done.returncode}: {(done.stdout + done.stderr)[-300:]}"
    finally:
        path.write_bytes(text)
    return ""


def kill_by_forks(tree: Path, asked: list[Mutant]) -> None:
    """Write the results of those mutants that are in functions."""
    from scripts.mutants_run import runs_in_functions

    inside = [asdict(mutant) for mutant in asked if runs_in_functions((tree / mutant.path).read_bytes(), mutant)]
    if inside:
        # By their keys, which mixes the subjects: whatever ends the run, some of each have a result.
        (tree.parent / "mutants.json").write_text(json.dumps(sorted(inside, key=itemgetter("key"))))
        environment = {**os.environ, "PYTHONPATH": str(tree), "MPLBACKEND": "Agg", "MUTANTS": str(tree.parent)}
        options = ["-p", "scripts.mutants_run", "-p", "no:cacheprovider", "-q", "--tb=native", "tests"]
        command = [sys.executable, "-m", "pytest", *options]
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True)
        if done.returncode > 1:
            raise click.ClickException(f"pytest ended with {done.returncode}: {(done.stdout + done.stderr)[-1000:]}")


def cpu_s() -> float:
    """The CPU time of all programs that ran until now."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--n", default=300, help="Mutants of all subjects together.")
@click.option("--only", multiple=True, type=click.Choice([*SUBJECTS]), help="A subject; may be given again.")
@click.option("--killed", type=click.Path(path_type=Path), help="Only mutants that were killed by this results.jsonl.")
def main(folder: Path, n: int, only: tuple[str, ...], killed: Path | None) -> None:
    """Copy the checkout as it is, run the mutants that have no result, and print all results."""
    tree, results = folder.resolve() / "tree", folder / "results.jsonl"
    copy_checkout(tree)
    asked = read(killed) if killed else {}
    wanted = [(s, m) for s, m in sampled(tree, n, [*(only or SUBJECTS)]) if not killed or asked.get(m.key)]
    kill_by_forks(tree, [mutant for _, mutant in wanted if mutant.key not in read(results)])
    done, rows = read(results), []
    for subject, mutant in wanted:
        if mutant.key not in done:
            done[mutant.key] = kill(mutant, tree)
            row = {"key": mutant.key, "killed_by": done[mutant.key], "mutant": str(mutant)}
            with results.open("a") as file:
                file.write(json.dumps(row) + "\n")
        rows.append((subject, mutant, done[mutant.key]))
        click.echo(f"{mutant}: {done[mutant.key] or 'SURVIVED'}")
    click.echo("\nSurvivors:")
    for _, mutant, killed_by in rows:
        if not killed_by:
            click.echo(mutant)
    for subject in [*dict.fromkeys(subject for subject, _, _ in rows), "all"]:
        found = [bool(killed_by) for s, _, killed_by in rows if subject in ("all", s)]
        click.echo(f"{subject}: {sum(found)} of {len(found)} killed")


def read(results: Path) -> dict[str, str]:
    """The tests that killed mutants, or nothing, by the mutants' keys."""
    lines = results.read_text().splitlines() if results.exists() else []
    return {row["key"]: row["killed_by"] for row in map(json.loads, lines)}


if __name__ == "__main__":
    main()
