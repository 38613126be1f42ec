"""Graphs in Matrix Market and NumPy files."""

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

# Exceptions that parsers raise for a file that is truncated, damaged or of another format.
_DAMAGE: tuple[type[Exception], ...] = (
    *(ValueError, TypeError, LookupError, OverflowError, EOFError, OSError, RuntimeError),
    *(zipfile.BadZipFile, zlib.error),
)

# Matrix Market: the banner and comments before the numbers, the characters of numbers (also of nan and infinity, for
# which there is another error later), and an exponent without digits.
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
        The extension determines the format. A Matrix Market file may be real, integer or pattern (a graph without
        weights), and may list one triangle or both. An .npz file is from :func:`write_graph` or
        ``scipy.sparse.save_npz``, or has a CSR matrix as ``adj_data``, ``adj_indices``, ``adj_indptr`` and
        ``adj_shape``, as the gnn-benchmark data sets.
    symmetrize : {"max", "mean", "mutual"}, optional
        How directed and repeated edges are joined, as in :meth:`Graph.from_scipy`; with None they are an error.

    Returns
    -------
    Graph
        The weights have the precision of the file (float64 from Matrix Market). It has positions if an .npz file of
        :func:`write_graph` has them.

    Raises
    ------
    FileNotFoundError
        No such file.
    ValueError
        An unknown extension, a damaged file, or a matrix that is not a graph: not square, negative, complex or
        non-finite entries, self-loops, directed or repeated edges without `symmetrize`. The message names the file.

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
            raise ValueError(f"{path} is damaged or not a {what}: {error}") from error
    try:
        graph = Graph.from_scipy(matrix, symmetrize=symmetrize, positions=positions)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not weighted and graph.weights is not None and np.all(graph.weights == 1):
        return dataclasses.replace(graph, weights=None)
    return graph


def _read_mtx(file: BinaryIO, packed: bool) -> tuple[Any, bool, None]:
    """Return the matrix, whether it has weights, and None for positions."""
    from scipy.io import mminfo, mmread

    data = file.read()
    if packed:
        data = gzip.decompress(data)
    field = mminfo(io.BytesIO(data))[4]
    # mmread reads 1.5D-3 as 1.5, and crashes on a file that ends in 1.5e (scipy 1.17).
    head = _HEAD.match(data)
    start = head.end() if head else 0
    stray = data[start:].translate(None, _IN_NUMBERS)
    if stray:
        raise ValueError(f"it contains characters that are not part of a number: {stray[:10]!r}")
    if _BARE_EXPONENT.search(data, start):
        raise ValueError("it contains a number whose exponent is cut off")
    return mmread(io.BytesIO(data)), field != "pattern", None


def _read_npz(file: BinaryIO) -> tuple[Any, bool, FloatArray | None]:
    """Return the matrix, whether it has weights, and positions."""
    from scipy import sparse

    # Without this check numpy treats another file as a pickle, with a misleading message.
    if not zipfile.is_zipfile(file):
        raise ValueError("it is not a zip archive")
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
    # scipy does not check indptr, which may be out of bounds in a damaged file.
    if hasattr(matrix, "check_format"):
        matrix.check_format(full_check=True)
    return matrix, weighted, positions


def _csr(data: npt.NDArray[Any], indices: npt.NDArray[Any], indptr: npt.NDArray[Any], shape: npt.NDArray[Any]) -> Any:
    from scipy import sparse

    if data.shape != indices.shape:
        raise ValueError(f"the number of weights, {data.size}, is not the number of indices, {indices.size}")
    if any(array.dtype.kind not in "iu" for array in (indices, indptr, shape)):
        raise ValueError("indices, indptr and shape must hold integers")
    return sparse.csr_array((data, indices, indptr), shape=tuple(shape.tolist()))


@door
def write_graph(path: str | os.PathLike[str], graph: StoredLike) -> None:
    """Write a graph to a Matrix Market (.mtx, .mtx.gz) or NumPy (.npz) file.

    The file is written under another name in the same folder and then renamed: after an error or an interruption an
    existing file is unchanged. :func:`read_graph` returns the same graph, bit for bit.

    Parameters
    ----------
    path : path
        The extension determines the format. Matrix Market contains only the weights, as a symmetric real matrix with
        all digits of float64 (pattern for a graph without weights). Only .npz contains positions, and weights as
        float32. No format contains the grid of ``grid.to_graph()``.
    graph : Graph
        Or a symmetric sparse matrix of scipy without a diagonal, or a graph of networkx without self-loops.

    Raises
    ------
    TypeError
        Not a graph with stored edges; for a GridGraph give ``grid.to_graph()``.
    ValueError
        An unknown extension.
    OSError
        The file cannot be written.
    """
    kind = _format(path)
    stored = as_stored(graph, degrees=True)
    write: Callable[[BinaryIO], None] = _write_npz(stored) if kind == ".npz" else _write_mtx(stored, kind == ".mtx.gz")

    def into(temporary: Path) -> None:
        # A stream, not a name: numpy and scipy would change the extension.
        with open(temporary, "wb") as file:
            write(file)

    try:
        write_atomically(path, into)
    except PictureError as error:  # a graph is not an image
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
        # 17 digits distinguish all float64 numbers.
        mmwrite(text, graph.to_scipy().astype(np.float64), field=field, precision=17, symmetry="symmetric")
        # scipy writes "real" for a matrix without entries, whatever `field` is.
        data = text.getvalue().replace(b" real ", f" {field} ".encode(), 1)
        file.write(gzip.compress(data, mtime=0) if packed else data)

    return write
