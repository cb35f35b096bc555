"""Change a copy of a data set and seal it again, so that its index and digests are those of what is there now."""

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from synth3dlanes.dataset.description import recipe_text
from synth3dlanes.dataset.folder import COMPANIONS, updated_companions
from synth3dlanes.dataset.format import LABELS, key_of
from synth3dlanes.dataset.read import Reader
from synth3dlanes.dataset.write import Shard
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.labels.labels import Labels
from synth3dlanes.system.errors import FormatError
from synth3dlanes.validate.report import ValidationReport

SHARD_SIZE = 1000

Members = dict[str, bytes]
Change = Callable[[dict[int, Members]], None]


def read_members(root: Path, split: str = "train") -> dict[int, Members]:
    """The bytes of every sample of a split, by index."""
    reader = Reader(f"{root}/{split}")
    return {int(reader.key(i)): reader.raw(i) for i in range(len(reader))}


def seal(root: Path, change: Change, split: str = "train") -> None:
    """Rewrite a split with its samples changed."""
    samples = read_members(root, split)
    change(samples)
    names = tuple(next(iter(samples.values())))
    for path in (root / split).glob("00000.*"):
        path.unlink()
    recipe = recipe_text(json.loads((root / "dataset.json").read_text()))
    shard = Shard(root / split, 0, SHARD_SIZE, names, recipe)
    for index, members in samples.items():
        shard.write_part(index, members)
    shard.join(SHARD_SIZE)


def describe(root: Path, change: Callable[[dict], object]) -> None:
    """Change a copy's dataset.json."""
    path = root / "dataset.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    beside = {name: (root / name).read_bytes() if (root / name).exists() else None for name in COMPANIONS}
    # A description that says nothing has no companions.
    with suppress(FormatError):
        for name, data in updated_companions(beside, path.read_bytes(), str(path)).items():
            if beside[name] is not None:
                (root / name).write_bytes(data)


def drop_passes(root: Path) -> None:
    """The same dataset as if made without passes."""
    describe(root, lambda document: document["render"].update(passes=[]))
    # What dataset.json does not name is not read.
    seal(root, lambda samples: None)


def relabel(index: int, change: Callable[[Labels], Labels]) -> Change:
    """A change of one sample's labels."""

    def apply(samples: dict[int, Members]) -> None:
        labels = labels_module.from_json(samples[index][LABELS], key_of(index))
        samples[index][LABELS] = labels_module.to_json(change(labels)).encode()

    return apply


def check(root: Path, workers: int = 1) -> ValidationReport:
    """Validate all of it."""
    from synth3dlanes.validate.run import validate

    return validate(root, workers, None, lambda done, total: None)
