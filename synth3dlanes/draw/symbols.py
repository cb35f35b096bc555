"""The paint of a scene that bounds no lane: crosswalks, stop lines, arrows, a gore."""

from synth3dlanes.draw.draws import SCENE_DECIMALS, Draw
from synth3dlanes.roads.network import Network
from synth3dlanes.roads.roads import NetworkLane
from synth3dlanes.scene.scene import Scene, Symbol
from synth3dlanes.system.schema import SymbolKind
from synth3dlanes.world.symbols import LENGTHS_M, gore_of

# Draws of a place for each symbol.
TRIES = 300
# Arrows that allow a turn as well, and arrows that demand it.
STRAIGHT: SymbolKind = "arrow_straight"
TO_LEFT: tuple[SymbolKind, SymbolKind] = ("arrow_straight_left", "arrow_left")
TO_RIGHT: tuple[SymbolKind, SymbolKind] = ("arrow_straight_right", "arrow_right")
# The shoulder texture that is pavement.
PAVED = 2
# Least distance along the road between symbols, and between them and places where roads part.
SYMBOL_GAP_M, PARTING_GAP_M = 1.0, 8.0


def draw_symbols(scene: Scene, network: Network, draw: Draw) -> tuple[Symbol, ...]:
    """Symbols that do not overlap along the road; those without room are left out, and a gore on a gravel shoulder."""
    partings = [(at.start_m, at.parting.station(0.0)) for at in network.branches(network.main) if at.parting]
    asked: dict[SymbolKind, int] = {"crosswalk": draw("crosswalks"), "stop_line": draw("stop_lines")}
    n_arrow_rows, gore = draw("arrow_rows"), draw("gore")
    turns = draw.rng.random(2).tolist()
    works = scene.roads.works
    taken = [] if works is None else [((works.start_m + works.end_m) / 2, works.end_m - works.start_m)]

    def place(length_m: float, before_only: bool = False) -> float | None:
        """A free station on the host's road, before others leave it or also where their lanes have parted from it."""
        for _ in range(TRIES):
            s_m = draw("s_m")
            s, reach_m = s_m * network.onwards, length_m / 2 + SYMBOL_GAP_M
            is_clear = all(
                s + reach_m < start_m - PARTING_GAP_M or (not before_only and s - reach_m > end_m + PARTING_GAP_M)
                for start_m, end_m in partings
            )
            if is_clear and all(abs(s_m - other_m) > (length_m + other) / 2 + SYMBOL_GAP_M for other_m, other in taken):
                taken.append((s_m, length_m))
                return s_m
        return None

    symbols = []
    for kind, n in asked.items():
        for _ in range(n):
            if (s_m := place(LENGTHS_M[kind], before_only=True)) is not None:
                symbols.append(Symbol(kind=kind, lane=None, s_m=s_m))
    for _ in range(n_arrow_rows):
        if (s_m := place(LENGTHS_M["arrow_straight"])) is not None:
            lanes = [lane for lane in network.lanes_at(s_m * network.onwards) if lane.direction == "same"]
            symbols += [Symbol(kind=_arrow(network, lane, turns), lane=lane.id, s_m=s_m) for lane in lanes]
    hatched = gore_of(network)
    if gore and hatched is not None and scene.surface.shoulder_texture == PAVED:
        symbols.append(Symbol(kind="gore", lane=None, s_m=round(hatched[1] * network.onwards, SCENE_DECIMALS)))
    return tuple(symbols)


def _arrow(network: Network, lane: NetworkLane, turns: list[float]) -> SymbolKind:
    """The arrow of a lane: where its successors lead, or as before a junction where no roads part, where `turns` in
    [0, 1) decide what the outer lanes may do."""
    if not network.links:
        n = max(at.number for at in network.lanes.values() if at.section == lane.section)
        if lane.number == 1:
            return (STRAIGHT, *TO_LEFT)[int(3 * turns[0])]
        return (STRAIGHT, *TO_RIGHT)[int(3 * turns[1])] if lane.number == n else STRAIGHT
    # Roads part to the right as t grows, and lead back to the left.
    aside, back = (TO_RIGHT, TO_LEFT) if network.rightward > 0 else (TO_LEFT, TO_RIGHT)
    after = [at.road != lane.road for at in network.successors(lane.id)]
    if not any(after):
        return STRAIGHT
    if network.road(lane.road).parting is not None:
        return back[1]
    return aside[1] if all(after) else aside[0]
