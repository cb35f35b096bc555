"""How a scene is rendered: everything about the pictures that is not in the scene itself. No bpy."""

from dataclasses import dataclass

PASSES = ("depth", "normal", "semantic", "instance")
DEVICES = ("auto", "cpu", "cuda", "optix", "hip", "oneapi", "metal")
QUALITY_SAMPLES = {"draft": 2, "standard": 4, "high": 8}


@dataclass(frozen=True)
class RenderSettings:
    """Samples per pixel, passes to return beside the image, and the Cycles device."""

    samples: int = QUALITY_SAMPLES["standard"]
    passes: tuple[str, ...] = ()
    device: str = "cpu"
