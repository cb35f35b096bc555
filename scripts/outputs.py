"""What `--json` prints, command by command, as docs/outputs.schema.json says it; the tests hold both together."""

from typing import Any, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, create_model

from synth3dlanes.dataset.info import DatasetInfo
from synth3dlanes.figures.stats import ParameterStatistics, QuantitySummary
from synth3dlanes.formats.verify import Compared, DistanceMeasure
from synth3dlanes.production.bench import Bench
from synth3dlanes.production.forecast import Forecast
from synth3dlanes.production.tally import RunReport
from synth3dlanes.recorded.lift.write import LiftReport
from synth3dlanes.scene.assets.folder import FolderCheck
from synth3dlanes.validate.findings import Problem

Value = bool | int | float | str | None


class Document(BaseModel):
    """A JSON document without other keys than these."""

    model_config = ConfigDict(extra="forbid")


class InspectedLane(Document):
    """A lane: counts of its points, of those in the image, of those among them that the ground does not hide, and of
    those that no object hides either (null before rendering); the farthest visible one, in metres ahead."""

    id: str
    kind: str
    road: str
    marking: str
    n_points: int
    n_in_image: int
    n_over_ground: int
    n_visible: int | None
    seen_to_m: float | None


class InspectionOutput(Document):
    """`inspect`: the files written, the numbers of the index (docs/format.md), the lanes, and a summary in words."""

    figure: str | None = None
    page: str | None = None
    columns: dict[str, Value]
    lanes: list[InspectedLane]
    summary: dict[str, dict[str, str]]


def fields_of(kind: type, *left_out: str) -> dict[str, Any]:
    """The fields of a class of the library whose values are printed as an object, for `create_model`."""
    return {name: (of, ...) for name, of in get_type_hints(kind).items() if name not in left_out}


DryRun = create_model(
    "DryRun",
    __base__=Document,
    __doc__="`generate --dry-run`: the plan in words, and what it takes.",
    plan=(str, ...),
    **fields_of(Forecast),
)


class Stats(Document):
    """`stats`: every parameter as declared and as drawn; the quantities of the labels of a data set."""

    n_scenes: int
    topologies: dict[str, int]
    parameters: list[ParameterStatistics]
    labels: list[QuantitySummary] | None = None


FaultOutput = create_model("FaultOutput", __base__=Document, __doc__=Problem.__doc__, **fields_of(Problem))


class AskedCheck(Document):
    """How many samples were asked a check, and what those lack that were not."""

    samples: int
    lacks: list[str]


class Validation(Document):
    """`validate`: problems, checks by their names, notes of what is no fault, and every number that a check holds
    against limits."""

    samples: int
    failed: list[str]
    problems: list[FaultOutput]
    checks: dict[str, AskedCheck]
    notes: list[str]
    numbers: dict[str, dict[str, float | int | str | None]]
    made_again: dict[str, str]


class ScoredImage(Document):
    """An image's F1 and mean error, null where nothing was there to be measured."""

    key: str
    f1: float
    error_cm: float | None


class PoseOutput(Document):
    """Median errors of the predicted pose, null where none is predicted."""

    pitch_median_deg: float | None
    height_median_cm: float | None


class EvaluationOutput(BaseModel):
    """`evaluate` with a network or predictions: the score of each kind (centerline, delimiter), of the pose and of each
    image, the worst first."""

    model_config = ConfigDict(extra="allow")

    source: str
    pose: PoseOutput
    settings: dict[str, Value]
    samples: list[ScoredImage]
    centerline: dict[str, Any] | None = None
    delimiter: dict[str, Any] | None = None


class BenchmarkOutput(Document):
    """`benchmark`: what each split is made of, and the score of the network or predictions that were given."""

    benchmark: str
    splits: dict[str, dict[str, Any]]
    score: dict[str, Any] | None = None


class EvaluatedTargets(BaseModel):
    """`evaluate` without a network: how the labels fit into the targets of a network, and the score of these."""

    model_config = ConfigDict(extra="allow")

    n_images: int
    counts: dict[str, dict[str, int]]
    ceiling: dict[str, Any]


class EvaluatedPhotographs(BaseModel):
    """`evaluate` on photographs: the figures of their benchmark."""

    model_config = ConfigDict(extra="forbid")

    settings: dict[str, Value]
    tusimple: dict[str, float | None] | None = None
    kitti: dict[str, float | None] | None = None


DistanceOutput = create_model(
    "DistanceOutput", __base__=Document, __doc__=DistanceMeasure.__doc__, **fields_of(DistanceMeasure, "unit")
)


class VerificationOutput(Document):
    """A list of frames of an export, compared with the labels: what was compared by its name, such as `lanes` or
    `boxes`; `measures` are by unit."""

    name: str
    n_frames: int
    compared: dict[str, Compared]
    measures: dict[str, DistanceOutput]
    problems: list[str]


class ExportOutput(Document):
    """What an export wrote: frames by part, lines, and how many frames and lines were left out, by reason."""

    frames: dict[str, int]
    lines: int
    left_out: dict[str, int]
    dropped: dict[str, int]
    warnings: list[str]
    verified: list[VerificationOutput]


class DriveCheck(Document):
    """`drive check`: what a drive holds, what its reader left out, and what looks wrong, one line each."""

    name: str
    frames: int
    seconds: float
    camera: str
    image_px: list[int]
    marked_lanes: int
    notes: list[str]
    findings: list[str]


class ListedName(Document):
    """What has a name, and a line that says what it is."""

    name: str
    about: str


class Outputs(Document):
    """What each command prints with `--json`; `params show` prints groups of keys in the forms of parameter files."""

    assets: FolderCheck
    bench: Bench
    benchmark: BenchmarkOutput
    drive_check: DriveCheck
    evaluate: EvaluationOutput | EvaluatedTargets | EvaluatedPhotographs
    export: ExportOutput
    generate: RunReport
    generate_dry_run: DryRun
    info: DatasetInfo
    inspect: InspectionOutput
    lift: LiftReport
    list_: list[ListedName] = Field(alias="list", description="`list`: what has a name, in order.")
    params_show: dict[str, dict[str, Any]] = Field(description="`params show`: every key, by group.")
    stats: Stats
    validate_: Validation = Field(alias="validate")
