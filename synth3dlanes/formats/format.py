"""What a format is: how its frames are written, read back, and compared with the data set; docs/exports.md says how to
add one. Those that are installed are entry points of the group `synth3dlanes.formats`, ours and others'."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synth3dlanes.formats.comparing import Comparison, SourceSample
from synth3dlanes.formats.writing import PARTS, ExportFrame, FrameAnnotation, Pinhole, PinholeFrame
from synth3dlanes.labels.labels import CameraLabel
from synth3dlanes.system.arrays import Passes
from synth3dlanes.system.words import counted

if TYPE_CHECKING:
    # Who reads a format needs neither.
    import synth3dlanes.imaging.sweep
    import synth3dlanes.scene.scene
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from synth3dlanes.system.errors import InputError


@dataclass(frozen=True, eq=False, kw_only=True)
class SampleFrame(ExportFrame):
    """A frame taken as it is (a rolled camera stays rolled), with its scene, its passes by name if the format asks for
    any, and the sweep of its lidar if there is one and the format takes it. The image is of `image_format`, jpg or png.
    `cameras` are those of all exported pictures of this moment by a rig, itself included, by their keys: for the first
    of them, none for the others. `is_first` says whether it is the first exported picture of its scene. `pictures`
    gives, one after the other, those of its scene by the camera of the sample of this key."""

    scene: "synth3dlanes.scene.scene.Scene"
    passes: Passes
    image_format: str
    sweep: "synth3dlanes.imaging.sweep.Sweep | None" = None
    cameras: Mapping[str, CameraLabel] = field(default_factory=dict)
    is_first: bool = True
    pictures: Callable[[str], Iterator[SourceSample]] = lambda key: iter(())


@dataclass(frozen=True, eq=False)
class ReadFrame:
    """A frame as the files of an export say. `file` is one that this frame alone has, by its path in the export;
    `where` is what messages begin with; `content` is what the format's `verify` takes. Without `image`, there is none;
    `more_images` are those of the other cameras of its moment.
    """

    file: str
    where: str
    image: str | None
    content: Any
    more_images: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FrameList:
    """Some frames of an export, such as those of one of its lists; `word` is what one is called."""

    name: str
    frames: Iterator[ReadFrame]
    word: str = "frame"


def of_parts(out: Path, word: str, frames: Callable[[str], Iterator[ReadFrame]]) -> Iterator[FrameList]:
    """The parts of an export with a folder for each; `frames` reads those of one, `word` is what one is called."""
    for part in PARTS:
        if (out / part).is_dir() and not (out / part).is_symlink():
            yield FrameList(part, frames(part), word)


def maps_of(out: Path, ending: str, most_frames: int, content: Callable[[Path], Any]) -> Iterator[FrameList]:
    """The maps of every split of an export that has a file of this ending for each scene; `content` reads one."""
    for folder in sorted({path.parent for path in out.glob(f"*/*.{ending}")}):
        paths = sorted(folder.glob(f"*.{ending}"))[:most_frames]
        frames = (ReadFrame(str(path.relative_to(out)), str(path), None, content(path)) for path in paths)
        yield FrameList(folder.name, frames, "map")


@dataclass(frozen=True)
class Rates:
    """What a benchmark gives the predictions for a list of frames: its own numbers by name."""

    name: str
    n_frames: int
    rates: Mapping[str, float]

    def text(self) -> str:
        rates = "  ".join(f"{name} {rate:.4f}" for name, rate in self.rates.items())
        return f"{self.name}: {counted(self.n_frames, 'frame')}\n  {rates}"

    def document(self) -> dict[str, Any]:
        return {"name": self.name, "frames": self.n_frames, "rates": dict(self.rates)}


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format. `title` says in a line what it is, `readme` is part of the README of an export.

    - `write` gives the files of a frame; None where the format has no place for it.
    - `read` gives the lists of an export, each with at most `most_frames`. Raises FormatError.
    - `verify` says how far a frame that was read is from the sample that it was made from; `tolerances` are how far it
      may be, by unit (m, px), because of the format's own grid.
    - `score` gives the benchmark's rates of predictions (a file or folder) for an export, if there is a benchmark.

    `links` are links within an export, made where their target is and nothing is in their place; `lists` are files that
    tools open even where no frame belongs there; `replaced_words` what tools replace wherever a path has it; `counted`
    is what `n_lines` counts. A shared file holds the lines of its frames. If one is to be a document, `document` makes
    each shared file, the sidecar too, in pieces, of its path in the export and the file of its lines.
    """

    title: str
    readme: str
    write: Callable[[Any], FrameAnnotation | None]
    read: Callable[[Path, int], Iterator[FrameList]]
    verify: Callable[[ReadFrame, SourceSample], Comparison]
    tolerances: Mapping[str, float]
    score: Callable[[Path, Path], Iterator[Rates]] | None = None
    links: Mapping[str, str] = field(default_factory=dict)
    lists: tuple[str, ...] = ()
    replaced_words: tuple[str, ...] = ()
    document: Callable[[str, Path], Iterator[str] | Iterator[bytes]] | None = None
    counted: str = "lane lines"


@dataclass(frozen=True, kw_only=True)
class PinholeFormat(Format):
    """A format with a camera of its own, to which images are resampled.

    A frame that is too narrow for the camera gets a longer focal length of its own if `is_f_free`, and is left out
    otherwise; images may have any size if `is_size_free`. Frames come with their kerbs if it `has_kerbs`.
    """

    camera: Pinhole
    is_f_free: bool
    is_size_free: bool
    has_kerbs: bool = False
    write: Callable[[PinholeFrame], FrameAnnotation | None]


@dataclass(frozen=True, kw_only=True)
class SampleFormat(Format):
    """A format that takes samples as they are. Images are copied byte for byte, and encoded anew only if their path
    asks for the other image format.

    Data sets must have the passes `passes`; frames come with their sweeps if it `takes_sweeps`. If it `is_per_scene`,
    only the first frame of each scene is written. Its files say more than where lanes are, so data sets that were
    lifted from real drives cannot have it: they have no scenes.
    """

    passes: tuple[str, ...] = ()
    takes_sweeps: bool = False
    is_per_scene: bool = False
    write: Callable[[SampleFrame], FrameAnnotation | None]


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


@cache
def _entries() -> dict[str, list[EntryPoint]]:
    """The entry points of each name, ours first. What all packages say of themselves is read for it."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: _package(entry) != OURS):
        found.setdefault(entry.name, []).append(entry)
    return found


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist else "?"
