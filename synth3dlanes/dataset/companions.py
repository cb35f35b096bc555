"""What lies beside `dataset.json` and follows from it alone: the card of the hub, and Croissant's description."""

from collections.abc import Callable, Mapping
from typing import Any

from synth3dlanes.dataset import card, croissant
from synth3dlanes.dataset.description import parse_description

# By name: what makes the file of a description, and the text without which it is a user's own.
COMPANIONS: dict[str, tuple[Callable[[Mapping[str, Any]], bytes], str]] = {
    card.CARD: (card.card, card.MARK),
    croissant.CROISSANT: (croissant.croissant, croissant.MARK),
}


def updated_companions(before: Mapping[str, bytes | None], description: bytes, where: str) -> dict[str, bytes]:
    """The files that a data set shall have beside this `dataset.json`, which lies at `where`.

    `before` has the contents of each, None where there is none; one that a user has made their own stays.
    """
    contents = parse_description(description, where)
    return {
        name: make(contents) if (found := before[name]) is None or mark.encode() in found else found
        for name, (make, mark) in COMPANIONS.items()
    }
