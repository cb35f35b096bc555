"""The tables of docs/ that repeat a table of the code; each is between `<!-- table NAME -->` and an empty line."""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, get_args

from synth3dlanes.dataset.columns import ADDED_PARTS, PARTS, PREFIXES, SCHEMA
from synth3dlanes.dataset.index import ADDED
from synth3dlanes.formats.format import PinholeFormat, format_names, open_format
from synth3dlanes.geometry.lens import COEFFICIENTS
from synth3dlanes.scene.assets.catalogue import THING_FOLDERS, THINGS
from synth3dlanes.scene.scene import Scene
from synth3dlanes.scene.things import KINDS, ClassNaming


def with_tables(page: str) -> str:
    """A page with its tables made anew."""
    return re.sub(
        r"(?<=<!-- table )(\w+)( -->\n\n).*?(?=\n\n)",
        lambda found: found[1] + found[2] + TABLES[found[1]](),
        page,
        flags=re.DOTALL,
    )


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows))


def _code(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def _classes() -> str:
    rows = ((str(kind.semantic_id), f"`{kind.name}`", kind.series, kind.word) for kind in KINDS)
    return _table(("id", "class", "instance ids of", "colour in our pictures"), rows)


def _categories() -> str:
    names = get_args(ClassNaming)
    rows = (
        (f"`{of.category}`", f"`{kind.name}`", *(_code(filter(None, [getattr(of, name)])) for name in names))
        for kind in KINDS
        for of in kind.objects
    )
    return _table(("category", "class", *(f"in `{name}`" for name in names)), rows)


def _columns() -> str:
    """The columns that a sample has from the fields of its scene."""
    parts: dict[str, Any] = {**PARTS, **{name: Scene.model_fields[name].annotation for name in ADDED_PARTS}}
    rows = []
    for group, part in parts.items():
        columns = [PREFIXES.get(group, "") + name for name in part.model_fields]
        first, added = ([name for name in columns if name in known] for known in (SCHEMA.names, ADDED))
        rows.append((f"`{group}`", _code(first), ", ".join(f"`{name}` {json.dumps(ADDED[name])}" for name in added)))
    return _table(("part of the scene", "columns", "added after version 0.1.0, with their defaults"), rows)


def _export_cameras() -> str:
    formats = {name: open_format(name) for name in format_names()}
    rows = (
        (
            f"`{name}`",
            f"{found.camera.width_px}x{found.camera.height_px}",
            f"{found.camera.f_px:.5g} px" + ", or longer for images with a narrower field of view" * found.is_f_free,
        )
        for name, found in formats.items()
        if isinstance(found, PinholeFormat)
    )
    return _table(("format", "image", "focal length"), rows)


def _lenses() -> str:
    return _table(("model", "coefficients"), ((f"`{model}`", _code(names)) for model, names in COEFFICIENTS.items()))


def _things() -> str:
    rows = (
        (f"`{folder}/`", f"`{kind}`", _code(model.name for model in THINGS[kind]))
        for folder, kind in THING_FOLDERS.items()
    )
    return _table(("folder", "kind", "built-in models, from number 1"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "categories": _categories,
    "classes": _classes,
    "columns": _columns,
    "export_cameras": _export_cameras,
    "lenses": _lenses,
    "things": _things,
}
