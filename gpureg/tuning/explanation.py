"""Why a plan's parameters are what they are, in words."""

from __future__ import annotations

from collections.abc import Mapping


def table(rows: Mapping[str, tuple[str, str]]) -> str:
    """Write lines of a name, a value, and why it is that."""
    name, value = (max(map(len, column)) for column in (rows, [value for value, _ in rows.values()]))
    return "\n".join(f"{n:{name}}  {v:{value}}  {why}" for n, (v, why) in rows.items())
