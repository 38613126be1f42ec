"""Check numbers, integers, choices and flags that a caller passes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, TypeVar

import numpy as np

Word = TypeVar("Word", bound=str)


def number(
    name: str,
    value: Any,
    *,
    low: float | None = None,
    above: float | None = None,
    high: float | None = None,
    below: float | None = None,
    finite: bool = True,
) -> float:
    """Check a real number and return it as a float.

    Parameters
    ----------
    name : str
        Name of the parameter, for the error message.
    value : object
        The value to check. True and False are not numbers.
    low, high : float, optional
        Closed bounds: low <= value <= high.
    above, below : float, optional
        Open bounds: above < value < below.
    finite : bool, default True
        Whether infinity is refused; NaN always is.

    Returns
    -------
    float

    Raises
    ------
    TypeError
        Not a number.
    ValueError
        A number outside its range.

    Examples
    --------
    >>> number("sigma", 3, low=0)
    3.0
    >>> number("sigma", -1, low=0)
    Traceback (most recent call last):
    ValueError: sigma must be finite and >= 0, got -1
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise TypeError(f"{name} must be a number, got {value!r}")
    _expect_inside(name, value, low, above, high, below, finite)
    return float(value)


def integer(name: str, value: Any, *, low: int | None = None, high: int | None = None) -> int:
    """Check an integer and return it as an int; 3.0 is not an integer.

    Raises
    ------
    TypeError
        Not an integer.
    ValueError
        An integer outside low..high.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    _expect_inside(name, value, low, None, high, None, False)
    return int(value)


def choice(name: str, value: Any, allowed: Iterable[Word]) -> Word:
    """Check that a value is one of the allowed words, and return it.

    Raises
    ------
    ValueError
        Anything else.
    """
    words = tuple(allowed)
    for word in words:
        if isinstance(value, str) and value == word:
            return word
    raise ValueError(f"{name} must be {either(words)}, got {value!r}")


def either(words: Iterable[str]) -> str:
    """Join words for a sentence: "a", "b" or "c"."""
    quoted = [f'"{word}"' for word in words]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} or {quoted[-1]}"


def flag(name: str, value: Any) -> bool:
    """Check a value that must be True or False, and return it as a bool.

    Raises
    ------
    TypeError
        Anything else.
    """
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def _expect_inside(
    name: str,
    value: Any,
    low: float | None,
    above: float | None,
    high: float | None,
    below: float | None,
    finite: bool,
) -> None:
    """Raise a ValueError if the value is outside its range."""
    inside = (
        not math.isnan(value)
        and (low is None or value >= low)
        and (above is None or value > above)
        and (high is None or value <= high)
        and (below is None or value < below)
    )
    if inside and not (finite and math.isinf(value)):
        return
    begin, end = low if above is None else above, high if below is None else below
    bounded = begin is not None and end is not None
    if bounded and above is None and below is None:
        allowed = f"lie in {begin:g}..{end:g}"
    elif bounded:
        allowed = f"lie in {'[' if above is None else '('}{begin:g}, {end:g}{']' if below is None else ')'}"
    else:
        ends = [("be >= ", low), ("be > ", above), ("be <= ", high), ("be < ", below)]
        allowed = " ".join(f"{word}{at:g}" for word, at in ends if at is not None)
        if finite:
            allowed = f"be finite and {allowed.removeprefix('be ')}" if allowed else "be finite"
        allowed = allowed or "not be NaN"
    raise ValueError(f"{name} must {allowed}, got {value}")
