"""Synthetic 3D-lane images with exact ground truth: docs/api.md has all names below with examples.

Importing this package loads none of its modules; each name loads what it needs when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synth3dlanes.api import (
        change_scene,
        check_drive,
        dataset_stats,
        export_dataset,
        generate_dataset,
        label,
        lift_drive,
        load_camera,
        load_job,
        load_params,
        load_rig,
        load_scene,
        merge_datasets,
        open_assets,
        open_dataset,
        open_drive,
        report_dataset,
        sample_scene,
        save_job,
        save_scene,
        score_predictions,
        split_dataset,
        validate_dataset,
        verify_export,
    )
    from synth3dlanes.dataset.format import Sample
    from synth3dlanes.dataset.read import Reader
    from synth3dlanes.dataset.scenes import read_scene
    from synth3dlanes.figures.overlay import draw_overlay
    from synth3dlanes.formats.export import Export
    from synth3dlanes.labels.labels import Labels, Lane, SymbolLabel
    from synth3dlanes.params.cameras import CameraSpec
    from synth3dlanes.params.params import Params
    from synth3dlanes.production.job import Job
    from synth3dlanes.renderer import Rendered, Renderer, render
    from synth3dlanes.scene.scene import Scene
    from synth3dlanes.system.errors import (
        DiskFullError,
        FormatError,
        InputError,
        MissingPackageError,
        Synth3dlanesError,
        WorkerError,
    )
else:
    # Type checkers must not see this function: they would accept any name.
    def __getattr__(name: str) -> Any:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'api')}"), name)


__version__ = "0.3.0"

__all__ = [
    "CameraSpec",
    "DiskFullError",
    "Export",
    "FormatError",
    "InputError",
    "Job",
    "Labels",
    "Lane",
    "MissingPackageError",
    "Params",
    "Reader",
    "Rendered",
    "Renderer",
    "Sample",
    "Scene",
    "SymbolLabel",
    "Synth3dlanesError",
    "WorkerError",
    "change_scene",
    "check_drive",
    "dataset_stats",
    "draw_overlay",
    "export_dataset",
    "generate_dataset",
    "label",
    "lift_drive",
    "load_camera",
    "load_job",
    "load_params",
    "load_rig",
    "load_scene",
    "merge_datasets",
    "open_assets",
    "open_dataset",
    "open_drive",
    "read_scene",
    "render",
    "report_dataset",
    "sample_scene",
    "save_job",
    "save_scene",
    "score_predictions",
    "split_dataset",
    "validate_dataset",
    "verify_export",
]

# The modules of the names that are not functions of `api`.
_HOMES = {
    **dict.fromkeys(("DiskFullError", "FormatError", "InputError", "MissingPackageError"), "system.errors"),
    **dict.fromkeys(("Synth3dlanesError", "WorkerError"), "system.errors"),
    "CameraSpec": "params.cameras",
    "Export": "formats.export",
    "Job": "production.job",
    "Labels": "labels.labels",
    "Lane": "labels.labels",
    "Params": "params.params",
    "Reader": "dataset.read",
    **dict.fromkeys(("Rendered", "Renderer", "render"), "renderer"),
    "Sample": "dataset.format",
    "Scene": "scene.scene",
    "SymbolLabel": "labels.labels",
    "draw_overlay": "figures.overlay",
    "read_scene": "dataset.scenes",
}


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
