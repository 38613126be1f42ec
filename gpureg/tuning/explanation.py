"""Why a plan's parameters are what they are, in words."""

from __future__ import annotations

from collections.abc import Mapping


def table(rows: Mapping[str, tuple[str, str]]) -> str:
    """Lines of a name, a value, and why it is that."""
    name, value = (max(map(len, column)) for column in (rows, [value for value, _ in rows.values()]))
    return "\n".join(f"{n:{name}}  {v:{value}}  {why}" for n, (v, why) in rows.items())


def reasons_for(given: Mapping[str, object], *, local: bool, filters: bool) -> dict[str, str]:
    """Why each parameter of a plan that was not given, None, is what it is."""
    reasons = {
        "weights": "rule: constant for p other than 2" if local else "rule: nonlocal means at p = 2",
        "window": "rule: the nearest neighbours" if local else "rule: so many of the smallest cells",
        "p": "default",
        "lam": "rule: how much a pixel itself counts" if filters else "rule: from the noise",
        "iterations": "rule: a filter is one sweep",
    }
    if local:
        reasons["lam"] = "rule: from the noise and the size of the gradient"
    if not filters:
        reasons["iterations"] = "rule: at p = 2 more only blur" if given["p"] in (None, 2) else "rule"
    why = {name: reasons[name] for name, value in given.items() if value is None}
    if given["weights"] is None:
        why["patch"] = why["h"] = "rule: from the noise, the contrast and the channels"
    return why
