"""The formats that are installed: entry points of the group `synth3dlanes.formats`, ours and others'."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points

from synth3dlanes.formats.format import Format, PinholeFormat
from synth3dlanes.system.errors import InputError

GROUP = "synth3dlanes.formats"
OURS = "synth3dlanes"


def format_names() -> tuple[str, ...]:
    """The names of all formats: ours in their order, then those of other packages. None is loaded."""
    return tuple(_entries())


@cache
def open_format(name: str) -> Format:
    """The format of this name. Raises InputError, in a line, for one that is not there or that its package cannot
    give."""
    entries = _entries()
    if name not in entries:
        raise InputError(
            f"format_name: expected one of {', '.join(entries) or 'those of an installed package'}, got {name!r}"
        )
    found = entries[name]
    first, *others = dict.fromkeys(map(_package, found))
    if others and first != OURS:
        raise InputError(f"format {name}: expected it of one package, got it of {', '.join((first, *others))}")
    try:
        loaded = found[0].load()
    except (Exception, SystemExit) as error:  # noqa: BLE001 whatever another package raises
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"format {name}: the package {first} cannot be loaded: {reason}") from None
    if not isinstance(loaded, Format):
        got = type(loaded).__name__
        raise InputError(f"format {name}: expected {found[0].value} of the package {first} to be a Format, got a {got}")
    return loaded


def described() -> list[tuple[str, str]]:
    """All formats by name, each with a line that says what it is, or why it cannot be used."""
    lines = []
    for name, entries in _entries().items():
        try:
            found = open_format(name)
            size = ", of any --size" if isinstance(found, PinholeFormat) and found.is_size_free else ""
            lines.append((name, f"{found.title}{size}"))
        except InputError as error:
            lines.append((name, f"cannot be used: {error}"))
        hidden = dict.fromkeys(_package(entry) for entry in entries if _package(entries[0]) == OURS != _package(entry))
        lines += [(name, f"of the package {package}: hidden by ours") for package in hidden]
    return lines


def _entries() -> dict[str, list[EntryPoint]]:
    """The entry points of each name, ours first."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: _package(entry) != OURS):
        found.setdefault(entry.name, []).append(entry)
    return found


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist else "?"
