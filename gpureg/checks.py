"""Numbers, integers, choices and flags as they are given to gpureg, checked in one way."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def check_size(name: str, value: Any) -> None:
    """Refuse what is neither None nor a finite number >= 0.

    Raises
    ------
    TypeError, ValueError
    """
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise TypeError(f"{name} must be a number, got {value!r}")
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be finite and >= 0, got {value}")


def check_settings(settings: dict[str, Any], *, integers: tuple[str, ...] = ("check_every",)) -> None:
    """TypeError or ValueError unless these settings of a solver are numbers; the integers at least 1."""
    for name, value in settings.items():
        kinds = (int, np.integer) if name in integers else (int, float, np.number)
        if value is not None and (isinstance(value, bool) or not isinstance(value, kinds)):
            raise TypeError(f"{name} must be {'an integer' if name in integers else 'a number'}, got {value!r}")
        if name in integers and not (value is not None and value >= 1):
            raise ValueError(f"{name} must be >= 1, got {value}")


def positive(name: str, value: float, *, infinite: bool = False) -> float:
    """A number > 0, checked."""
    if not isinstance(value, int | float | np.floating | np.integer) or isinstance(value, bool):
        raise TypeError(f"{name} must be a number, got {type(value).__name__}")
    if not value > 0 or (math.isinf(value) and not infinite):
        raise ValueError(f"{name} must be > 0{'' if infinite else ' and finite'}, got {value}")
    return float(value)


def share(name: str, value: float) -> float:
    """A number in 0..1, checked."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        raise TypeError(f"{name} must be a number, got {value!r}")
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must lie in 0..1, got {value}")
    return float(value)
