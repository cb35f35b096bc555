"""The report of a validation: problems as text, with numbers beside their limits as JSON, and pictures of samples."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np
from fsspec.implementations.local import LocalFileSystem
from PIL import Image
from rich.console import Group, RenderableType
from rich.markup import escape

from synth3dlanes.dataset.address import connect, translate_store_errors
from synth3dlanes.figures.overlay import draw_overlay, stretches_img
from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.arrays import RgbImage
from synth3dlanes.system.errors import FormatError, OutageError
from synth3dlanes.system.files import Folder, encoded
from synth3dlanes.system.words import counted
from synth3dlanes.validate.findings import Bounded, Finding, Instant, Problem, Result
from synth3dlanes.validate.moving import between

FOLDER = "validation"
# Which parts of evidence each check lacked for a sample, by its name; None where no check was asked.
Lacks = Mapping[str, frozenset[str]] | None
# No lanes are drawn if a line extends farther than this outside the image.
MAX_PX = 1e5
# The verdicts on samples made again.
VERDICTS = ("equal bytes", "equal within the tolerances of another machine", "not equal")
# A number is tight from this share of its limit on.
TIGHT = 0.9


class Worst(NamedTuple):
    """The value, among `n` of one number, that is nearest to its limits or farthest beyond, and its sample."""

    n: int
    number: Bounded
    sample: str

    def summary(self) -> dict[str, float | str | None]:
        """For JSON."""
        worst = self.number
        values = {"worst": worst.value, "least": worst.least, "most": worst.most}
        told = {name: value if np.isfinite(value) else None for name, value in values.items()}
        verdict = "beyond" if worst.is_beyond else "tight" if worst.use > TIGHT else ""
        return {"n": self.n, **told, "sample": self.sample, "verdict": verdict}


@dataclass
class ValidationReport:
    """Collects samples one by one; samples without faults leave only counts, a few numbers and a digest each. `notes`
    say what is no fault, but may be unexpected; `asked` in how many samples each check was asked, `lacking` for lack of
    what it was not."""

    n_samples: int = 0
    problems: list[Problem] = field(default_factory=list)
    numbers: dict[str, Worst] = field(default_factory=dict)
    made_again: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    asked: dict[str, int] = field(default_factory=dict)
    lacking: dict[str, set[str]] = field(default_factory=dict)
    _owners: dict[tuple[str, str], tuple[str, str]] = field(default_factory=dict)
    _before: Instant | None = None

    def sample(self, name: str, results: Iterable[Result], lacks: Lacks = None) -> None:
        """Add one sample, in the order of its split. A world or a picture that occurred before is a problem of the
        sample that repeats it; objects that do not move as their velocities say are one of the later picture."""
        self.n_samples += 1
        for check, parts in (lacks or {}).items():
            self.asked[check] = self.asked.get(check, 0) + (not parts)
            self.lacking.setdefault(check, set()).update(parts)
        for result in results:
            if isinstance(result, Finding):
                self.problems.append(Problem(name, result.lane, result.reason))
            elif isinstance(result, Bounded):
                before = self.numbers.get(result.name, Worst(0, result, name))
                nearest = (result, name) if result.use > before.number.use else before[1:]
                self.numbers[result.name] = Worst(before.n + 1, *nearest)
            elif isinstance(result, Instant):
                moved = [] if self._before is None else between(self._before, result)
                self.problems += [Problem(name, found.lane, found.reason) for found in moved]
                self._before = result
            else:
                first, at = self._owners.setdefault((result.what, result.digest), (name, result.at))
                if first != name and (not at or at != result.at):
                    reason = f"expected a {result.what} of its own, got that of {first}"
                    self.problems.append(Problem(name, "", reason))

    def in_order(self) -> list[Problem]:
        """The problems by sample and file; of each in the order of the checks, whose first name the cause."""
        return sorted(self.problems, key=lambda problem: problem.where)

    @property
    def failed(self) -> list[str]:
        """The samples and files that have a problem."""
        return sorted({problem.where for problem in self.problems})

    def document(self) -> dict[str, Any]:
        """The report for JSON."""
        return {
            "samples": self.n_samples,
            "failed": self.failed,
            "problems": [problem._asdict() for problem in self.in_order()],
            "checks": {name: {"samples": n, "lacks": sorted(self.lacking[name])} for name, n in self.asked.items()},
            "numbers": {name: found.summary() for name, found in sorted(self.numbers.items())},
            "made_again": self.made_again,
            "notes": self.notes,
        }

    def text(self) -> RenderableType:
        """What samples made again are, what was not asked, then one line per note and per problem."""
        parts = [*made_again_text(self.made_again), *self._not_asked(), ""]
        parts += [f"[yellow]{escape(note)}[/yellow]" for note in self.notes]
        parts += [f"[red]{escape(problem.line())}[/red]" for problem in self.in_order()]
        verdict = f"[red]{len(self.failed)} failed[/red]" if self.problems else "[green]all right[/green]"
        if not self.problems and self.n_samples == 0:
            verdict = "[yellow]the files are all right, labels and pixels were not looked at[/yellow]"
        return Group(*parts, f"{counted(self.n_samples, 'sample')} checked: {verdict}")

    def _not_asked(self) -> Iterator[str]:
        """Lines that name the checks that no sample was asked, by what all samples lack."""
        by_lack: dict[str, list[str]] = {}
        for name in (name for name, n in self.asked.items() if not n):
            lacks = ["scene"] if "scene" in self.lacking[name] else sorted(self.lacking[name])
            by_lack.setdefault(" and ".join(lacks), []).append(name)
        if by_lack:
            yield "\n[bold]not asked[/bold]  what these checks need is not there"
        yield from (f"  no {lack}: {', '.join(names)}" for lack, names in by_lack.items())


def made_again_text(verdicts: dict[str, str]) -> Iterator[str]:
    """Which samples were made again, with what result."""
    if verdicts:
        yield "\n[bold]made again[/bold]  as dataset.json says; the same command chooses the same, a larger number more"
    for verdict in VERDICTS:
        if verdict in verdicts.values():
            yield f"  {verdict}: {', '.join(name for name, own in verdicts.items() if own == verdict)}"


def draw(image: RgbImage, labels: Labels) -> RgbImage:
    """The image with its lanes, if these can be drawn."""
    lines_img = [line for lane in labels.lanes for _, line in stretches_img(labels.camera, lane)]
    return draw_overlay(image, labels) if all((np.abs(line) < MAX_PX).all() for line in lines_img) else image


def save_picture(place: str, name: str, picture: RgbImage) -> None:
    """Write a picture into the data set; does nothing if the store or the folder cannot be written."""
    files, root = connect(place)
    path, png = f"{FOLDER}/{name}.png", encoded(lambda stream: Image.fromarray(picture).save(stream, "PNG"))
    with suppress(FormatError, OutageError, OSError), translate_store_errors(place):
        if isinstance(files, LocalFileSystem):
            Folder(Path(root)).make(PurePath(path).parent)
            Folder(Path(root)).write(path, png)
        else:
            files.pipe_file(f"{root}/{path}", png)


def remove_pictures(place: str) -> None:
    """Remove the pictures of an earlier validation."""
    files, root = connect(place)
    if isinstance(files, LocalFileSystem):
        with suppress(OSError):
            folder = Folder(Path(root))
            for name in folder.names(FOLDER):
                if name.endswith(".png"):
                    folder.remove(f"{FOLDER}/{name}")
        return
    with suppress(FormatError, OutageError), translate_store_errors(place):
        for path in files.find(f"{root}/{FOLDER}", maxdepth=1):
            if str(path).endswith(".png"):
                files.rm_file(path)
