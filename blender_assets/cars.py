"""The cars of the catalogue: body styles, wheels, lamps, plates and trim."""

from dataclasses import replace
from functools import partial

import numpy as np
from car_body import GLASS, HEAD, LIVERY, PAINT, PLATE, RIM, TAIL, TRIM, TYRE, cabin, flank, lower_body
from car_styles import STYLES
from shapes import Shape, lathe_x, rounded_box, tube

from synth3dlanes.scene.assets.catalogue import CARS, CarModel


def box(
    shape: Shape, material: int, x: float, y: float, z: float, size: tuple[float, float, float], r: float, n: int = 2
) -> None:
    """A rounded box at (x, y, z) and, off the middle, its mirror image."""
    for side in (1, -1) if x else (1,):
        vertices, faces = rounded_box((side * x, y, z), size, r, n)
        shape.add(vertices, faces, material)


# A box with edges that are only bevelled.
slab = partial(box, n=1)


def wheel(shape: Shape, model: CarModel, x: float, y: float, width: float) -> None:
    """Tyre, dished rim and spokes; `x` is the middle of the tread, outward its sign."""
    radius, out, half = model.wheel_radius_m, np.sign(x), width / 2
    rim = 0.66 * radius
    tread = np.array(
        [
            (-half, rim),
            (-half, 0.90 * radius),
            (-0.8 * half, 0.985 * radius),
            (-0.6 * half, radius),
            (0.6 * half, radius),
            (0.8 * half, 0.985 * radius),
            (half, 0.90 * radius),
            (half, rim),
        ]
    )
    vertices, faces = lathe_x(tread * [out, 1], 24, (x, y, radius))
    shape.add(vertices, faces if out > 0 else faces[:, ::-1], TYRE)
    back = np.array([[0, k + 2, k + 1, -1] if out > 0 else [0, k + 1, k + 2, -1] for k in range(22)])
    shape.add(vertices[:24], back, TYRE)
    dish = np.array([(half, rim), (half - 0.012, 0.94 * rim), (half - 0.05, 0.9 * rim), (half - 0.055, 0.0)])
    vertices, faces = lathe_x(dish * [out, 1], 24, (x, y, radius))
    shape.add(vertices, faces if out > 0 else faces[:, ::-1], np.repeat([RIM, RIM, TRIM], 24))
    hub, hub_faces = rounded_box((x + out * (half - 0.03), y, radius), (0.04, 0.36 * rim, 0.36 * rim), 0.03)
    shape.add(hub, hub_faces, RIM)
    spoke, spoke_faces = rounded_box((0, 0, 0.52 * rim), (0.025, 0.20 * rim, 0.92 * rim), 0.012, 1)
    for k in range(5):
        c, s = np.cos(0.4 * np.pi * k), np.sin(0.4 * np.pi * k)
        turned = spoke @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) + [x + out * (half - 0.025), y, radius]
        shape.add(turned, spoke_faces, RIM)


def wheels(shape: Shape, model: CarModel) -> None:
    """Four wheels (the truck's rear ones doubled), arch lips and the floor between them."""
    half_base = model.wheelbase_m / 2
    width = 0.62 * model.wheel_radius_m + (0.02 if model.name not in HEAVY else -0.02)
    for side in (1, -1):
        axle_end(shape, model, side, half_base, width)
        axle_end(shape, model, side, -half_base, width, is_twin=model.name in HEAVY)
    box(
        shape,
        TRIM,
        0,
        0,
        model.wheel_radius_m + 0.12,
        (model.track_m - width - 0.14, model.wheelbase_m + 0.9, 0.36),
        0.05,
    )


def axle_end(shape: Shape, model: CarModel, side: int, y: float, width: float, is_twin: bool = False) -> None:
    """The wheel, or pair of wheels, at one end of an axle."""
    half_track = model.track_m / 2
    wheel(shape, model, side * (half_track - (0.06 if is_twin else 0)), y, width + (0.26 if is_twin else 0))


def arch_lips(shape: Shape, model: CarModel, material: int, thickness_m: float) -> None:
    """A bead around each wheel opening."""
    angle = np.linspace(-0.25, np.pi + 0.25, 17)
    radius = model.wheel_radius_m + 0.07
    for side in (1, -1):
        for axle in (model.wheelbase_m / 2, -model.wheelbase_m / 2):
            path = np.stack(
                [
                    np.full_like(angle, side * (model.width_m / 2 * 0.985 - thickness_m / 2)),
                    axle + radius * np.cos(angle),
                    model.wheel_radius_m + radius * np.sin(angle),
                ],
                axis=1,
            )
            vertices, faces = tube(path, np.full(len(path), thickness_m), 4)
            shape.add(vertices, faces, material)


def rear(shape: Shape, model: CarModel, z: dict[str, float], lamp: tuple[float, float], wrap_m: float) -> None:
    """Tail lamps, plate, bumper and its dark lower half; `lamp` is its width and height. The reversing lamp in it is
    bright metal behind glass, since `HEAD` shines at night."""
    tail, half = -model.length_m / 2, model.width_m / 2
    lamp_x = half * 0.80 - lamp[0] / 2 + 0.05
    box(shape, TAIL, lamp_x, tail + 0.008 + wrap_m / 2, z["lamp"], (lamp[0], wrap_m, lamp[1]), 0.05, 3)
    box(
        shape,
        RIM,
        lamp_x - 0.18 * lamp[0],
        tail + 0.029,
        z["lamp"] - 0.22 * lamp[1],
        (0.42 * lamp[0], 0.05, 0.24 * lamp[1]),
        0.015,
    )
    box(shape, PAINT, 0, tail + 0.14, z["bumper"], (2 * half * 0.94, 0.28, 0.26), 0.055, 3)
    box(shape, TRIM, 0, tail + 0.15, z["bumper"] - 0.14, (2 * half * 0.87, 0.28, 0.16), 0.05)
    box(shape, PLATE, 0, tail + 0.024, z["plate"], (0.50, 0.03, 0.11), 0.008)
    box(shape, TAIL, half * 0.70, tail + 0.02, z["bumper"] - 0.12, (0.16, 0.03, 0.035), 0.01)


def front(shape: Shape, model: CarModel, z_lamp: float, z_bumper: float) -> None:
    """Head lamps in dark frames, which set them off from white paint, grille, bumper and plate."""
    nose, half = model.length_m / 2, model.width_m / 2
    slab(shape, TRIM, half * 0.64, nose - 0.105, z_lamp, (0.38, 0.18, 0.15), 0.04)
    slab(shape, HEAD, half * 0.64, nose - 0.10, z_lamp, (0.28, 0.18, 0.085), 0.03)
    slab(shape, TRIM, 0, nose - 0.08, z_lamp - 0.04, (0.72, 0.14, 0.14), 0.04)
    box(shape, PAINT, 0, nose - 0.165, z_bumper, (2 * half * 0.86, 0.32, 0.20), 0.09)
    box(shape, TRIM, 0, nose - 0.145, z_bumper - 0.12, (2 * half * 0.74, 0.28, 0.12), 0.05)
    box(shape, PLATE, 0, nose - 0.016, z_bumper, (0.50, 0.03, 0.11), 0.008)


def mirrors(shape: Shape, model: CarModel, y: float, z: float, size: tuple[float, float, float]) -> None:
    """Door mirrors, kept within the body's width."""
    box(shape, PAINT, model.width_m / 2 - size[0] / 2, y, z, size, 0.05)
    box(
        shape, GLASS, model.width_m / 2 - size[0] / 2, y - size[1] / 2, z, (size[0] * 0.8, 0.012, size[2] * 0.75), 0.005
    )


def doors(shape: Shape, model: CarModel, seams_m: tuple[float, ...], handles_m: tuple[float, ...]) -> None:
    """Door gaps as dark lines on the flank, and handles, at the given y."""
    style = STYLES[model.name]
    share = np.linspace(0.08, 1.0, 7)
    for y in seams_m:
        x, z = flank(model, style, y, share)
        for side in (1, -1):
            path = np.stack([side * (x - 0.003), np.full_like(x, y), z], axis=1)
            vertices, faces = tube(path, np.full(len(path), 0.007), 4)
            shape.add(vertices, faces, TRIM)
    for y in handles_m:
        x, z = flank(model, style, y, np.array([0.84]))
        box(shape, TRIM, float(x[0]) - 0.004, y, float(z[0]), (0.022, 0.16, 0.026), 0.008, 1)


def body(model: CarModel, seams_m: tuple[float, ...] = (), handles_m: tuple[float, ...] = ()) -> Shape:
    """Loft, cabin, doors, wheels and floor: what every model has."""
    shape = Shape()
    lower_body(shape, model, STYLES[model.name])
    cabin(shape, model, STYLES[model.name])
    doors(shape, model, seams_m, handles_m)
    wheels(shape, model)
    return shape


def hatchback(model: CarModel) -> Shape:
    """A small five-door with upright lamps beside the rear window."""
    shape = body(model, (0.75, -0.15, -0.8), (-0.02, -0.8))
    rear(shape, model, {"lamp": 0.86, "bumper": 0.47, "plate": 0.74}, (0.26, 0.24), 0.22)
    front(shape, model, 0.66, 0.44)
    mirrors(shape, model, 0.68, 1.02, (0.17, 0.10, 0.13))
    arch_lips(shape, model, PAINT, 0.012)
    box(shape, TAIL, 0, -1.73, 1.375, (0.30, 0.03, 0.025), 0.008)
    return shape


def sedan(model: CarModel) -> Shape:
    """A three-box saloon with wide lamps under the boot lid."""
    shape = body(model, (0.95, -0.08, -0.95), (0.05, -0.85))
    rear(shape, model, {"lamp": 0.86, "bumper": 0.50, "plate": 0.74}, (0.42, 0.16), 0.20)
    front(shape, model, 0.64, 0.43)
    mirrors(shape, model, 0.80, 1.00, (0.18, 0.10, 0.13))
    arch_lips(shape, model, PAINT, 0.012)
    box(shape, RIM, 0, -model.length_m / 2 + 0.018, 0.90, (0.62, 0.02, 0.03), 0.008)
    box(shape, TRIM, 0, -model.length_m / 2 + 0.030, 0.66, (1.5, 0.03, 0.012), 0.004)
    return shape


def suv(model: CarModel) -> Shape:
    """A tall estate with roof rails and dark cladding."""
    shape = body(model, (0.85, -0.06, -0.9), (0.06, -0.8))
    rear(shape, model, {"lamp": 1.02, "bumper": 0.58, "plate": 0.86}, (0.30, 0.22), 0.22)
    front(shape, model, 0.80, 0.53)
    mirrors(shape, model, 0.76, 1.18, (0.19, 0.11, 0.16))
    arch_lips(shape, model, TRIM, 0.028)
    box(shape, TRIM, 0.64, -0.65, 1.685, (0.04, 1.9, 0.03), 0.012)
    box(shape, PAINT, 0, -2.05, 1.64, (1.22, 0.22, 0.035), 0.015)
    box(shape, TAIL, 0, -2.165, 1.635, (0.34, 0.015, 0.02), 0.005)
    return shape


def pickup(model: CarModel) -> Shape:
    """A crew cab with an open bed with a housing over the wheels, tailgate and upright lamps."""
    shape = body(model, (1.05, 0.21, -0.58, -0.9), (0.33, -0.42))
    tail = -model.length_m / 2
    box(shape, TRIM, 0, -model.wheelbase_m / 2, 0.74, (1.66, 1.0, 0.24), 0.03)
    box(shape, TAIL, 0.85, tail + 0.135, 0.92, (0.14, 0.16, 0.34), 0.03)
    box(shape, RIM, 0, tail + 0.08, 0.56, (1.78, 0.16, 0.17), 0.05)
    box(shape, PLATE, 0, tail + 0.005, 0.58, (0.48, 0.02, 0.11), 0.006)
    box(shape, TRIM, 0, tail + 0.105, 1.03, (0.30, 0.02, 0.06), 0.01)
    box(shape, TRIM, 0, tail + 0.104, 0.70, (1.50, 0.02, 0.014), 0.004)
    front(shape, model, 0.90, 0.60)
    mirrors(shape, model, 0.95, 1.26, (0.20, 0.11, 0.19))
    arch_lips(shape, model, TRIM, 0.035)
    return shape


def van(model: CarModel) -> Shape:
    """A high-roofed panel van: two windowed rear doors, a sliding-door rail."""
    shape = body(model, (1.75, 0.75, -0.55), (0.9, 0.6))
    tail = -model.length_m / 2
    rear(shape, model, {"lamp": 1.08, "bumper": 0.46, "plate": 0.78}, (0.15, 0.52), 0.18)
    box(shape, GLASS, 0.40, tail + 0.045, 1.62, (0.60, 0.07, 0.52), 0.05)
    box(shape, TRIM, 0, tail + 0.052, 1.32, (0.014, 0.08, 1.45), 0.003)
    box(shape, TRIM, 0.08, tail + 0.02, 1.06, (0.05, 0.03, 0.14), 0.01)
    box(shape, TRIM, 0.988, -1.0, 1.16, (0.02, 2.2, 0.025), 0.006)
    front(shape, model, 0.88, 0.50)
    mirrors(shape, model, 1.72, 1.36, (0.20, 0.12, 0.27))
    arch_lips(shape, model, TRIM, 0.02)
    return shape


def truck(model: CarModel) -> Shape:
    """A two-axle box truck: cab, cargo box with rear doors, chassis, side and rear guards."""
    shape = body(model, (3.5, 2.6), (2.72,))
    tail, half = -model.length_m / 2, model.width_m / 2
    box(shape, PAINT, 0, -1.00, 2.175, (model.width_m, 6.16, 2.25), 0.03)
    box(shape, RIM, half - 0.05, tail + 0.05, 2.175, (0.11, 0.10, 2.26), 0.01)
    box(shape, RIM, 0, tail + 0.05, 3.245, (model.width_m, 0.10, 0.11), 0.01)
    box(shape, RIM, 0, tail + 0.05, 1.09, (model.width_m, 0.10, 0.10), 0.01)
    for x in (0.28, 0.82):
        box(shape, RIM, x, tail + 0.012, 2.175, (0.035, 0.024, 2.1), 0.008)
    box(shape, TRIM, 0, tail + 0.016, 2.175, (0.022, 0.012, 2.14), 0.002)
    box(shape, TRIM, 0, -0.9, 0.92, (0.95, 6.0, 0.26), 0.02)
    box(shape, TRIM, 0, tail + 0.16, 0.60, (2.2, 0.10, 0.13), 0.02)
    box(shape, TAIL, 0.93, tail + 0.10, 0.86, (0.36, 0.08, 0.15), 0.02)
    box(shape, PLATE, 0, tail + 0.095, 0.62, (0.50, 0.03, 0.11), 0.006)
    box(shape, TRIM, 0.98, -3.05, 0.60, (0.50, 0.03, 0.60), 0.01)
    box(shape, TRIM, 1.12, 0.15, 0.72, (0.04, 2.7, 0.34), 0.015)
    box(shape, TRIM, 0.85, 1.35, 0.70, (0.45, 0.9, 0.45), 0.06)
    box(shape, PAINT, 0, 2.75, 2.92, (1.9, 0.9, 0.55), 0.25)
    front(shape, model, 0.82, 0.62)
    mirrors(shape, model, 3.72, 1.95, (0.16, 0.14, 0.42))
    return shape


def compact(model: CarModel) -> Shape:
    """A small saloon with a short boot and high lamps."""
    shape = body(model, (0.9, -0.08, -0.9), (0.05, -0.8))
    rear(shape, model, {"lamp": 0.90, "bumper": 0.49, "plate": 0.66}, (0.34, 0.18), 0.20)
    front(shape, model, 0.66, 0.43)
    mirrors(shape, model, 0.80, 1.02, (0.17, 0.10, 0.13))
    arch_lips(shape, model, PAINT, 0.012)
    box(shape, TRIM, 0, -model.length_m / 2 + 0.030, 0.60, (1.4, 0.03, 0.012), 0.004)
    return shape


def estate(model: CarModel) -> Shape:
    """A saloon's front, a long roof with rails, and lamps that wrap around the corners."""
    shape = body(model, (0.98, -0.03, -0.98), (0.08, -0.86))
    rear(shape, model, {"lamp": 0.92, "bumper": 0.50, "plate": 0.76}, (0.40, 0.17), 0.24)
    front(shape, model, 0.64, 0.43)
    mirrors(shape, model, 0.84, 1.01, (0.18, 0.10, 0.13))
    arch_lips(shape, model, PAINT, 0.012)
    box(shape, RIM, 0.60, -0.75, 1.485, (0.035, 2.1, 0.03), 0.012)
    box(shape, PAINT, 0, -1.97, 1.405, (1.16, 0.20, 0.03), 0.012)
    box(shape, TAIL, 0, -2.075, 1.40, (0.34, 0.015, 0.02), 0.005)
    return shape


def crossover(model: CarModel) -> Shape:
    """A raised hatchback with a sloping rear window, dark cladding and a lamp bar across the tail."""
    shape = body(model, (0.82, -0.08, -0.9), (0.04, -0.78))
    rear(shape, model, {"lamp": 0.98, "bumper": 0.56, "plate": 0.80}, (0.34, 0.15), 0.22)
    front(shape, model, 0.76, 0.51)
    mirrors(shape, model, 0.74, 1.13, (0.18, 0.10, 0.14))
    arch_lips(shape, model, TRIM, 0.026)
    box(shape, TAIL, 0, -model.length_m / 2 + 0.02, 0.99, (1.1, 0.05, 0.03), 0.01)
    return shape


def semitrailer(model: CarModel) -> Shape:
    """A cab-over tractor and a box trailer of three axles. The model's axles are the middles of the tractor's two and
    of the trailer's three; the box has the livery's colour, the cab the body's."""
    shape, tail, half = Shape(), -model.length_m / 2, model.width_m / 2
    tractor = replace(model, wheelbase_m=2 * STEERED_M)
    lower_body(shape, tractor, STYLES[model.name])
    cabin(shape, tractor, STYLES[model.name])
    doors(shape, tractor, (7.85, 6.95), (7.05,))
    front(shape, model, 0.80, 0.58)
    mirrors(shape, model, 7.95, 2.25, (0.16, 0.14, 0.55))
    slab(shape, TRIM, 0, 8.18, 1.20, (1.7, 0.09, 0.44), 0.03)
    box(shape, PAINT, 0, 6.85, 3.30, (2.1, 1.7, 1.10), 0.35, 3)
    middle = model.wheelbase_m / 2
    for side in (1, -1):
        axle_end(shape, model, side, STEERED_M, 0.30)
        axle_end(shape, model, side, 2 * middle - STEERED_M, 0.30, is_twin=True)
        for offset in (1.31, 0.0, -1.31):
            axle_end(shape, model, side, offset - middle, 0.38)
    box(shape, TRIM, 0, 4.9, 0.82, (0.90, 5.6, 0.34), 0.03)
    slab(shape, RIM, 0.92, 4.85, 0.72, (0.50, 1.5, 0.56), 0.10)
    slab(shape, TRIM, 0.98, 3.25, 1.06, (0.52, 1.3, 0.05), 0.02)
    length, front_y = 13.6, tail + 13.6
    box(shape, LIVERY, 0, front_y - length / 2, 2.575, (model.width_m, length, 2.85), 0.03)
    slab(shape, RIM, half - 0.05, tail + 0.05, 2.575, (0.11, 0.11, 2.84), 0.01)
    for z in (3.945, 1.20):
        slab(shape, RIM, 0, tail + 0.05, z, (model.width_m, 0.11, 0.10), 0.01)
    for x in (0.28, 0.85):
        slab(shape, RIM, x, tail + 0.005, 2.575, (0.035, 0.03, 2.7), 0.008)
    slab(shape, TRIM, 0, tail + 0.008, 2.575, (0.022, 0.02, 2.72), 0.002)
    slab(shape, RIM, half - 0.01, front_y - length / 2, 1.20, (0.03, length - 0.1, 0.10), 0.01)
    slab(shape, TRIM, 0.48, -1.7, 1.02, (0.14, 12.6, 0.26), 0.02)
    slab(shape, TRIM, 0.98, -5.05, 1.09, (0.50, 3.9, 0.05), 0.02)
    slab(shape, TRIM, 1.16, -0.55, 0.78, (0.04, 5.6, 0.42), 0.015)
    slab(shape, TRIM, 0.85, 2.05, 0.60, (0.12, 0.16, 0.80), 0.02)
    slab(shape, TRIM, 0, tail + 0.16, 0.55, (2.3, 0.10, 0.14), 0.02)
    slab(shape, TAIL, 0.95, tail + 0.10, 0.92, (0.42, 0.08, 0.15), 0.02)
    slab(shape, PLATE, 0, tail + 0.095, 0.58, (0.50, 0.03, 0.11), 0.006)
    return shape


def bus(model: CarModel) -> Shape:
    """A low-floor city bus: windows all around, three doors on the right, a destination sign, a band of livery."""
    shape, nose, half = Shape(), model.length_m / 2, model.width_m / 2
    lower_body(shape, model, STYLES[model.name])
    wheels(shape, model)
    box(shape, GLASS, 0, 0.0, 1.86, (2 * half - 0.11, 2 * nose - 0.08, 1.60), 0.12, 3)
    box(shape, PAINT, 0, 0.0, 2.78, (2 * half - 0.08, 2 * nose - 0.03, 0.44), 0.16, 3)
    slab(shape, PAINT, 0, -1.2, 3.02, (1.7, 6.0, 0.16), 0.05)
    for y in (-4.55, -3.1, -1.65, -0.2, 1.25, 2.7, 4.15):
        slab(shape, TRIM, half - 0.05, y, 1.9, (0.02, 0.07, 1.36), 0.006)
    box(shape, PAINT, half - 0.06, -5.5, 1.9, (0.07, 0.95, 1.42), 0.03)
    slab(shape, LIVERY, half - 0.022, 0, 1.16, (0.05, 2 * nose - 0.9, 0.20), 0.015)
    for y in (4.95, 0.1, -4.0):
        for part, material, size in (
            (0.0, TRIM, (0.06, 1.36, 2.12)),
            (0.33, GLASS, (0.075, 0.58, 1.96)),
            (-0.33, GLASS, (0.075, 0.58, 1.96)),
        ):
            shape.add(*rounded_box((half - 0.024, y + part, 1.46), size, 0.01, 1), material)
    slab(shape, TRIM, 0, nose - 0.025, 2.72, (1.9, 0.04, 0.30), 0.01)
    slab(shape, TRIM, 0, nose - 0.045, 1.9, (0.05, 0.02, 1.36), 0.006)
    front(shape, model, 0.78, 0.52)
    mirrors(shape, model, nose - 0.12, 2.15, (0.14, 0.12, 0.36))
    box(shape, PAINT, 0, 0.05 - nose, 1.42, (2 * half - 0.10, 0.08, 0.86), 0.03)
    slab(shape, TRIM, 0, 0.012 - nose, 0.98, (1.5, 0.03, 0.42), 0.01)
    for z, height in ((1.30, 0.34), (0.92, 0.24)):
        box(shape, TAIL, half - 0.24, 0.02 - nose, z, (0.16, 0.05, height), 0.03)
    slab(shape, TRIM, 0, 0.09 - nose, 0.45, (2 * half - 0.30, 0.14, 0.20), 0.04)
    slab(shape, PLATE, 0, 0.012 - nose, 0.68, (0.50, 0.03, 0.11), 0.008)
    slab(shape, TRIM, 0, 0.012 - nose, 2.76, (0.7, 0.03, 0.24), 0.01)
    return shape


# Models with doubled rear wheels, and the station of the tractor's steered axle.
HEAVY, STEERED_M = ("truck", "bus"), 6.85
BUILD = {
    "hatchback": hatchback,
    "sedan": sedan,
    "suv": suv,
    "pickup": pickup,
    "van": van,
    "truck": truck,
    "compact": compact,
    "estate": estate,
    "crossover": crossover,
    "semitrailer": semitrailer,
    "bus": bus,
}


def build_all() -> list[tuple[CarModel, Shape]]:
    """All cars of the catalogue, in its order."""
    return [(model, BUILD[model.name](model)) for model in CARS]
