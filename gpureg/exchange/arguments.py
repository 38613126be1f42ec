"""Find the arrays of other libraries among the arguments of a call, and return its results as arrays of the data's.

An object that contains such arrays, like a result, names the fields in its class attribute ``_exchanged``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np
import numpy.typing as npt

from .lent import Lent
from .libraries import Library, Place, library_of

# Types that are neither arrays nor contain any: seen at once.
_PLAIN = frozenset((bool, bytes, complex, float, int, str, type, type(None), type(lambda: None)))

# Changes an object, given the name of its parameter.
_Change = Callable[[Any, str], Any]


@dataclasses.dataclass(frozen=True, eq=False)
class Origin:
    """The array of another library that the data of a call are: results become arrays of its kind, on its device.

    Attributes
    ----------
    library : Library
    like : object
        The array.
    views : list of (array, object)
        The numpy arrays that functions compute with instead of the arguments, and the arguments.
    """

    library: Library
    like: Any
    views: list[tuple[npt.NDArray[Any], Any]]

    def as_came(self, result: Any) -> Any:
        """Return a result with its arrays as arrays of the library; numbers, graphs and the like do not change."""
        if isinstance(result, np.ndarray):
            return self._array(result) if result.ndim and result.dtype.kind in "biufc" else result
        return _mapped(result, lambda x, _: self.as_came(x), "", self._field)

    @property
    def place(self) -> Place | None:
        """The device of the data."""
        return self.library.place(self.like)

    def _field(self, value: Any, name: str) -> Any:
        """Return a field of a result; an argument that it holds is the caller's own."""
        for view, given in self.views:
            if view is value:
                return given
        return self.as_came(value)

    def _array(self, value: npt.NDArray[Any]) -> Any:
        usable = value.flags.writeable and value.dtype.isnative and all(stride >= 0 for stride in value.strides)
        if not usable or any(np.may_share_memory(value, view) for view, _ in self.views):
            value = value.astype(value.dtype.newbyteorder("="))
        return self.library.to_library(value, self.like)


# The data of the public function that runs, and of the one that the user called, where they are of another library.
_data: ContextVar[tuple[Origin | None, Origin | None]] = ContextVar("_data", default=(None, None))


def taken(
    names: tuple[str, ...], args: tuple[Any, ...], given: dict[str, Any], lent: frozenset[str] = frozenset()
) -> tuple[tuple[Any, ...], dict[str, Any], Origin | None]:
    """Replace arrays of other libraries in the arguments of a call by numpy arrays.

    Parameters
    ----------
    names : tuple of str
        The names of the parameters, in the order of `args`.
    args, given : tuple, dict
        The arguments by position and by name.
    lent : set of str
        The parameters that may be :class:`Lent`.

    Returns
    -------
    args, given : tuple, dict
    origin : Origin or None
        The first array among the arguments, if it is one of another library.
    """
    found = _Search(lent)
    last = len(names) - 1
    args = tuple(found.on_host(x, names[min(k, last)]) for k, x in enumerate(args))
    # the data are the first parameter, also if the caller names them last
    for name in names:
        if name in given and type(given[name]) not in _PLAIN:
            given = {**given, name: found.on_host(given[name], name)}
    return args, given, found.origin


def on_host(x: Any, name: str) -> Any:
    """Return an array of another library as a numpy array, a view if possible; anything else unchanged."""
    return _Search().on_host(x, name)


def call(
    function: Callable[..., Any],
    names: tuple[str, ...],
    args: tuple[Any, ...],
    given: dict[str, Any],
    *,
    lent: frozenset[str] = frozenset(),
    inner: bool = False,
) -> Any:
    """Call a function with numpy arrays, and return its result as arrays of the data's library.

    Parameters
    ----------
    function : callable
    names, args, given, lent
        As for :func:`taken`.
    inner : bool, default False
        Whether another public function calls it.
    """
    args, given, origin = taken(names, args, given, lent)
    with called_with(origin, inner=inner):
        if origin is None:
            return function(*args, **given)
        try:
            return origin.as_came(function(*args, **given))
        except KeyboardInterrupt as interruption:
            if hasattr(interruption, "result"):
                interruption.result = origin.as_came(interruption.result)
            raise


@contextmanager
def called_with(origin: Origin | None, *, inner: bool = False) -> Iterator[None]:
    """Remember the data of a public function while it runs; `inner` if another public function calls it."""
    token = _data.set((origin, origin or (_data.get()[1] if inner else None)))
    try:
        yield
    finally:
        _data.reset(token)


def as_given(value: npt.NDArray[Any]) -> Any:
    """Return an array as one of the library from which the data of the public function that runs are."""
    origin, _ = _data.get()
    return value if origin is None else origin.as_came(value)


def as_came(value: npt.NDArray[Any]) -> Any:
    """Return an array as one of the library from which the data of the user's call are."""
    _, origin = _data.get()
    return value if origin is None else origin.as_came(value)


def place() -> Place | None:
    """Return the device on which the data of the user's call lie; None for the host."""
    _, origin = _data.get()
    return None if origin is None else origin.place


class _Search:
    """The arguments of one call, seen in order."""

    def __init__(self, lent: frozenset[str] = frozenset()) -> None:
        self._lent = lent
        self.origin: Origin | None = None
        self._views: list[tuple[npt.NDArray[Any], Any]] = []
        # whether the first array has been seen
        self._seen = False

    def on_host(self, x: Any, name: str) -> Any:
        """Return an argument without arrays of other libraries."""
        kind = type(x)
        if kind in _PLAIN:
            return x
        if kind is np.ndarray:
            self._seen = True
            return x
        library = library_of(x)
        if library is not None:
            return self._array(library, x, name)
        if (kind.__module__, kind.__name__) == ("torch", "dtype"):
            return _numpy_type(x)
        found = _mapped(x, self.on_host, name)
        # a list of numbers is data too
        self._seen |= isinstance(x, list) and bool(x)
        return found

    def _array(self, library: Library, x: Any, name: str) -> Any:
        memory = library.to_warp(x, name) if name in self._lent else None
        found: Any = (
            self._on_host(library, x, name)
            if memory is None
            else Lent(library, x, memory, lambda: self._on_host(library, x, name))
        )
        if isinstance(found, np.ndarray) and found.ndim == 0:
            return found[()]
        if not self._seen:
            self._seen, self.origin = True, Origin(library, x, self._views)
        return found

    def _on_host(self, library: Library, x: Any, name: str) -> npt.NDArray[Any]:
        view = library.to_host(x, name)
        self._views.append((view, x))
        return view


def _mapped(x: Any, function: _Change, name: str, of_field: _Change | None = None) -> Any:
    """Apply a function to the items of a list, tuple or dict, or another to the fields that an object exchanges.

    The same object is returned if nothing changes.
    """
    if isinstance(x, list | tuple):
        if all(kind in _PLAIN or issubclass(kind, np.generic) for kind in set(map(type, x))):
            return x
        items = [function(item, name) for item in x]
        if all(a is b for a, b in zip(items, x, strict=True)):
            return x
        if isinstance(x, list):
            return items
        return tuple(items) if type(x) is tuple else type(x)(*items)
    if type(x) is dict:
        entries = {key: function(value, name) for key, value in x.items()}
        return x if all(entries[key] is value for key, value in x.items()) else entries
    fields = getattr(type(x), "_exchanged", ())
    if not fields:
        return x
    values = {field: (of_field or function)(getattr(x, field), name) for field in fields}
    return x if all(getattr(x, field) is value for field, value in values.items()) else dataclasses.replace(x, **values)


def _numpy_type(dtype: Any) -> Any:
    """Return a type of torch as one of numpy; unchanged if numpy has not this type."""
    try:
        return np.dtype(str(dtype).removeprefix("torch."))
    except TypeError:
        return dtype
