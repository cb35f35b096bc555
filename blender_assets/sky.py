"""Clear-sky radiance and sun transmittance for sun zeniths 0..90 deg, and tileable-in-azimuth cloud maps.

Rayleigh, Mie and ozone in a spherical atmosphere; first-order scattering is marched along the view ray, all higher
orders are an isotropic source summed as a geometric series (Hillaire 2020, "A scalable and production ready sky").
Radiance is per unit of solar irradiance outside the atmosphere. The sun's disc is not in it.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float
from noise import clouds, smoothstep
from PIL import Image
from scipy.ndimage import map_coordinates

EARTH_M, TOP_M = 6_360_000.0, 6_460_000.0
RAYLEIGH = np.array([5.802e-6, 13.558e-6, 33.1e-6])  # 1/m at 680, 550, 440 nm, sea level
MIE_SCATTER, MIE_EXTINCT = 14.0e-6, 15.5e-6  # a slightly hazy day
OZONE = np.array([0.650e-6, 1.881e-6, 0.085e-6])
MIE_G = 0.78
GROUND_ALBEDO = 0.2

Array = Float[np.ndarray, "..."]


def densities(height_m: Array) -> tuple[Array, Array, Array]:
    """Relative density of air, aerosol and ozone at a height."""
    return np.exp(-height_m / 8000), np.exp(-height_m / 1200), np.maximum(0, 1 - np.abs(height_m - 25000) / 15000)


def extinction(height_m: Array) -> Array:
    """Extinction per metre, RGB in the last axis."""
    air, aerosol, ozone = densities(height_m)
    return air[..., None] * RAYLEIGH + aerosol[..., None] * MIE_EXTINCT + ozone[..., None] * OZONE


def to_sphere(height_m: Array, cosine: Array, radius_m: float) -> Array:
    """Distance along a ray of that zenith cosine to the outer sphere."""
    r = EARTH_M + height_m
    return -r * cosine + np.sqrt(np.maximum(0, (r * cosine) ** 2 + radius_m**2 - r**2))


def transmittance(height_m: Array, cosine: Array, steps: int = 40) -> Array:
    """Transmittance from a height to space; 0 where the earth is in the way."""
    length = to_sphere(height_m, cosine, TOP_M)
    t = (np.arange(steps) + 0.5) / steps
    r = EARTH_M + height_m
    s = length[..., None] * t
    h = np.sqrt(r[..., None] ** 2 + s**2 + 2 * r[..., None] * s * cosine[..., None]) - EARTH_M
    depth = (extinction(np.maximum(h, 0)) * (length / steps)[..., None, None]).sum(axis=-2)
    blocked = (cosine < 0) & ((r * cosine) ** 2 + EARTH_M**2 - r**2 > 0)
    return np.where(blocked[..., None], 0.0, np.exp(-depth))


def march(
    height_m: float, directions: Array, sun: Array, multiple: Array | None, heights_m: Array | None, steps: int = 40
) -> tuple[Array, Array]:
    """Radiance and transfer factor (radiance scattered for a uniform unit source) along rays from one height."""
    cosine = directions[..., 2]
    r = EARTH_M + height_m
    hit = (r * cosine) ** 2 + EARTH_M**2 - r**2
    to_ground = np.where((cosine < 0) & (hit > 0), -r * cosine - np.sqrt(np.maximum(hit, 0)), np.inf)
    length = np.minimum(to_sphere(np.full_like(cosine, height_m), cosine, TOP_M), to_ground)
    view_sun = directions @ sun
    phase_air = 3 / (16 * np.pi) * (1 + view_sun**2)
    g = MIE_G
    phase_mie = 3 / (8 * np.pi) * (1 - g**2) * (1 + view_sun**2) / ((2 + g**2) * (1 + g**2 - 2 * g * view_sun) ** 1.5)
    radiance, transfer = np.zeros(directions.shape), np.zeros(directions.shape)
    through = np.ones(directions.shape)
    edges = np.linspace(0, 1, steps + 1) ** 2  # finer near the eye, where the air is dense
    for near, far in pairwise(edges):
        s = length * (near + far) / 2
        at = np.array([0, 0, r]) + s[..., None] * directions
        radius = np.linalg.norm(at, axis=-1)
        h = np.maximum(radius - EARTH_M, 0)
        air, aerosol, _ = densities(h)
        scatter = air[..., None] * RAYLEIGH + aerosol[..., None] * MIE_SCATTER
        sunlight = transmittance(h, (at @ sun) / radius, 16)
        source = sunlight * (
            air[..., None] * RAYLEIGH * phase_air[..., None] + aerosol[..., None] * MIE_SCATTER * phase_mie[..., None]
        )
        if multiple is not None and heights_m is not None:
            source = source + scatter * np.stack([np.interp(h, heights_m, multiple[:, c]) for c in range(3)], axis=-1)
        ext = extinction(h)
        step_through = np.exp(-ext * (length * (far - near))[..., None])
        weight = through * (1 - step_through) / np.maximum(ext, 1e-12)
        radiance += weight * source
        transfer += weight * scatter / (4 * np.pi)
        through = through * step_through
    ground = np.isfinite(to_ground)[..., None] * through * GROUND_ALBEDO / np.pi
    lit = transmittance(np.zeros(1), np.array([max(sun[2], 0.0)]))[0] * max(sun[2], 0.0)
    return radiance + ground * lit, transfer


def multiple_scattering(sun: Array) -> tuple[Array, Array]:
    """Isotropic source of all orders above the first, by height, for one sun."""
    heights_m = np.array([0, 500, 1500, 3000, 6000, 10000, 20000, 40000, 80000.0])
    k = np.arange(64) + 0.5
    cos_z, azimuth = 1 - 2 * k / 64, np.pi * (1 + 5**0.5) * k
    sin_z = np.sqrt(1 - cos_z**2)
    sphere = np.stack([sin_z * np.cos(azimuth), sin_z * np.sin(azimuth), cos_z], axis=-1)
    source = np.zeros((len(heights_m), 3))
    for i, h in enumerate(heights_m):
        first, transfer = march(h, sphere, sun, None, None, 24)
        factor = transfer.mean(axis=0) * 4 * np.pi
        source[i] = first.mean(axis=0) / (1 - np.minimum(factor, 0.95))
    return source, heights_m


def sun_vector(zenith_rad: float) -> Array:
    """Unit vector to the sun at azimuth 0."""
    return np.array([np.sin(zenith_rad), 0.0, np.cos(zenith_rad)])


def make_sky(path: Path) -> None:
    """Write the table: radiance[sun, elevation, azimuth from the sun, rgb] and the sun's own transmittance."""
    sun_zenith_rad = np.deg2rad([0, 10, 20, 30, 40, 50, 60, 68, 75, 80, 84, 87, 90.0])
    elevation_rad = np.pi / 2 * np.linspace(0, 1, 32) ** 2  # finer near the horizon
    azimuth_rad = np.linspace(0, np.pi, 25)
    e, a = np.meshgrid(elevation_rad, azimuth_rad, indexing="ij")
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    radiance, direct = [], []
    for zenith in sun_zenith_rad:
        sun = sun_vector(zenith)
        source, heights_m = multiple_scattering(sun)
        radiance.append(march(2.0, directions, sun, source, heights_m)[0])
        direct.append(transmittance(np.array([2.0]), np.array([np.cos(zenith)]))[0])
    np.savez_compressed(
        path,
        sun_zenith_rad=sun_zenith_rad.astype(np.float32),
        elevation_rad=elevation_rad.astype(np.float32),
        azimuth_rad=azimuth_rad.astype(np.float32),
        radiance=np.asarray(radiance, np.float32),
        sun_transmittance=np.asarray(direct, np.float32),
    )


def make_clouds(folder: Path) -> None:
    """Write four cloud-cover maps of the upper hemisphere, rows from zenith to horizon, periodic in azimuth.

    Clouds lie on a plane overhead; four by four samples a pixel keep them smooth where the plane is seen edge-on.
    """
    folder.mkdir(exist_ok=True)
    plane, fine = (2048, 2048), 4
    kinds = [(0.5, 1.6, 1.7), (0.1, 1.4, 1.7), (-0.4, 1.2, 1.6), (0.0, 2.4, 1.35)]  # cover, softness, slope
    rows, columns = 256 * fine, 1024 * fine
    elevation = np.pi / 2 * (1 - (np.arange(rows) + 0.5) / rows)[:, None]
    azimuth = 2 * np.pi * (np.arange(columns) + 0.5) / columns
    reach = 190 / np.tan(np.maximum(elevation, 0.02) + 0.07)
    where = np.stack([reach * np.sin(azimuth), reach * np.cos(azimuth)])
    fade = smoothstep(0.0, 0.10, elevation)
    for number, (cover, soft, slope) in enumerate(kinds):
        noise = clouds(np.random.default_rng([3, number]), plane, 6, 900, slope)
        density = map_coordinates(smoothstep(cover, cover + soft, noise), where, order=1, mode="grid-wrap") * fade
        hemisphere = density.reshape(256, fine, 1024, fine).mean(axis=(1, 3))
        Image.fromarray(np.round(255 * hemisphere).astype(np.uint8)).save(folder / f"clouds_{number + 1}.png")
