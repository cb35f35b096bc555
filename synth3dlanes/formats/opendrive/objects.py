"""What lies and stands on and beside the roads."""

from xml.etree import ElementTree

from synth3dlanes.formats.opendrive.roads import Road
from synth3dlanes.world import World


def add_objects(world: World, found: list[Road], elements: list[ElementTree.Element]) -> None:
    """Add the objects of a world to the elements of its roads."""
