"""Road works on the paper's road, as data: where they are, what they close, and the lines that hold there."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from synth3dlanes.system.schema import DocumentPart, Metres, Positive, Unit

WorksKind = Literal["none", "lane_closed", "lanes_narrowed", "lanes_shifted", "shoulder_closed"]
WorksWidth = Annotated[float, Field(ge=0, le=50)]


class RoadWorks(DocumentPart):
    """Road works between two world stations, tapers included, on the outer side of the host's lanes (where exits leave)
    or on their `inner` side. Over `taper_m` from their front on, the closed area widens from the edge of the pavement;
    over `end_taper_m` it ends. They close the shoulder and, if so, the outermost lane, which ends where they begin.

    The edge line of their side moves in by `taken_m`. The edge line of the other side moves out by `shift_m`, onto its
    shoulder; the open lanes share the width between both. Moved lines are temporary: they have a colour and a width of
    their own. The permanent lines that they replace were removed; their traces have the contrast `removed`. Lines `as
    before` do not move."""

    start_m: Metres
    end_m: Metres
    taper_m: Positive
    end_taper_m: Positive
    inner: bool
    closes_lane: bool
    taken_m: WorksWidth
    shift_m: WorksWidth
    lines: Literal["as_before", "white", "yellow"]
    line_width_m: Positive
    removed: Unit

    @model_validator(mode="after")
    def _has_room(self) -> "RoadWorks":
        """Check that the tapers have room, and that lines move only if they may."""
        if self.end_m - self.start_m < self.taper_m + self.end_taper_m:
            raise ValueError(f"end_m: expected room for both tapers behind {self.start_m:g} m, got {self.end_m:g}")
        if (self.lines == "as_before") != (self.taken_m == self.shift_m == 0):
            raise ValueError(f"lines: expected as_before where no line moves, and only there, got {self.lines}")
        return self

    @property
    def kind(self) -> WorksKind:
        """What they do to the lanes."""
        if self.closes_lane:
            return "lane_closed"
        if self.shift_m:
            return "lanes_shifted"
        return "lanes_narrowed" if self.taken_m else "shoulder_closed"

    @property
    def words(self) -> str:
        """What they are, in a line."""
        lines = "the lines as before" if self.lines == "as_before" else f"{self.lines} temporary lines"
        side = "inner" if self.inner else "outer"
        stations = f"from y = {self.start_m:.0f} m to {self.end_m:.0f} m"
        return f"{self.kind.replace('_', ' ')} on the {side} side, {stations}, {lines}"
