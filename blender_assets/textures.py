"""Tileable surface textures (albedo, roughness, normal) and the lane-aligned wear maps, as JPEG files.

Albedos are painted in linear reflectance and stored as sRGB; a normal map holds the tilt of a height field in
metres over a tile of `tile_m`, x right and y up (OpenGL convention).
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from noise import cells, clouds, smoothstep
from PIL import Image

SIZE = (1024, 1024)
WEAR_SIZE = (2048, 512)  # 48 m of road by two lanes


@dataclass(frozen=True)
class Surface:
    """Linear reflectance, roughness 0..1 and height in metres, with the tile's nominal side."""

    albedo: Float[np.ndarray, "h w 3"]
    roughness: Float[np.ndarray, "h w"]
    height_m: Float[np.ndarray, "h w"]
    tile_m: float


def tint(gray: Float[np.ndarray, "h w"], color: tuple[float, float, float]) -> Float[np.ndarray, "h w 3"]:
    """A gray map times a colour."""
    return gray[..., None] * np.asarray(color)


def blend(
    a: Float[np.ndarray, "h w 3"], b: Float[np.ndarray, "h w 3"], mask: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """`a` where the mask is 0, `b` where it is 1."""
    return a + (b - a) * mask[..., None]


def fresh_asphalt(rng: np.random.Generator) -> Surface:
    """Dark bitumen with fine pale aggregate."""
    grain = clouds(rng, SIZE, 120, 512, 0.0)
    mottle = clouds(rng, SIZE, 10, 120, 0.7)
    stones = smoothstep(1.2, 2.2, clouds(rng, SIZE, 150, 420, 0.0))
    gray = 0.066 * np.exp(0.16 * mottle + 0.30 * grain) + 0.10 * stones
    return Surface(tint(gray, (1.0, 1.0, 1.03)), 0.62 + 0.06 * grain, 0.0012 * grain, 5.0)


def worn_asphalt(rng: np.random.Generator) -> Surface:
    """Bleached asphalt: coarse aggregate worn bare, hairline cracks."""
    grain = clouds(rng, SIZE, 100, 512, 0.0)
    mottle = clouds(rng, SIZE, 9, 90, 0.6)
    stones = smoothstep(0.9, 2.0, clouds(rng, SIZE, 110, 330, 0.0))
    _, border = cells(rng, SIZE, 14, 14.0)
    weak = smoothstep(-0.2, 0.8, clouds(rng, SIZE, 1, 5, 0.5))
    crack = (1 - smoothstep(0.5, 1.6, border)) * weak
    gray = 0.100 * np.exp(0.11 * mottle + 0.26 * grain) + 0.10 * stones
    gray *= 1 - 0.6 * crack
    return Surface(tint(gray, (1.03, 1.0, 0.95)), 0.74 + 0.06 * grain, 0.0016 * grain - 0.004 * crack, 5.0)


def concrete(rng: np.random.Generator) -> Surface:
    """Pale cement, brushed across the road, with pores and blotches; the joints are in its wear map."""
    brush = clouds(rng, (SIZE[0], 8), 100, 512, 0.0)[:, :1] + 0.6 * clouds(rng, SIZE, 60, 512, 0.0)
    mottle = clouds(rng, SIZE, 7, 160, 0.8)
    pores = smoothstep(2.0, 2.8, clouds(rng, SIZE, 120, 400, 0.0))
    gray = 0.205 * np.exp(0.10 * mottle + 0.05 * brush) * (1 - 0.45 * pores)
    return Surface(tint(gray, (1.04, 1.0, 0.92)), 0.70 + 0.05 * mottle, 0.0007 * brush - 0.002 * pores, 5.0)


def gravel(rng: np.random.Generator) -> Surface:
    """Crushed stone of 2 to 6 cm in dust."""
    index, border = cells(rng, SIZE, 6500, 2.0)
    stone = rng.uniform(0.55, 1.35, 6500)[index]
    warm = rng.uniform(-1, 1, 6500)[index]
    dome = smoothstep(0.0, 4.5, border)
    dust = smoothstep(-0.3, 1.2, clouds(rng, SIZE, 2, 40, 0.8))
    grain = clouds(rng, SIZE, 100, 512, 0.0)
    gray = 0.20 * stone * (0.35 + 0.65 * dome) * np.exp(0.12 * grain)
    color = gray[..., None] * np.stack([1.05 + 0.06 * warm, np.ones(SIZE), 0.9 - 0.06 * warm], axis=-1)
    earth = tint(0.17 * np.exp(0.2 * grain), (1.12, 1.0, 0.80))
    return Surface(blend(color, earth, 0.55 * dust), np.full(SIZE, 0.9), 0.012 * dome * (1 - 0.5 * dust), 3.0)


def grass(rng: np.random.Generator) -> Surface:
    """Meadow seen from above: tufts of blades, dark gaps, dry straw."""
    blades = 0.5 * (clouds(rng, SIZE, 90, 512, 0.2) + clouds(rng, SIZE, 40, 160, 0.6))
    tufts = clouds(rng, SIZE, 12, 90, 0.9)
    patch = clouds(rng, SIZE, 6, 30, 0.6)
    value = np.exp(0.34 * blades + 0.24 * tufts)
    green = tint(value, (0.066, 0.084, 0.034))
    olive = tint(value, (0.108, 0.108, 0.052))
    straw = tint(value, (0.225, 0.190, 0.118))
    color = blend(green, olive, smoothstep(-1.0, 1.4, patch + 0.5 * tufts))
    dry = smoothstep(0.7, 2.2, clouds(rng, SIZE, 9, 60, 0.5) + 0.5 * blades)
    return Surface(blend(color, straw, 0.75 * dry), np.full(SIZE, 0.9), 0.03 * tufts + 0.02 * blades, 10.0)


def dry_soil(rng: np.random.Generator) -> Surface:
    """Pale crusted earth with pebbles, shrink cracks and tufts of dead grass."""
    grain = clouds(rng, SIZE, 70, 512, 0.3)
    lumps = clouds(rng, SIZE, 9, 90, 0.9)
    _, border = cells(rng, SIZE, 420, 9.0)
    crusted = smoothstep(-0.2, 1.0, clouds(rng, SIZE, 5, 14, 0.5))
    crack = (1 - smoothstep(0.6, 2.2, border)) * crusted
    pebbles = smoothstep(1.9, 2.6, clouds(rng, SIZE, 60, 200, 0.0))
    tuft = smoothstep(0.9, 1.9, clouds(rng, SIZE, 9, 70, 0.6))
    soil = tint(np.exp(0.14 * grain + 0.13 * lumps) * (1 - 0.5 * crack), (0.255, 0.180, 0.112))
    color = blend(soil, tint(np.exp(0.3 * grain), (0.185, 0.165, 0.085)), 0.75 * tuft)
    color = blend(color, tint(np.exp(0.2 * lumps), (0.33, 0.29, 0.24)), 0.6 * pebbles)
    height_m = 0.02 * lumps + 0.006 * grain - 0.03 * crack + 0.02 * pebbles + 0.04 * tuft
    return Surface(color, np.full(SIZE, 0.92), height_m, 10.0)


def tracks(shape: tuple[int, int], offset: float, width: float) -> Float[np.ndarray, "h w"]:
    """1 in the two wheel paths of each of the two lanes, `offset` from the lane's centre (in lane widths)."""
    lane = (np.arange(shape[1]) + 0.5) / shape[1] * 2 % 1 - 0.5
    return np.broadcast_to(np.exp(-(((np.abs(lane) - offset) / width) ** 2)), shape)


def fresh_wear(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Faint wheel paths and paving streaks; like every wear map, a factor on the albedo, 0.5 = unchanged."""
    streaks = clouds(rng, WEAR_SIZE, 1, 40, 0.7)
    along = clouds(rng, (8, WEAR_SIZE[1]), 2, 60, 0.5)[:1]
    return 0.5 * (1 + 0.05 * streaks + 0.03 * along + 0.10 * tracks(WEAR_SIZE, 0.23, 0.11))


def worn_wear(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Polished wheel paths, an oil strip, tar-sealed cracks and rectangular patches."""
    h, w = WEAR_SIZE
    x, y = np.meshgrid(np.arange(w), np.arange(h))
    factor = 1 + 0.06 * clouds(rng, WEAR_SIZE, 1, 60, 0.8)
    ragged = 1 + 0.25 * clouds(rng, WEAR_SIZE, 2, 30, 0.8)
    factor += ragged * (0.16 * tracks(WEAR_SIZE, 0.23, 0.10) - 0.16 * tracks(WEAR_SIZE, 0.0, 0.10))
    for _ in range(5):
        size = rng.integers((60, 90), (200, 420))
        dx, dy = (x - rng.integers(w)) % w, (y - rng.integers(h)) % h
        edge = np.minimum.reduce([dx, size[0] - dx, dy * 0.6, (size[1] - dy) * 0.6])
        shade = rng.choice([0.62, 0.72, 0.8, 1.18])
        factor = np.where(edge > 0, shade * (1 + 0.03 * clouds(rng, WEAR_SIZE, 20, 200, 0.3)), factor)
        factor = np.where((edge > 0) & (edge < 2.0), 0.5, factor)
    wander = 7 * clouds(rng, WEAR_SIZE, 2, 200, 1.2)
    for column in (0.49, 0.985, 0.27):
        present = smoothstep(-0.2, 0.3, clouds(rng, (h, 8), 1, 5, 0.5)[:, :1])
        away = np.abs((x - column * w + wander + w / 2) % w - w / 2)
        factor *= 1 - 0.55 * present * (1 - smoothstep(1.2, 2.8, away))
    for row in rng.uniform(0, h, 9):
        present = smoothstep(-0.5, 0.0, clouds(rng, (8, w), 1, 4, 0.5)[:1])
        away = np.abs((y - row + 1.2 * wander + h / 2) % h - h / 2)
        factor *= 1 - 0.5 * present * (1 - smoothstep(1.0, 2.4, away))
    return 0.5 * factor


def concrete_wear(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """Slabs of 6 m with dark joints, each slab its own shade, darkened wheel paths and rust-brown drips."""
    h, w = WEAR_SIZE
    x, y = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    slab = h // 8
    shade = rng.normal(1, 0.055, (8, 2))[(y // slab).astype(int), (x // (w // 2)).astype(int)]
    factor = shade + 0.05 * clouds(rng, WEAR_SIZE, 1, 50, 0.8) - 0.13 * tracks(WEAR_SIZE, 0.23, 0.12)
    factor -= 0.10 * tracks(WEAR_SIZE, 0.0, 0.09)
    to_row = np.abs((y + slab / 2) % slab - slab / 2)
    to_column = np.abs((x + w / 4) % (w / 2) - w / 4)
    factor *= 1 - 0.10 * np.exp(-to_row / 8.0) - 0.05 * np.exp(-to_column / 10.0)
    factor *= 1 - 0.60 * (1 - smoothstep(0.6, 1.6, to_row))
    factor *= 1 - 0.5 * (1 - smoothstep(0.8, 2.0, to_column))
    return 0.5 * factor


def terrain_macro(rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    """Growth and dryness over tens of metres: a tint on the terrain's albedo, 0.5 = unchanged."""
    lush = clouds(rng, SIZE, 1, 40, 1.0)
    dry = clouds(rng, SIZE, 1, 24, 1.0)
    tints = np.exp(0.22 * lush)[..., None] * np.exp(dry[..., None] * np.array([0.09, 0.05, -0.02]))
    return 0.5 * tints


def marking_cover(rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """How much of the paint is left, 1 = all: dirt, scuffs and a few rubbed spots."""
    grain = clouds(rng, SIZE, 60, 512, 0.0)
    rubbed = smoothstep(0.9, 2.4, clouds(rng, SIZE, 8, 120, 0.7))
    return 0.93 + 0.04 * grain + 0.04 * clouds(rng, SIZE, 1, 20, 0.8) - 0.42 * rubbed


SURFACES: dict[str, Callable[[np.random.Generator], Surface]] = {
    "road_1": fresh_asphalt,
    "road_2": worn_asphalt,
    "road_3": concrete,
    "shoulder": gravel,
    "terrain_1": grass,
    "terrain_2": dry_soil,
}
WEAR = {"road_1": fresh_wear, "road_2": worn_wear, "road_3": concrete_wear}


def normals(surface: Surface) -> Float[np.ndarray, "h w 3"]:
    """Unit normals of the height field by periodic central differences (rows run down, y up)."""
    step_m = surface.tile_m / surface.height_m.shape[0]
    dx = (np.roll(surface.height_m, -1, 1) - np.roll(surface.height_m, 1, 1)) / (2 * step_m)
    dy = (np.roll(surface.height_m, 1, 0) - np.roll(surface.height_m, -1, 0)) / (2 * step_m)
    n = np.stack([-dx, -dy, np.ones_like(dx)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def save(path: Path, values: Float[np.ndarray, "..."]) -> None:
    """Write values in 0..1 as an 8-bit JPEG without chroma subsampling."""
    pixels = np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)
    Image.fromarray(pixels).save(path, quality=90, subsampling=0)


def srgb(linear: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The sRGB transfer curve."""
    x = np.clip(linear, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def make_textures(folder: Path) -> None:
    """Write every map; each surface has its own random stream, so changing one leaves the others."""
    folder.mkdir(exist_ok=True)
    for number, (name, paint) in enumerate(SURFACES.items()):
        surface = paint(np.random.default_rng([1, number]))
        save(folder / f"{name}_albedo.jpg", srgb(surface.albedo))
        save(folder / f"{name}_roughness.jpg", surface.roughness)
        save(folder / f"{name}_normal.jpg", 0.5 + 0.5 * normals(surface))
    for number, (name, draw) in enumerate(WEAR.items()):
        save(folder / f"{name}_wear.jpg", draw(np.random.default_rng([2, number])))
    save(folder / "terrain_macro.jpg", terrain_macro(np.random.default_rng([5, 0])))
    save(folder / "marking_cover.jpg", marking_cover(np.random.default_rng([5, 1])))
