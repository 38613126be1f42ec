"""Graphs in and out: Matrix Market and NumPy files, networkx.

scipy reads and writes Matrix Market, networkx comes with the extra ``networkx``; both are imported here alone, inside
the functions that need them.
"""

from __future__ import annotations

import dataclasses
import gzip
import io
import math
import numbers
import os
import re
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import numpy.typing as npt

from .arrays import FloatArray
from .graph import SYMMETRIZE_MENDS, Graph, GridGraph, Symmetrize, check_symmetrize
from .io import PictureError, write_atomically

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

    # Without this numpy takes whatever is no archive for a pickle, and its message leads astray.
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


def write_graph(path: str | os.PathLike[str], graph: Graph) -> None:
    """Write a graph to a Matrix Market (.mtx, .mtx.gz) or NumPy (.npz) file, whole or not at all.

    The file is written under another name in the same folder and renamed, so that an error or an interruption leaves
    what was there before. :func:`read_graph` gives the same graph again, bit for bit.

    Parameters
    ----------
    path : path
        The extension tells the format. Matrix Market holds the weights alone, as a symmetric real matrix (pattern
        where the graph has none) in as many digits as float64 needs; positions, and weights as float32, are kept by
        .npz only. No format keeps the grid of ``grid.to_graph()``.
    graph : Graph

    Raises
    ------
    TypeError
        Something other than a Graph; of a GridGraph, give ``grid.to_graph()``.
    ValueError
        An unknown extension.
    OSError
        The file cannot be written.
    """
    kind = _format(path)
    _check_graph("write_graph", graph)
    write: Callable[[BinaryIO], None] = _write_npz(graph) if kind == ".npz" else _write_mtx(graph, kind == ".mtx.gz")

    def into(temporary: Path) -> None:
        # A stream, not a name: numpy and scipy would choose an extension of their own.
        with open(temporary, "wb") as file:
            write(file)

    try:
        write_atomically(path, into)
    except PictureError as error:  # a graph is no picture
        raise OSError(str(error)) from None


def _check_graph(name: str, graph: Any) -> None:
    if isinstance(graph, GridGraph):
        raise TypeError(f"{name} takes a Graph, got a GridGraph: give grid.to_graph()")
    if not isinstance(graph, Graph):
        raise TypeError(f"{name} takes a Graph, got {type(graph).__name__}")


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
        # scipy calls a matrix without entries real, whatever it is told.
        data = text.getvalue().replace(b" real ", f" {field} ".encode(), 1)
        file.write(gzip.compress(data, mtime=0) if packed else data)

    return write


def _networkx() -> Any:
    try:
        import networkx
    except ImportError as error:
        raise ImportError("networkx is not installed: pip install gpureg[networkx]") from error
    return networkx


def from_networkx(g: Any, *, weight: str | None = "weight", symmetrize: Symmetrize | None = None) -> Graph:
    """Graph from a networkx graph of any class; vertex i is the i-th of ``list(g.nodes)``.

    Parameters
    ----------
    g : networkx.Graph, DiGraph, MultiGraph or MultiDiGraph
        Where all nodes have an attribute "pos", these become the positions.
    weight : str or None, default "weight"
        Edge attribute that holds the weights. An edge without it counts 1; where none has it, or for None, the graph
        is without weights.
    symmetrize : {"max", "mean", "mutual"}, optional
        What becomes of directed and parallel edges, as in :meth:`Graph.from_edges`; an edge of an undirected graph
        leads both ways. None refuses parallel edges, and directed ones whose opposite is missing or weighs something
        else.

    Raises
    ------
    ImportError
        networkx is not installed.
    TypeError
        Something other than a networkx graph, a weight that is no real number.
    ValueError
        Self-loops, weights that are negative or not finite, positions of different lengths; directed and parallel
        edges without `symmetrize`.

    Examples
    --------
    >>> import networkx as nx
    >>> from_networkx(nx.path_graph(["a", "b", "c"]))
    Graph(3 vertices, 2 undirected edges, unweighted)
    >>> from_networkx(nx.DiGraph([("a", "b"), ("b", "c")]), symmetrize="max")
    Graph(3 vertices, 2 undirected edges, unweighted)
    """
    nx = _networkx()
    check_symmetrize(symmetrize)
    if not isinstance(g, nx.Graph):  # the base of all four classes
        raise TypeError(f"from_networkx takes a networkx graph, got {type(g).__name__}")
    number = {node: i for i, node in enumerate(g.nodes)}
    if not number:
        raise ValueError("a graph needs at least one vertex, this networkx graph has no nodes")
    ends, values, weighted = [], [], False
    for u, v, attributes in g.edges(data=True):
        if u == v:
            raise ValueError(
                f"self-loops are not allowed, node {u!r} has one: g.remove_edges_from(list(nx.selfloop_edges(g)))"
            )
        value = 1 if weight is None else attributes.get(weight, 1)
        if not isinstance(value, numbers.Real | np.bool_):
            raise TypeError(f"weights must be real numbers, {weight!r} of edge ({u!r}, {v!r}) is {value!r}")
        if not 0 <= float(value) < math.inf:
            raise ValueError(f"weights must be finite and >= 0, {weight!r} of edge ({u!r}, {v!r}) is {value!r}")
        weighted |= weight is not None and weight in attributes
        ends.append((u, v))
        values.append(float(value))
    if symmetrize is None:
        _refuse_unmatched(ends, values, g.is_directed())
    edges = np.array([(number[u], number[v]) for u, v in ends], np.int64).reshape(-1, 2)
    weights = np.array(values) if weighted else None
    if not g.is_directed() and symmetrize is not None:
        edges = np.concatenate([edges, edges[:, ::-1]])
        weights = None if weights is None else np.concatenate([weights, weights])
    # Directed edges that passed the check above come in equal pairs: "max" makes one of two.
    how = "max" if symmetrize is None and g.is_directed() else symmetrize
    return Graph.from_edges(edges, weights, n_vertices=len(number), positions=_node_positions(g.nodes), symmetrize=how)


def _refuse_unmatched(ends: list[tuple[Any, Any]], values: list[float], directed: bool) -> None:
    """Refuse parallel edges, and directed ones without an equal in the other direction, by the names of the nodes."""
    known: dict[tuple[Any, Any], float] = {}
    for (u, v), value in zip(ends, values, strict=True):
        if (u, v) in known or (not directed and (v, u) in known):
            raise ValueError(f"each edge may be given once, ({u!r}, {v!r}) is repeated: {SYMMETRIZE_MENDS}")
        known[u, v] = value
    if not directed:
        return
    for (u, v), value in known.items():
        if (v, u) not in known:
            raise ValueError(
                f"every edge must lead both ways: ({u!r}, {v!r}) is there but ({v!r}, {u!r}) is not: {SYMMETRIZE_MENDS}"
            )
        if value != known[v, u]:
            raise ValueError(
                f"weights must be the same in both directions, edge ({u!r}, {v!r}) has {value} one way and "
                f"{known[v, u]} the other: {SYMMETRIZE_MENDS}"
            )


def _node_positions(nodes: Mapping[Any, Mapping[str, Any]]) -> FloatArray | None:
    if not all("pos" in attributes for attributes in nodes.values()):
        return None
    try:
        positions = np.array([attributes["pos"] for attributes in nodes.values()], np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError('the node attribute "pos" must hold as many numbers for every node') from error
    if positions.ndim != 2:
        raise ValueError(f'the node attribute "pos" must hold one row of numbers, got shape {positions.shape[1:]}')
    return positions


def to_networkx(graph: Graph) -> Any:
    """The graph as an undirected ``networkx.Graph`` with the nodes 0..n-1.

    Weights become the edge attribute "weight" (none where the graph has none), positions the node attribute "pos", a
    tuple. All numbers are Python's.

    Raises
    ------
    ImportError
        networkx is not installed.
    TypeError
        Something other than a Graph; of a GridGraph, give ``grid.to_graph()``.

    Examples
    --------
    >>> to_networkx(Graph.from_edges([[0, 1], [1, 2]], [1.0, 0.5])).edges(data="weight")
    EdgeDataView([(0, 1, 1.0), (1, 2, 0.5)])
    """
    nx = _networkx()
    _check_graph("to_networkx", graph)
    g = nx.Graph()
    g.add_nodes_from(range(graph.n_vertices))
    if graph.positions is not None:
        nx.set_node_attributes(g, dict(enumerate(map(tuple, graph.positions.tolist()))), "pos")
    rows = graph.edge_rows()
    forward = rows < graph.indices
    ends = rows[forward].tolist(), graph.indices[forward].tolist()
    if graph.weights is None:
        g.add_edges_from(zip(*ends, strict=True))
    else:
        g.add_weighted_edges_from(zip(*ends, graph.weights[forward].tolist(), strict=True))
    return g
