"""Mark the public functions, so that an error names the function that the user called.

A public function (a "door") often calls another one. An error that is raised in the inner one begins with the name of
the outer one: ``denoise_tv: lam must be finite and >= 0, got -1``. An old parameter name raises an error with the new.
Arrays of other libraries become numpy arrays here, and results arrays of their kind (:mod:`gpureg.exchange`).
"""

from __future__ import annotations

import functools
import inspect
import os
import sys
import warnings
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, overload

from . import exchange

P = ParamSpec("P")
D = TypeVar("D")
R = TypeVar("R")
T = TypeVar("T")

_PACKAGE = f"{Path(__file__).parent}{os.sep}"

# Name of the public function that the user called, while it runs; empty where no name is to be shown.
_called: ContextVar[str | None] = ContextVar("_called", default=None)

# Whether a public function runs.
_inside: ContextVar[bool] = ContextVar("_inside", default=False)

# Marks an error that a function of the caller raised.
_THEIRS = "_raised_by_a_function_of_the_caller"

RENAMED: dict[str, dict[str, str]] = {
    "denoise_image": {"nearest": "k"},
    "denoise_nl_means": {"a": "patch_sigma"},
    "inpaint_image": {"mask": "missing"},
    "patch": {"radius": "patch_radius", "a": "patch_sigma"},
    "patch_graph": {"a": "patch_sigma"},
    "plan_denoising": {"nearest": "k"},
    "Regions.hierarchy": {"lams": "lam", "tol": "merge_tol"},
    "Regions.merged": {"tol": "merge_tol"},
    "simplify_image": {"merge": "merge_tol"},
    "regularization_path": {"lams": "lam"},
    "point_patches": {"side": "patch_radius, which is (side - 1) / 2,"},
    "segment_mesh": {"lams": "lam", "met_at": "merge_tol"},
    "simplify_curve": {"function": "filter"},
}
"""Renamed parameters: function, old name, new name."""


@overload
def door(function: type[T], /) -> type[T]: ...


@overload
def door(function: Callable[P, R], /) -> Callable[P, R]: ...


@overload
def door(
    *, name: str | None = None, options: Mapping[str, Any] | None = None, lent: Iterable[str] = ()
) -> Callable[[Callable[P, R]], Callable[P, R]]: ...


def door(
    function: Any = None,
    /,
    *,
    name: str | None = None,
    options: Mapping[str, Any] | None = None,
    lent: Iterable[str] = (),
) -> Any:
    """Mark a public function, or the constructor of a public class.

    Parameters
    ----------
    function : callable or class
        A class is changed in place. On a dataclass, write this decorator above ``@dataclass``.
    name : str, optional
        Name in error messages; the default is the function's own name.
    options : mapping, optional
        Names and defaults of the options that the function takes as ``**options`` and passes on. They become part of
        its signature; any other option is refused.
    lent : iterable of str
        Parameters that the function takes as :class:`gpureg.exchange.Lent` where this is possible.

    Returns
    -------
    callable
        The function. If a user calls it, messages of TypeError and ValueError begin with its name, and its arguments
        may be arrays of other libraries. A parameter in :data:`RENAMED` raises a TypeError with the new name.
    """
    if function is None:
        return functools.partial(door, name=name, options=options, lent=lent)
    if isinstance(function, type):
        constructor = function.__init__  # type: ignore[misc]
        function.__init__ = door(name=name or function.__name__)(constructor)  # type: ignore[misc]
        return function
    called = name or function.__name__
    renamed = RENAMED.get(called, {})
    signature = inspect.signature(function)
    if options is not None:
        signature = _with_options(signature, options)
    names = tuple(signature.parameters)
    known, taken = None if options is None else set(names), frozenset(lent)

    @functools.wraps(function)
    def outermost(*args: Any, **given: Any) -> Any:
        for old in given:
            if old in renamed:
                raise TypeError(f"{called}: {old!r} is called {renamed[old]} now")
            if known is not None and old not in known:
                raise TypeError(f"{called}() got an unexpected keyword argument {old!r}")
        if _inside.get():
            return exchange.call(function, names, args, given, lent=taken, inner=True)
        named = _called.get() is None
        inside, token = _inside.set(True), _called.set(called if named else _called.get())
        try:
            return _until_done(lambda: exchange.call(function, names, args, given, lent=taken))
        except (TypeError, ValueError) as error:
            alone = type(error) in (TypeError, ValueError) and len(error.args) == 1
            if named and alone and not hasattr(error, _THEIRS):
                said = str(error.args[0])
                if not said.startswith((f"{called}:", f"{called}()", f"{called}.__init__()")):
                    error.args = (f"{called}: {said}",)
            raise
        finally:
            _called.reset(token)
            _inside.reset(inside)

    outermost.__signature__ = signature  # type: ignore[attr-defined]
    return outermost


def _until_done(run: Callable[[], T]) -> T:
    """Call a function; call it again after an error with an attribute `again`, as after a build that failed.

    Such an error has changed what is chosen. The attribute says what has failed: after a second error of the same,
    which the user has named, the call ends. What the call held is freed before the next one.
    """
    failed = set[Hashable]()
    while True:
        try:
            return run()
        except Exception as error:
            what = getattr(error, "again", None)
            if what is None or what in failed:
                raise
            failed.add(what)


def part_of(work: Callable[P, D]) -> Callable[[Callable[[D], R]], Callable[P, R]]:
    """Build a function with the parameters of `work` that returns a part of its result.

    Parameters
    ----------
    work : callable
        The function that is called. Its result contains more than the new function returns.

    Returns
    -------
    callable
        A decorator for a function that maps the result of `work` to the new result. The parameters, their types and
        defaults come from `work`; the decorated function documents them.
    """

    def decorator(part: Callable[[D], R]) -> Callable[P, R]:
        @functools.wraps(part)
        def function(*args: P.args, **given: P.kwargs) -> R:
            return part(work(*args, **given))

        own = inspect.signature(part).return_annotation
        function.__signature__ = inspect.signature(work).replace(return_annotation=own)  # type: ignore[attr-defined]
        function.__annotations__ = work.__annotations__ | {"return": own}
        return function

    return decorator


def _with_options(signature: inspect.Signature, options: Mapping[str, Any]) -> inspect.Signature:
    """Replace ``**options`` in a signature by named options."""
    own = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
    names = {p.name for p in own}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default)
        for name, default in options.items()
        if name not in names
    ]
    return signature.replace(parameters=[*own, *more])


@contextmanager
def without_names() -> Iterator[None]:
    """Leave function names out of error messages, as on the command line, where the user called none."""
    token = _called.set("")
    try:
        yield
    finally:
        _called.reset(token)


@contextmanager
def calling_back() -> Iterator[None]:
    """Call a function of the caller, such as a callback: its errors stay as they are."""
    token, inside = _called.set(None), _inside.set(False)
    try:
        yield
    except (TypeError, ValueError) as error:
        setattr(error, _THEIRS, True)
        raise
    finally:
        _inside.reset(inside)
        _called.reset(token)


def warn(sentence: str, category: type[Warning] = UserWarning) -> None:
    """Warn in a sentence, at the line outside gpureg that called it."""
    warnings.warn(sentence, category, stacklevel=outside())


def outside() -> int:
    """Return the `stacklevel` of the first caller outside gpureg, for a warning in the calling function."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    return level
