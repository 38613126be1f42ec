"""Tables of parameters with reasons."""

from __future__ import annotations

from collections.abc import Mapping


def table(rows: Mapping[str, tuple[str, str]]) -> str:
    """Format lines of a name, a value, and the reason for the value."""
    name, value = (max(map(len, column)) for column in (rows, [value for value, _ in rows.values()]))
    return "\n".join(f"{n:{name}}  {v:{value}}  {why}" for n, (v, why) in rows.items())
