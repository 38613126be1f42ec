"""Graphs in and out: Matrix Market and NumPy files, networkx.

scipy reads and writes Matrix Market, networkx comes with the extra ``networkx``; both are imported here alone, inside
the functions that need them.
"""

from __future__ import annotations

import dataclasses
import gzip
import io
import os
import re
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..doors import door
from ..files.pictures import PictureError, write_atomically
from .accepted import StoredLike, as_stored
from .csr import Graph
from .edges import Symmetrize, check_symmetrize

FORMATS = (".mtx", ".mtx.gz", ".npz")

# What parsers raise for a file that is cut off, altered, or something else altogether.
_DAMAGE: tuple[type[Exception], ...] = (
    *(ValueError, TypeError, LookupError, OverflowError, EOFError, OSError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error),
)

# Matrix Market: the banner and comments in front of the numbers, what numbers consist of (nan and infinity as well,
# which are refused by that name later), and an exponent without digits.
_HEAD = re.compile(rb"(?:%[^\n]*\n|[ \t\r]*\n)*")
_IN_NUMBERS = b"0123456789+-.eE \t\r\n" + b"nNaAiIfFtTyY"
_BARE_EXPONENT = re.compile(rb"[eE](?![+-]?[0-9])")


def _format(path: str | os.PathLike[str]) -> str:
    name = os.fspath(path).lower()
    for suffix in FORMATS:
        if name.endswith(suffix):
            return suffix
    raise ValueError(f"{path}: the extension must be one of {', '.join(FORMATS)}")


@door
def read_graph(path: str | os.PathLike[str], *, symmetrize: Symmetrize | None = None) -> Graph:
    """Read a graph from a Matrix Market (.mtx, .mtx.gz) or NumPy (.npz) file.

    Parameters
    ----------
    path : path
        The extension tells the format. A Matrix Market file may be real, integer or pattern, which makes a graph
        without weights, and may list one triangle or both. An .npz file is one that :func:`write_graph` or
        ``scipy.sparse.save_npz`` wrote, or one with a CSR matrix as ``adj_data``, ``adj_indices``, ``adj_indptr`` and
        ``adj_shape``, as the gnn-benchmark data sets are.
    symmetrize : {"max", "mean", "mutual"}, optional
        What becomes of directed and repeated edges, as in :meth:`Graph.from_scipy`; None refuses them.

    Returns
    -------
    Graph
        With the weights in the precision of the file (float64 from Matrix Market), and with positions where an .npz
        file of :func:`write_graph` holds them.

    Raises
    ------
    FileNotFoundError
        No such file.
    ValueError
        An unknown extension, a damaged file, a matrix that is no graph: not square, negative, complex or non-finite
        entries, self-loops, and directed or repeated edges without `symmetrize`. The message names the file.

    Examples
    --------
    >>> import os, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = os.path.join(folder, "path.mtx")
    ...     write_graph(path, Graph.from_edges([[0, 1], [1, 2]]))
    ...     read_graph(path)
    Graph(3 vertices, 2 undirected edges, unweighted)
    """
    kind = _format(path)
    check_symmetrize(symmetrize)
    if not os.path.exists(path):
        raise FileNotFoundError(f"{path} does not exist")
    if os.path.isdir(path):
        raise ValueError(f"{path} is a folder, not a file")
    with open(path, "rb") as file:
        try:
            matrix, weighted, positions = _read_npz(file) if kind == ".npz" else _read_mtx(file, kind == ".mtx.gz")
        except _DAMAGE as error:
            what = "NumPy archive of a graph" if kind == ".npz" else "Matrix Market file"
            raise ValueError(f"{path} is damaged or no {what}: {error}") from error
    try:
        graph = Graph.from_scipy(matrix, symmetrize=symmetrize, positions=positions)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not weighted and graph.weights is not None and np.all(graph.weights == 1):
        return dataclasses.replace(graph, weights=None)
    return graph


def _read_mtx(file: BinaryIO, packed: bool) -> tuple[Any, bool, None]:
    """The matrix, whether it has weights, and no positions."""
    from scipy.io import mminfo, mmread

    data = file.read()
    if packed:
        data = gzip.decompress(data)
    field = mminfo(io.BytesIO(data))[4]
    # mmread takes 1.5D-3 for 1.5, and crashes on a file that ends in 1.5e (scipy 1.17).
    head = _HEAD.match(data)
    start = head.end() if head else 0
    stray = data[start:].translate(None, _IN_NUMBERS)
    if stray:
        raise ValueError(f"there are characters of no number in it, {stray[:10]!r} for one")
    if _BARE_EXPONENT.search(data, start):
        raise ValueError("there is a number in it whose exponent is cut off")
    return mmread(io.BytesIO(data)), field != "pattern", None


def _read_npz(file: BinaryIO) -> tuple[Any, bool, FloatArray | None]:
    """The matrix, whether it has weights, and positions."""
    from scipy import sparse

    # Without this numpy takes a file that is no archive for a pickle, and its message misleads.
    if not zipfile.is_zipfile(file):
        raise ValueError("it is no zip archive")
    file.seek(0)
    with np.load(file, allow_pickle=False) as archive:
        names = set(archive.files)
        if "format" in names:
            file.seek(0)
            matrix = sparse.load_npz(file)
            weighted, positions = True, None
        elif {"adj_data", "adj_indices", "adj_indptr", "adj_shape"} <= names:
            matrix = _csr(archive["adj_data"], archive["adj_indices"], archive["adj_indptr"], archive["adj_shape"])
            weighted, positions = True, None
        elif {"indptr", "indices"} <= names:
            indptr, indices = archive["indptr"], archive["indices"]
            weighted = "weights" in names
            data = archive["weights"] if weighted else np.ones(len(indices))
            matrix = _csr(data, indices, indptr, np.array([len(indptr) - 1] * 2))
            positions = archive["positions"] if "positions" in names else None
        else:
            found = ", ".join(sorted(names)) or "nothing"
            raise ValueError(
                f"it holds {found}, not the indptr and indices of write_graph, a matrix of scipy.sparse.save_npz, or "
                f"adj_data, adj_indices, adj_indptr and adj_shape"
            )
    # scipy follows indptr unchecked, which a damaged file may lead out of bounds.
    if hasattr(matrix, "check_format"):
        matrix.check_format(full_check=True)
    return matrix, weighted, positions


def _csr(data: npt.NDArray[Any], indices: npt.NDArray[Any], indptr: npt.NDArray[Any], shape: npt.NDArray[Any]) -> Any:
    from scipy import sparse

    if data.shape != indices.shape:
        raise ValueError(f"{data.size} weights do not fit {indices.size} indices")
    if any(array.dtype.kind not in "iu" for array in (indices, indptr, shape)):
        raise ValueError("indices, indptr and shape must hold integers")
    return sparse.csr_array((data, indices, indptr), shape=tuple(shape.tolist()))


@door
def write_graph(path: str | os.PathLike[str], graph: StoredLike) -> None:
    """Write a graph to a Matrix Market (.mtx, .mtx.gz) or NumPy (.npz) file, whole or not at all.

    The file is written under another name in the same folder and renamed, so that an error or an interruption leaves
    what was there before. :func:`read_graph` gives the same graph again, bit for bit.

    Parameters
    ----------
    path : path
        The extension tells the format. Matrix Market holds the weights alone, as a symmetric real matrix (pattern
        where the graph has none) in as many digits as float64 needs; only .npz
        holds positions, and weights as float32. No format holds the grid of ``grid.to_graph()``.
    graph : Graph
        Or a symmetric sparse matrix of scipy without a diagonal, or a graph of networkx without self-loops.

    Raises
    ------
    TypeError
        What is no graph with stored edges; of a GridGraph, give ``grid.to_graph()``.
    ValueError
        An unknown extension.
    OSError
        The file cannot be written.
    """
    kind = _format(path)
    stored = as_stored(graph, degrees=True)
    write: Callable[[BinaryIO], None] = _write_npz(stored) if kind == ".npz" else _write_mtx(stored, kind == ".mtx.gz")

    def into(temporary: Path) -> None:
        # A stream, not a name: numpy and scipy would choose an extension of their own.
        with open(temporary, "wb") as file:
            write(file)

    try:
        write_atomically(path, into)
    except PictureError as error:  # a graph is no picture
        raise OSError(str(error)) from None


def _write_npz(graph: Graph) -> Callable[[BinaryIO], None]:
    arrays: dict[str, Any] = {"indptr": graph.indptr, "indices": graph.indices}
    if graph.weights is not None:
        arrays["weights"] = graph.weights
    if graph.positions is not None:
        arrays["positions"] = graph.positions

    def write(file: BinaryIO) -> None:
        np.savez_compressed(file, **arrays)

    return write


def _write_mtx(graph: Graph, packed: bool) -> Callable[[BinaryIO], None]:
    from scipy.io import mmwrite

    def write(file: BinaryIO) -> None:
        text = io.BytesIO()
        field: Literal["pattern", "real"] = "pattern" if graph.weights is None else "real"
        # 17 digits tell any two float64 apart.
        mmwrite(text, graph.to_scipy().astype(np.float64), field=field, precision=17, symmetry="symmetric")
        # scipy writes "real" for a matrix without entries, even where `field` says something else.
        data = text.getvalue().replace(b" real ", f" {field} ".encode(), 1)
        file.write(gzip.compress(data, mtime=0) if packed else data)

    return write
