"""The things of a scene, which come last: all else of a seed is as it is without them."""

from synth3dlanes.draw.bodies import Bodies
from synth3dlanes.draw.draws import DrawsOf
from synth3dlanes.draw.makers import Roads
from synth3dlanes.draw.people import draw_people
from synth3dlanes.draw.riders import draw_riders
from synth3dlanes.draw.works import draw_devices
from synth3dlanes.params.distributions import extent
from synth3dlanes.params.params import Params
from synth3dlanes.scene.scene import Scene, Thing
from synth3dlanes.world.ground import Ground


def draw_things(scene: Scene, ground: Ground, of: DrawsOf, roads: Roads) -> tuple[Thing, ...]:
    """People, riders, and what stands along road works."""
    devices = tuple(draw_devices(scene, ground, of))
    if not has_things(of.params):
        return devices
    bodies = Bodies(scene, ground)
    riders = draw_riders(scene, bodies, of, roads.ride)
    return (*riders, *draw_people(scene, bodies, of, roads.crossers), *devices)


def has_things(params: Params) -> bool:
    """Whether scenes of some parameters may have people or riders."""
    people, riders = params.people, params.riders
    return any(
        extent(most)[1] > 0 for most in (people.per_100_m, people.crossing, riders.cyclists, riders.motorcyclists)
    )
