"""The paint of a scene that bounds no lane: crosswalks, stop lines, arrows, a gore."""

import math

from synth3dlanes.geometry.lanes import connections
from synth3dlanes.geometry.symbols import LENGTHS_M, gore_range
from synth3dlanes.sampling.draws import DECIMALS, Draw
from synth3dlanes.scene import Symbol
from synth3dlanes.schema import SymbolKind
from synth3dlanes.world import World

# Draws of a place for each symbol.
TRIES = 300
# The shoulder texture that is pavement.
PAVED = 2
# Least distance along the road between symbols, and between them and the split.
SYMBOL_GAP_M, SPLIT_GAP_M = 1.0, 8.0


def draw_symbols(world: World, draw: Draw) -> tuple[Symbol, ...]:
    """Symbols that do not overlap along the road; those without room are left out, and a gore on a gravel shoulder."""
    road, plan = world.scene.road, world.plan
    asked: dict[SymbolKind, int] = {"crosswalk": draw("crosswalks"), "stop_line": draw("stop_lines")}
    n_arrow_rows, gore = draw("arrow_rows"), draw("gore")
    turns = draw.rng.random(2).tolist()
    taken: list[tuple[float, float]] = []

    def place(length_m: float, beyond_m: float) -> float | None:
        """A free station before the split or, in the plan, beyond a station behind it."""
        for _ in range(TRIES):
            s_m = draw("s_m")
            s_plan, reach_m = s_m * plan.flips[1], length_m / 2 + SYMBOL_GAP_M
            is_clear = s_plan + reach_m < -SPLIT_GAP_M or s_plan - reach_m > beyond_m or not plan.has_exit
            if is_clear and all(abs(s_m - other_m) > (length_m + other) / 2 + SYMBOL_GAP_M for other_m, other in taken):
                taken.append((s_m, length_m))
                return s_m
        return None

    symbols = []
    for kind, n in asked.items():
        for _ in range(n):
            if (s_m := place(LENGTHS_M[kind], math.inf)) is not None:
                symbols.append(Symbol(kind=kind, lane=None, s_m=s_m))
    for _ in range(n_arrow_rows):
        if (s_m := place(LENGTHS_M["arrow_straight"], plan.nose_m + SPLIT_GAP_M)) is not None:
            lanes = road.segments_at(s_m)
            symbols += [Symbol(kind=_arrow(world, lane, turns), lane=lane, s_m=s_m) for lane in lanes]
    room = gore_range(plan)
    if gore and room is not None and world.scene.surface.shoulder_texture == PAVED:
        symbols.append(Symbol(kind="gore", lane=None, s_m=round(room[0] * plan.flips[1], DECIMALS)))
    return tuple(symbols)


def _arrow(world: World, lane: str, turns: list[float]) -> SymbolKind:
    """The arrow of a lane: where its successors lead, or as before a junction on a road without exit, where `turns` in
    [0, 1) decide what the outer lanes may do."""
    plan, merges = world.plan, world.scene.road.flip_lateral
    to_exit: tuple[SymbolKind, SymbolKind] = ("arrow_right", "arrow_straight_right")
    to_main: SymbolKind = "arrow_left"
    if world.scene.road.flip_longitudinal:
        to_exit, to_main = ("arrow_left", "arrow_straight_left"), "arrow_right"
    if not plan.has_exit:
        lefts: tuple[SymbolKind, ...] = ("arrow_straight", "arrow_straight_left", "arrow_left")
        rights: tuple[SymbolKind, ...] = ("arrow_straight", "arrow_straight_right", "arrow_right")
        if lane == "main_1":
            return lefts[int(3 * turns[0])]
        return rights[int(3 * turns[1])] if lane == f"main_{plan.n_lanes}" else "arrow_straight"
    if merges:
        return to_main if lane.startswith("exit") else "arrow_straight"
    follow = [fork.startswith("exit") for stem, fork in connections(plan) if stem == lane]
    return to_exit[0] if follow and all(follow) else to_exit[1] if any(follow) else "arrow_straight"
