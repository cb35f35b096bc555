"""The members of a sample: their names, their bytes, and how a tar holds them (docs/format.md).

Nothing here opens a file. Equal samples give equal bytes.
"""

import io
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import OpenEXR
from jaxtyping import Shaped, UInt8
from PIL import Image, ImageOps, UnidentifiedImageError

from synth3dlanes.imaging.sweep import Sweep
from synth3dlanes.labels import labels as labels_module
from synth3dlanes.labels.labels import Labels, LidarLabel
from synth3dlanes.scene.settings import JPEG_QUALITY
from synth3dlanes.system.arrays import Passes
from synth3dlanes.system.errors import FormatError
from synth3dlanes.system.schema import MAX_PX

IMAGE_FORMATS = ("jpg", "png")
SCENE, LABELS, PASSES, HEIGHT, LIDAR = "scene.json", "labels.json", "passes.exr", "height.exr", "lidar.exr"
# A name in the index for each member of a sample; the image's is the same for every image format.
COLUMN_OF_MEMBER = {
    "jpg": "image", "png": "image", SCENE: "scene", LABELS: "labels", PASSES: "passes", HEIGHT: "height", LIDAR: "lidar"
}  # fmt: skip
BLOCK = 512
STRIP_PX = 512
# The tag of EXIF that says how pixels are to be turned, and its values that exchange width and height.
ORIENTATION, QUARTER_TURNS = 0x0112, (5, 6, 7, 8)

# Integers up to here are exact in a half float.
EXACT_IN_HALF = 2048
METRES = ("depth", "height", "range")
NORMAL = ("normal.X", "normal.Y", "normal.Z")
CHANNEL_TYPES = {
    **dict.fromkeys(METRES, (np.float32,)),
    **dict.fromkeys(NORMAL, (np.float16,)),
    **dict.fromkeys(("semantic", "instance"), (np.float16, np.float32)),
}


@dataclass(frozen=True, eq=False)
class Sample:
    """One labelled image as read from a data set. `scene_json` is the scene as text, which `synth3dlanes render` reads;
    None of a sample that was lifted from a real drive."""

    key: str
    image: UInt8[np.ndarray, "h w 3"]
    labels: Labels
    scene_json: bytes | None


@dataclass(frozen=True, eq=False)
class Picture:
    """A scene rendered: image and labels, the passes asked for, and the sweep of its lidar, if it has one."""

    image: UInt8[np.ndarray, "h w 3"]
    labels: Labels
    passes: Passes = field(default_factory=dict)
    sweep: Sweep | None = None


def key_of(index: int) -> str:
    """The key of sample `index` of a split: eight digits, without a dot, because webdataset cuts a key at its first
    dot."""
    return f"{index:08d}"


def member_names(image_format: str, passes: Sequence[str], has_scene: bool = True) -> tuple[str, ...]:
    """The names of a sample's members without their key, in the order of the tar."""
    own = {"height": HEIGHT, "lidar": LIDAR}
    pixel_passes = [PASSES] if set(passes) - set(own) else []
    scene = [SCENE] if has_scene else []
    return (image_format, *scene, LABELS, *pixel_passes, *(member for name, member in own.items() if name in passes))


def encode(picture: Picture, scene_json: str, image_format: str, jpeg_quality: int = JPEG_QUALITY) -> dict[str, bytes]:
    """The bytes of a sample's members, by the names that `member_names` gives."""
    members = {
        image_format: encode_image(picture.image, image_format, jpeg_quality),
        SCENE: scene_json.encode(),
        LABELS: labels_module.to_json(picture.labels).encode(),
    }
    of_pixels = {name: values for name, values in picture.passes.items() if name != "height"}
    if of_pixels:
        members[PASSES] = write_passes(of_pixels)
    if "height" in picture.passes:
        members[HEIGHT] = write_passes({"height": picture.passes["height"]})
    if picture.sweep is not None:
        members[LIDAR] = write_sweep(picture.sweep)
    return members


def encode_image(image: UInt8[np.ndarray, "h w 3"], image_format: str, jpeg_quality: int = JPEG_QUALITY) -> bytes:
    """The image as JPEG, or as PNG, which is lossless."""
    stream = io.BytesIO()
    if image_format == "jpg":
        Image.fromarray(image).save(stream, "JPEG", quality=jpeg_quality)
    else:
        Image.fromarray(image).save(stream, "PNG")
    return stream.getvalue()


def decode_image(
    data: bytes,
    where: str,
    size_px: tuple[int, int] | None = None,
    kinds: tuple[str, ...] = ("JPEG", "PNG"),
    is_turned: bool = False,
) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of an image file of one of these kinds. `size_px` is the expected (width, height); None allows any
    size up to 8192 x 8192. With `is_turned`, they are turned as the file says that it is to be shown (EXIF).

    Raises FormatError, whose message begins with `where`. The size is checked before pixels are decoded.
    """
    expected = f"expected a {' or '.join(kinds)} image"
    try:
        image = Image.open(io.BytesIO(data), formats=kinds)
        _check_size(shown_size(image) if is_turned else image.size, size_px, where)
        if is_turned:
            ImageOps.exif_transpose(image, in_place=True)
        return _pixels_of(_as_rgb(image))
    except FormatError:
        raise
    except UnidentifiedImageError:
        raise FormatError(f"{where}: {expected}, got other or damaged bytes") from None
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise FormatError(f"{where}: expected at most {MAX_PX}x{MAX_PX} pixels, got more") from None
    except (OSError, SyntaxError, ValueError) as error:
        raise FormatError(f"{where}: {expected}, got {error}") from None


def must_be_turned(data: bytes) -> bool:
    """Whether an image file says that its pixels are to be turned or mirrored when it is shown (EXIF)."""
    return Image.open(io.BytesIO(data)).getexif().get(ORIENTATION, 1) != 1


def shown_size(image: Image.Image) -> tuple[int, int]:
    """Width and height of an image as its file says that it is to be shown (EXIF)."""
    width, height = image.size
    return (height, width) if image.getexif().get(ORIENTATION, 1) in QUARTER_TURNS else (width, height)


def _as_rgb(image: Image.Image) -> Image.Image:
    if image.mode == "RGB":
        return image
    if image.mode.startswith("I"):
        # Pillow would cut 16-bit values at 255.
        image = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
    return image.convert("RGB")


def _pixels_of(image: Image.Image) -> UInt8[np.ndarray, "h w 3"]:
    """The pixels of an RGB image, copied in strips: Pillow copies what it hands over twice."""
    pixels = np.zeros((image.height, image.width, 3), np.uint8)
    for top in range(0, image.height, STRIP_PX):
        bottom = min(top + STRIP_PX, image.height)
        pixels[top:bottom] = np.asarray(image.crop((0, top, image.width, bottom)))
    return pixels


def _check_size(found: tuple[int, int], expected: tuple[int, int] | None, where: str) -> None:
    """Raise FormatError for an image of another size than expected, or, if none is expected, for one above 8192
    pixels."""
    if found != expected and (expected or max(found) > MAX_PX):
        width, height = expected or (MAX_PX, MAX_PX)
        most = "" if expected else "at most "
        raise FormatError(f"{where}: expected {most}{width}x{height} pixels, got {found[0]}x{found[1]}")


def write_passes(passes: Mapping[str, Shaped[np.ndarray, "..."]]) -> bytes:
    """The passes as one OpenEXR image with ZIP compression, which is lossless.

    Channels in float32: `depth` is planar y_cam in metres at the pixel's centre, infinite where nothing is hit;
    `height` is metres over the road plane (`world.height_map`); `range` is a sweep's, in metres. Channels in half
    precision: `normal.X`, `normal.Y`, `normal.Z`; `semantic` and `instance`, which are float32 if an id exceeds 2048.
    """
    channels: dict[str, np.ndarray] = {}
    for name, values in passes.items():
        if name in METRES:
            channels[name] = values.astype(np.float32)
        elif name == "normal":
            channels |= {axis: values[..., i].astype(np.float16) for i, axis in enumerate(NORMAL)}
        else:
            channels[name] = values.astype(np.float16 if values.max() <= EXACT_IN_HALF else np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    stream = io.BytesIO()
    OpenEXR.File(header, {name: np.ascontiguousarray(channel) for name, channel in channels.items()}).write(stream)
    return stream.getvalue()


def read_passes(
    data: bytes, where: str, size_px: tuple[int, int] | None = None
) -> dict[str, Shaped[np.ndarray, "..."]]:
    """The passes by name: `depth`, `height`, `range` and `normal` as float32, `semantic` as uint8, `instance` as
    uint16.

    Raises FormatError, whose message begins with `where`, for a file that `write_passes` does not write, and for
    another size than `size_px` (width, height; None allows any size up to 8192 x 8192). The size is checked before
    pixels are decoded.
    """
    try:
        _check_size(_exr_size(data), size_px, where)
        channels = OpenEXR.File(io.BytesIO(data), separate_channels=True).channels()
        pixels = {name: channel.pixels for name, channel in channels.items()}
    except FormatError:
        raise
    except (ArithmeticError, LookupError, MemoryError, RuntimeError, TypeError, ValueError):
        raise FormatError(f"{where}: expected an OpenEXR image, got other or damaged bytes") from None
    for name, values in pixels.items():
        if values.dtype not in CHANNEL_TYPES.get(name, ()):
            types = " or ".join(np.dtype(dtype).name for dtype in CHANNEL_TYPES.get(name, ()))
            raise FormatError(f"{where}: {name}: expected {types or 'no such channel'}, got {values.dtype}")
    if len({values.shape for values in pixels.values()}) > 1:
        raise FormatError(f"{where}: expected channels of one size, got several")
    passes = {name: pixels[name] for name in METRES if name in pixels}
    for name, dtype in (("semantic", np.uint8), ("instance", np.uint16)):
        if name in pixels:
            passes[name] = _ids(pixels[name], dtype, f"{where}: {name}")
    normal = [pixels[name] for name in NORMAL if name in pixels]
    if normal and len(normal) < len(NORMAL):
        raise FormatError(f"{where}: expected channels {', '.join(NORMAL)}, got {len(normal)} of them")
    return passes | ({"normal": np.stack(normal, axis=-1).astype(np.float32)} if normal else {})


def write_sweep(sweep: Sweep) -> bytes:
    """A sweep as OpenEXR: a row for each beam, a column for each azimuth."""
    return write_passes({"range": sweep.range_m, "semantic": sweep.semantic, "instance": sweep.instance})


def read_sweep(data: bytes, where: str, lidar: LidarLabel) -> Sweep:
    """Read the sweep of a lidar. Raises FormatError like `read_passes`, and for ranges that the lidar cannot
    measure."""
    channels = read_passes(data, where, (lidar.azimuths, len(lidar.elevations_rad)))
    if set(channels) != {"range", "semantic", "instance"}:
        raise FormatError(f"{where}: expected channels range, semantic, instance, got {', '.join(channels)}")
    sweep = Sweep(lidar, channels["range"], channels["semantic"], channels["instance"])
    measured = sweep.range_m[sweep.returned]
    if not ((measured >= lidar.min_range_m) & (measured <= lidar.max_range_m)).all():
        raise FormatError(
            f"{where}: range: expected {lidar.min_range_m:g} to {lidar.max_range_m:g} m or infinity, got others"
        )
    return sweep


def _exr_size(data: bytes) -> tuple[int, int]:
    """Width and height of an OpenEXR image, from its header."""
    low, high = OpenEXR.File(io.BytesIO(data), separate_channels=True, header_only=True).header()["dataWindow"]
    width, height = (int(size) for size in high.astype(int) - low + 1)
    return width, height


def _ids(values: Shaped[np.ndarray, "h w"], dtype: type[np.unsignedinteger], where: str) -> Shaped[np.ndarray, "h w"]:
    """Integers that were stored as floats."""
    with np.errstate(invalid="ignore"):
        ids = values.astype(dtype)
    if not np.array_equal(ids, values):
        raise FormatError(f"{where}: expected whole numbers from 0 to {np.iinfo(dtype).max}, got others")
    return ids


def tar_bytes(key: str, members: Mapping[str, bytes]) -> bytes:
    """The members as the bytes of a tar without its end, with fixed time, owner and mode. Several such pieces may be
    joined."""
    pieces = []
    for name, data in members.items():
        header = tarfile.TarInfo(f"{key}.{name}")
        header.size = len(data)
        pieces += [header.tobuf(tarfile.USTAR_FORMAT), data, bytes(-len(data) % BLOCK)]
    return b"".join(pieces)


def tar_end(size: int) -> bytes:
    """The bytes that end a tar of `size` bytes: two empty blocks, and padding to a whole record."""
    return bytes(2 * BLOCK + -(size + 2 * BLOCK) % tarfile.RECORDSIZE)


def member_name(header: bytes) -> str:
    """The file name in a tar header, to check that an index points at the right member."""
    return header[:100].rstrip(b"\0").decode("utf-8", "replace")


def read_header(block: bytes) -> tuple[str, int]:
    """Name and size of the member that a tar header describes; ("", 0) for the empty block that ends a tar. Raises
    FormatError for anything but a plain file."""
    if not any(block):
        return "", 0
    try:
        header = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
    except tarfile.HeaderError as error:
        raise FormatError(f"expected the header of a tar, got {error}") from None
    if not header.isreg() or header.size < 0:
        raise FormatError(f"expected a plain file in a tar, got {header.name!r:.40} of {header.size} bytes")
    return header.name, header.size


def tar_members(stream: Any, size: int) -> Iterator[tuple[str, int, int]]:
    """Name, offset and size of each complete member of an open tar of `size` bytes. Raises FormatError at the first
    fault."""
    offset = 0
    while offset < size:
        stream.seek(offset)
        name, length = read_header(stream.read(BLOCK))
        if not name:
            return
        end = offset + BLOCK + length + -length % BLOCK
        if end > size:
            raise FormatError(f"expected {end} bytes or more, got {size}")
        yield name, offset + BLOCK, length
        offset = end
