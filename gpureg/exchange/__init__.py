"""Arrays of other libraries in public functions: how they come in, and how results go back as the same kind.

The decorator :func:`gpureg.doors.door` uses it for every public function, so that all code below works with numpy
arrays. No library is imported here: where one of its arrays exists, it is already imported. One file a library; to add
one, write its file with the functions of :class:`.libraries.Library`, and a line in ``KNOWN``.
"""

from __future__ import annotations

from .arguments import Origin, as_came, as_given, call, called_with, on_host, place, taken
from .lent import Lent
from .libraries import Memory, Place

__all__ = [
    "Lent",
    "Memory",
    "Origin",
    "Place",
    "as_came",
    "as_given",
    "call",
    "called_with",
    "on_host",
    "place",
    "taken",
]
