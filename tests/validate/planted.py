"""Faults planted in copies of a small clean data set, and what validate says of each.

    python -m tests.validate.planted --write docs/validate_measured.md   # the table of this page, whole and anew
    python -m tests.validate.planted --only ids --write docs/validate_measured.md  # some of its rows anew
    python -m tests.validate.planted --params diverse --only ids         # the same elsewhere
    python -m tests.validate.planted --clean DIR DIR ...                 # false alarms and speed on clean data sets

A fault is planted in all samples that have what it changes. It is found in a sample where a problem of that sample
says one of its words, and over the whole set where a problem of the set does. Faults that files do not tell are
compared with the clean samples too, as `validate --rerender` does, which makes these again byte by byte. The command
exits with 1 if neither tells of a fault.
"""

import argparse
import re
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from synth3dlanes.dataset.format import HEIGHT, PASSES
from synth3dlanes.draw.sample import Scenes
from synth3dlanes.params.lidar_files import load_lidar
from synth3dlanes.params.params import Params, load_params
from synth3dlanes.params.shots import SINGLE
from synth3dlanes.production.plan import Plan
from synth3dlanes.production.recipe import Recipe
from synth3dlanes.production.run import generate
from synth3dlanes.scene.change import change_scene
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.settings import PASSES as ALL_PASSES
from synth3dlanes.scene.settings import RenderSettings
from synth3dlanes.system.errors import FormatError
from synth3dlanes.validate.made_again import compare
from synth3dlanes.world.world import World, resolve
from tests.validate import redone
from tests.validate.faults import FAULTS, OF_STREETS, OF_WORKS, UNSEEN, WORLDS, Fault
from tests.validate.faults import World as Changing
from tests.validate.sealing import Members, check, read_members, seal

IMAGE = "jpg"
# Few samples a pixel: passes are taken at the pixels' centres, and do not depend on them.
SETTINGS = RenderSettings(samples=2, passes=ALL_PASSES, device="cpu")
# Something of every kind in every scene.
STREETS = ["weather.kind=any", "weather.daytime=any", "road.n_oncoming=2", "road.median_m=4", "symbols.arrow_rows=2"]
STREETS += ["roadside.median=guardrail", "host.bonnet=0.12"]
# Road works in every scene, by day.
WORKS = ["works.present=true", "road.topology=1", "weather.kind=clear", "weather.daytime=day"]
# Faults that files do not tell, or not always: of pictures, and of what was rendered from another scene.
AGAIN = {f"again: {fault.name}": fault for fault in (*FAULTS, *UNSEEN) if fault.again == "image: "}
OTHERS = [Changing(f"world: {name}", changes, ": ") for name, changes in redone.WORLDS.items()]
NUMBERED = (*WORLDS, *OTHERS)
SAMPLE = re.compile(r"\w+:\d{8}")

COLUMNS = ("fault", "in samples", "found in", "found over the data set", "found in, made again", "message")
HEADER = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}"
HEADER_CLEAN = "| clean data set | samples | alarms | samples a second |\n|---|---|---|---|"


class Result(NamedTuple):
    """In how many samples a fault was planted, in how many it was named, whether over the whole set, one problem that
    names it, and in how many samples it was found by making them again (None: files are to tell it)."""

    fault: str
    planted: int
    samples: int
    over_all: bool
    named: str
    again: int | None = None

    @property
    def is_found(self) -> bool:
        """Over the whole set, or in most samples that have it: it may be out of sight in some."""
        return self.over_all or 2 * max(self.samples, self.again or 0) > self.planted > 0

    @property
    def is_silent(self) -> bool:
        """Neither files nor samples made again tell of it."""
        return not (self.over_all or self.samples or self.again)

    def row(self) -> str:
        """A row of the table."""
        again = "" if self.again is None else self.again
        over_all = "yes" if self.over_all else ""
        return f"| {self.fault} | {self.planted} | {self.samples} | {over_all} | {again} | {self.named} |"


@dataclass(frozen=True, kw_only=True)
class Worlds(Recipe):
    """Samples of a recipe in worlds that differ: sample i is `jobs[i]`, the number of a world and an index."""

    jobs: tuple[tuple[int, int], ...]

    def world(self, index: int) -> World:
        """The world of the changed scene, which keeps the index that it was drawn for."""
        number, source = self.jobs[index]
        return resolve(changed(super().world(source).scene, number))


def changed(scene: Scene, world: int) -> Scene:
    """A scene in another world; it may be the same."""
    return change_scene(scene, NUMBERED[world].changes(scene))


def render(folder: Path, params: Params, seed: int, n: int, workers: int, only: str = "") -> tuple[Path, list[Fault]]:
    """A clean data set of n samples with all passes, and all faults with `only` in their names that may be planted in
    it."""
    recipe = Recipe(Scenes(params, seed, "train"), SETTINGS, IMAGE)
    clean = folder / "clean"
    assert generate(Plan(clean, n, recipe, workers), lambda event: None).exit_code == 0
    counts = {w: n for w, world in enumerate(WORLDS) if only in world.name}
    return clean, [*FAULTS, *_worlds(folder / "worlds", recipe, counts, workers)]


def streets(seed: int) -> Recipe:
    """The recipe of samples of `streets` with a lidar."""
    shots = SINGLE.model_copy(update={"lidar": load_lidar("vlp_32c")})
    settings = replace(SETTINGS, passes=(*ALL_PASSES, "lidar"))
    return Recipe(Scenes(load_params("streets", STREETS), seed, shots=shots), settings, IMAGE)


def render_streets(folder: Path, seed: int, n: int, workers: int) -> tuple[Path, list[Fault]]:
    """A clean data set of n samples of `streets` with a lidar, and the faults that need one."""
    clean = folder / "streets"
    assert generate(Plan(clean, n, streets(seed), workers), lambda event: None).exit_code == 0
    return clean, OF_STREETS


def render_works(folder: Path, seed: int, n: int, workers: int) -> tuple[Path, list[Fault]]:
    """A clean data set of n samples of `streets` with road works, and the faults that need these."""
    clean, recipe = folder / "works", Recipe(Scenes(load_params("streets", WORKS), seed, "train"), SETTINGS, IMAGE)
    assert generate(Plan(clean, n, recipe, workers), lambda event: None).exit_code == 0
    return clean, OF_WORKS


def render_unseen(folder: Path, seed: int, n: int, workers: int, only: str = "") -> list[Fault]:
    """Faults of these samples with `only` in their names that files do not tell, or not always."""
    pictures = [Fault(name, fault.spoil, fault.again) for name, fault in AGAIN.items()]
    counts = {w: n for w, world in enumerate(NUMBERED) if w >= len(WORLDS) and only in world.name}
    recipe = streets(seed)
    recipe = replace(recipe, scenes=replace(recipe.scenes, shots=SINGLE), settings=SETTINGS)
    return [*pictures, *_worlds(folder / "unseen", recipe, counts, workers)]


def _worlds(root: Path, recipe: Recipe, counts: dict[int, int], workers: int) -> list[Fault]:
    """Faults that put pictures of other worlds, by number, into so many of the first samples of a recipe."""
    if not counts:
        return []
    scenes = [recipe.scene(index) for index in range(max(counts.values()))]
    jobs = tuple((w, i) for w, n in counts.items() for i in range(n) if changed(scenes[i], w) != scenes[i])
    worlds = Worlds(recipe.scenes, recipe.settings, recipe.image_format, jobs=jobs)
    assert generate(Plan(root, len(jobs), worlds, workers), lambda event: None).exit_code == 0
    rendered = read_members(root)
    others = {w: {i: rendered[job] for job, (at, i) in enumerate(jobs) if at == w} for w in counts}
    return [
        Fault(NUMBERED[w].name, None, NUMBERED[w].words, edit=partial(seal, change=partial(in_place, other)))
        for w, other in others.items()
    ]


def in_place(others: dict[int, Members], samples: dict[int, Members]) -> None:
    """Put other images and passes beside the labels."""
    for index, members in others.items():
        samples[index].update({name: members[name] for name in (IMAGE, PASSES, HEIGHT)})


def table(clean: Path, faults: Iterable[Fault], folder: Path) -> Iterator[Result]:
    """What validate says of each fault; it must say nothing of the clean data set."""
    problems = check(clean).problems
    assert not problems, problems[0].line()
    before = read_members(clean)
    for fault in faults:
        root = Path(shutil.copytree(clean, folder / "planted"))
        fault.plant(root)
        (split,) = {path.parent.name for path in root.glob("*/*.parquet")}
        n_planted = n_changed(before, root, split)
        is_known = fault.name not in AGAIN and fault.name not in {world.name for world in OTHERS}
        yield _result(fault, n_planted, root) if is_known else _again(fault, before, root)
        shutil.rmtree(root)


def _again(fault: Fault, before: dict[int, Members], root: Path) -> Result:
    """What files tell of a fault by any problem, and what the samples made again tell by its words."""
    problems = [problem for problem in check(root).problems if SAMPLE.fullmatch(problem.where)]
    spoilt = [(before[i], found) for i, found in read_members(root).items() if found != before[i]]
    told = [reasons for made, found in spoilt if (reasons := list(compare(redone.picture_of(made), made, found)))]
    every = [f"made again: {reason}" for reasons in told for reason in reasons]
    named = next((reason for reason in every if re.search(fault.words, reason)), every[0] if every else "missed")
    return Result(fault.name, len(spoilt), len({problem.where for problem in problems}), False, named, len(told))


def n_changed(before: dict[int, Members], root: Path, split: str) -> int:
    """How many samples differ; all, if none does or if the data set cannot be read."""
    try:
        after = read_members(root, split)
    except FormatError:
        return len(before)
    return sum(after[index] != before[index] for index in after) or len(after)


def _result(fault: Fault, n_planted: int, root: Path) -> Result:
    try:
        problems = check(root).in_order()
    except Exception as error:  # noqa: BLE001 - that validate crashes is what the table is to show
        return Result(fault.name, n_planted, 0, False, f"crash: {type(error).__name__}")
    firsts = list({problem.where: problem for problem in reversed(problems)}.values())
    asked = firsts if fault.is_first else problems
    named = [problem for problem in asked if re.search(fault.words, problem.reason)]
    samples = {problem.where for problem in named if SAMPLE.fullmatch(problem.where)}
    over_all = [problem.reason for problem in named if problem.where not in samples]
    reasons = over_all or [problem.reason for problem in named]
    kinds = Counter(re.sub(r"[\d.]+", "", reason) for reason in reasons)
    common = next((r for r in reasons if re.sub(r"[\d.]+", "", r) == kinds.most_common(1)[0][0]), "missed")
    return Result(fault.name, n_planted, len(samples), bool(over_all), " ".join(common.split()))


def false_alarms(root: Path) -> str:
    """A row on a clean data set, validated by one process."""
    start = time.perf_counter()
    report = check(root)
    per_s = report.n_samples / (time.perf_counter() - start)
    return f"| {root.name} | {report.n_samples} | {len(report.failed)} | {per_s:.1f} |"


def fill(page: Path, results: Sequence[Result], is_whole: bool) -> None:
    """Put rows into the table below the mark of a page, in place of those of the same faults, or of all if they are the
    whole table."""
    before, mark, rest = page.read_text().partition("<!-- planted -->\n")
    assert mark, f"{page}: expected a mark <!-- planted -->, got none"
    table, _, after = rest.partition("\n\n")
    rows = {} if is_whole else {line.split("|")[1].strip(): line for line in table.splitlines()[2:]}
    rows |= {result.fault: result.row() for result in results}
    page.write_text("\n".join([before + mark + HEADER, *rows.values()]) + "\n\n" + after)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table, write it if asked; 1 if nothing tells of one of its faults."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--params", default="appendix_i", help="the preset in which faults are planted")
    parser.add_argument("--n", type=int, default=12, help="its number of samples")
    parser.add_argument("--n-streets", type=int, default=4, help="the number of samples of streets")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--only", default="", help="plant faults with this in their names alone")
    parser.add_argument("--workers", type=int, default=1, help="processes that render")
    parser.add_argument("--data", type=Path, help="a folder that keeps what is rendered for the next time")
    parser.add_argument("--write", type=Path, help="the page that has the table")
    parser.add_argument("--clean", nargs="+", type=Path, help="clean data sets, for false alarms")
    options = parser.parse_args(arguments)
    if options.clean:
        print("\n".join([HEADER_CLEAN, *map(false_alarms, options.clean)]))  # noqa: T201
        return 0
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        rendered, few, workers = options.data or Path(folder, "rendered"), options.n_streets, options.workers

        def asked(faults: Iterable[Fault | Changing]) -> bool:
            return any(options.only in fault.name for fault in faults)

        sets: list[tuple[Path, list[Fault]]] = []
        if asked((*FAULTS, *WORLDS)):
            params = load_params(options.params)
            sets.append(render(rendered, params, options.seed, options.n, workers, only=options.only))
        if asked((*OF_STREETS, *OTHERS)) or any(options.only in name for name in AGAIN):
            root, of_streets = render_streets(rendered, options.seed, few, workers)
            sets += [(root, of_streets), (root, render_unseen(rendered, options.seed, few, workers, options.only))]
        if asked(OF_WORKS):
            sets.append(render_works(rendered, options.seed, few, workers))
        results = []
        print(HEADER)  # noqa: T201
        for root, planted in sets:
            for result in table(root, [fault for fault in planted if options.only in fault.name], Path(folder)):
                results.append(result)
                print(result.row(), flush=True)  # noqa: T201
                if options.write:
                    fill(options.write, [result], is_whole=False)
    if options.write and not options.only:
        fill(options.write, results, is_whole=True)
    return int(any(result.is_silent for result in results))


if __name__ == "__main__":
    # Workers must find the recipe under the module's own name, not as __main__.
    from tests.validate.planted import main as main_of_module

    raise SystemExit(main_of_module())
