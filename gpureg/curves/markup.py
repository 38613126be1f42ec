"""Parse and write XML, for SVG and GPX."""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree
from xml.parsers import expat


def parsed(text: str) -> ElementTree.Element:
    """Parse a text of XML with its comments.

    Raises
    ------
    ValueError
        No XML; entities that refer to others, whose text can grow without limit, or to other files.
    """
    _refuse_entities(text)
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    try:
        return ElementTree.fromstring(text, parser)
    except ElementTree.ParseError as error:
        raise ValueError(f"damaged, or no XML: {error}") from None


def _refuse_entities(text: str) -> None:
    if "<!ENTITY" not in text:
        return

    def declared(name: str, parameter: int, value: str | None, *_: str | None) -> None:
        if parameter or value is None or "&" in value:
            raise ValueError(f"it declares the entity {name!r}, which refers to others or to a file: this is refused")

    parser = expat.ParserCreate()
    parser.EntityDeclHandler = declared
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"damaged, or no XML: {error}") from None


def register_prefixes(text: str) -> None:
    """Let a document keep its prefixes of namespaces when it is written."""
    for _, (prefix, uri) in ElementTree.iterparse(io.StringIO(text), events=["start-ns"]):
        # prefixes that ElementTree reserves cannot be registered
        if not re.fullmatch(r"ns\d+", prefix or ""):
            ElementTree.register_namespace(prefix, uri)


def name_of(element: ElementTree.Element) -> str:
    """Return the name of an element without its namespace; empty for a comment."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def written(root: ElementTree.Element) -> bytes:
    """Encode a document."""
    encoded: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return encoded + b"\n"
