"""XML elements with words and numbers as OpenDRIVE files have them."""

from xml.etree import ElementTree

Element = ElementTree.Element


def add(parent: Element, tag: str, **attributes: str | float) -> Element:
    """Add an element with these attributes."""
    texts = {key: value if isinstance(value, str) else text(value) for key, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def text(value: float) -> str:
    """Ten digits: a micrometre in a kilometre. Smaller than a picometre is noise."""
    return f"{value:.10g}" if abs(value) > 1e-12 else "0"
