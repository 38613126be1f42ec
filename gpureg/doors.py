"""What all public functions have in common: an error names the function that was called, and a renamed parameter.

A public function, a door, often calls another one. :func:`door` marks them, so that an error that is raised inside
begins with the name of the one that the caller wrote: ``denoise_tv: lam must be finite and >= 0, got -1``.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar, overload

P = ParamSpec("P")
D = TypeVar("D")
R = TypeVar("R")
T = TypeVar("T")

# The public function that the caller wrote, while it runs.
_called: ContextVar[str | None] = ContextVar("_called", default=None)

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
"""Parameters that had another name before: function, old name, what to write now."""


@overload
def door(function: type[T], /) -> type[T]: ...


@overload
def door(function: Callable[P, R], /) -> Callable[P, R]: ...


@overload
def door(
    *, name: str | None = None, options: Mapping[str, Any] | None = None
) -> Callable[[Callable[P, R]], Callable[P, R]]: ...


def door(function: Any = None, /, *, name: str | None = None, options: Mapping[str, Any] | None = None) -> Any:
    """Mark a public function, or a public class, whose constructor is then the function.

    Parameters
    ----------
    function : callable or class
        A class stays the same object; above a dataclass's own decorator.
    name : str, optional
        What an error calls it. None takes the function's own name.
    options : mapping, optional
        Names and defaults of the options that the function takes as ``**options`` and hands on. They become part of
        its signature, and an option that is none of them is refused here.

    Returns
    -------
    callable
        The function, whose errors of type TypeError and ValueError begin with its name where it was called from
        outside of gpureg, and which says what a parameter in :data:`RENAMED` is called now.
    """
    if function is None:
        return functools.partial(door, name=name, options=options)
    if isinstance(function, type):
        constructor = function.__init__  # type: ignore[misc]
        function.__init__ = door(name=name or function.__name__)(constructor)  # type: ignore[misc]
        return function
    called = name or function.__name__
    renamed = RENAMED.get(called, {})
    signature = inspect.signature(function)
    if options is not None:
        signature = _with_options(signature, options)
    known = None if options is None else signature.parameters.keys()

    @functools.wraps(function)
    def outermost(*args: Any, **given: Any) -> Any:
        for old in given:
            if old in renamed:
                raise TypeError(f"{called}: {old!r} is called {renamed[old]} now")
            if known is not None and old not in known:
                raise TypeError(f"{called}() got an unexpected keyword argument {old!r}")
        if _called.get() is not None:
            return function(*args, **given)
        token = _called.set(called)
        try:
            return function(*args, **given)
        except (TypeError, ValueError) as error:
            if type(error) in (TypeError, ValueError) and len(error.args) == 1:
                said = str(error.args[0])
                if not said.startswith((f"{called}:", f"{called}()", f"{called}.__init__()")):
                    error.args = (f"{called}: {said}",)
            raise
        finally:
            _called.reset(token)

    outermost.__signature__ = signature  # type: ignore[attr-defined]
    return outermost


def part_of(work: Callable[P, D]) -> Callable[[Callable[[D], R]], Callable[P, R]]:
    """Make a function of what it returns of the result of another one, whose parameters it takes.

    Parameters
    ----------
    work : callable
        What does the work. Its result says more than the caller of the new function asked for.

    Returns
    -------
    callable
        A decorator of functions from the result of `work` to what the caller gets. The parameters, their types and
        their defaults are written once, at `work`, and documented at the decorated function.
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
    """A signature with named options in the place of ``**options``."""
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
    """Errors inside say nothing of a function: the caller wrote none, as on the command line."""
    token = _called.set("")
    try:
        yield
    finally:
        _called.reset(token)
