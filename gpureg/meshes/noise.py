"""Estimate the noise of a mesh around each vertex: :class:`MeshNoise`, :func:`estimate_mesh_noise`."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import choice
from ..doors import door, outside
from ..graphs.components import Components, sorted_medians
from ..graphs.csr import Graph
from ..graphs.of_shapes import face_edges, mesh_graph
from ..noise.graphs import MEDIAN, averaging
from ..noise.local import ring_medians, row_medians, row_noise, settled, spread, twice_growth
from ..shapes.orientation import used_faces
from ..shapes.surface import surface_of, vertex_normals

Per = Literal["mesh", "component", "vertex"]

# A component with fewer pairs of faces at an edge, or fewer vertices, does not tell its noise.
TELLING = 12

# What denoising does where the noise cannot be told.
LEFT = "nothing moves there; give sigma or lam to denoise it"

# The noise of a component is the root mean square over its vertices, without the largest tenth; this factor makes it
# right for white noise of 0.05 to 0.4 edges on spheres, tori, cubes and scans.
_LARGEST, _FACTOR = 0.9, 1.2

# Averages over neighbours that smooth the map of the noise.
_SMOOTH = 5

# The plane of two faces at an edge is their own if the cosine of their angle is above the first, or the height of one
# over its longest edge below the second; otherwise, where noise may tilt it, the one along the normals of the vertices.
_LEVEL, _THIN = 0.98, 0.2

# A spike is further from the mean of its neighbours than this share of the edges around, and this number of times the
# usual distance around; out of the planes of its faces it is by the last share of this distance at least, which long
# strips of triangles are not.
_SPIKE, _TIMES, _BENT = 0.8, 4.0, 0.05
# A flying vertex has edges longer than this number of times the usual opposite edge of its faces, this share of them at
# least, and is out of the planes of its faces by the last share of that edge.
_LONG, _MOSTLY, _APEX = 3.0, 0.65, 0.25
# Passes in which spikes are found, each with fewer of them among the neighbours.
_PASSES = 4


@dataclass(frozen=True, eq=False)
class MeshNoise:
    """The noise of a mesh along its normals.

    Attributes
    ----------
    local : (n,) float array
        Standard deviation around each vertex; NaN where it cannot be told.
    parts : (c,) float array
        Standard deviation of each component; NaN where it cannot be told.
    spikes : (n,) bool array
        Single vertices far from all of their neighbours.
    flying : (n,) bool array
        Those of them that are many edges away.
    sizes : (c,) int array
        Number of vertices of each component.
    smooth : (n, 3) float array
        The vertices, with spikes at the mean of their neighbours.
    """

    local: FloatArray
    parts: FloatArray
    spikes: npt.NDArray[np.bool_]
    flying: npt.NDArray[np.bool_]
    sizes: IntArray
    smooth: FloatArray

    @property
    def whole(self) -> float:
        """The root mean square over all vertices with a known noise; NaN without any."""
        known = ~np.isnan(self.parts)
        return float(np.sqrt(np.average(self.parts[known] ** 2, weights=self.sizes[known]))) if known.any() else np.nan


def measured(v: FloatArray, faces: IntArray, graph: Graph, parts: Components) -> MeshNoise:
    """Measure the noise of a mesh, (n, 3) and (F, 3) with an area each, from its graph and components.

    Two samples of the noise are compared at each vertex: the height above the mean of the neighbours less the mean of
    this height around, and the height of four vertices of two faces above a plane, over the edges around. The first is
    0 on smooth shapes, the second on flat faces of any triangles; their smaller median counts.
    """
    n = len(v)
    M = averaging(graph)
    four = hinges(faces)
    ends = four[:, :2].ravel()
    order = np.argsort(ends, kind="stable")
    indptr = np.searchsorted(ends[order], np.arange(n + 1))

    def bent(v: FloatArray, normals: FloatArray) -> FloatArray:
        return np.repeat(plane_offsets(v, four, normals), 2)[order]

    normals = vertex_normals(v, faces)
    offsets = bent(v, normals)
    plane = row_noise(indptr, offsets)
    flying = flying_vertices(v, faces, np.nan_to_num(row_medians(indptr, offsets)))
    v, spikes = without_spikes(v, graph, M, plane, flying)
    if spikes.any():
        normals = vertex_normals(v, faces)
        plane = row_noise(indptr, bent(v, normals))
    heights = ((v - M @ v) * normals).sum(axis=1)
    curved = np.abs(heights - M @ heights) / twice_growth(graph, M)
    smaller = np.minimum(
        ring_medians(graph, ring_medians(graph, curved)) / MEDIAN, ring_medians(graph, ring_medians(graph, plane))
    )
    pairs = np.bincount(parts.labels[four[:, 0]], minlength=parts.count)
    told = (np.minimum(pairs, parts.sizes()) >= TELLING)[parts.labels]
    smaller = np.where(told & np.isfinite(smaller), smaller, 0.0)
    local: FloatArray = _FACTOR * np.sqrt(spread(graph, smaller**2, _SMOOTH, M))
    most = parts.quantiles(smaller, _LARGEST)[parts.labels]
    of_parts = _FACTOR * np.sqrt(parts.means(np.minimum(smaller, most) ** 2))
    unknown = ~(np.minimum(pairs, parts.sizes()) >= TELLING)
    local = settled(local, parts)
    # the map has the level of the components, whose largest values are shape
    level = np.sqrt(parts.means(local**2))
    local *= np.divide(of_parts, level, out=np.ones_like(level), where=level > 0)[parts.labels]
    known = np.where(unknown, np.nan, of_parts)
    spikes &= told
    return MeshNoise(np.where(told, local, np.nan), known, spikes, spikes & flying, parts.sizes(), v)


def hinges(faces: IntArray) -> IntArray:
    """Return the four vertices of two faces at an edge, (H, 4): the ends of the edge, and the two opposite corners."""
    ends = np.sort(face_edges(faces), axis=1)
    opposite = np.roll(faces, -2, axis=1).ravel()
    keys = ends @ np.array([int(faces.max(initial=0)) + 1, 1])
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    one, two = order[first], order[first + 1]
    return np.column_stack([ends[one], opposite[one], opposite[two]])


def plane_offsets(v: FloatArray, four: IntArray, normals: FloatArray) -> FloatArray:
    """Compute the distance of four points from a plane, (H,), with standard deviation 1 for noise of 1 at each of them.

    It is |sum a_i h_i| / sqrt(sum a_i^2), with the heights h_i, and the areas a_i of the triangles of the other three
    points in the plane, with signs: the sum is six times the volume of the four points. `normals` are those of the
    vertices, (n, 3).
    """
    c, d, a, b = (v[four[:, k]] for k in range(4))
    one, two = np.cross(d - c, a - c), np.cross(b - c, d - c)
    volume = np.abs((one * (b - c)).sum(axis=1))
    # the faces may have opposite orientations
    two *= np.where((one * two).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    sizes = [np.linalg.norm(x, axis=1) for x in (one, two)]
    tiny = np.finfo(float).tiny
    level = (one * two).sum(axis=1) > _LEVEL * np.maximum(sizes[0] * sizes[1], tiny)
    sides = [((x - y) ** 2).sum(axis=1) for x, y in ((c, d), (c, a), (d, a), (c, b), (d, b))]
    thin = np.minimum(*sizes) < _THIN * np.max(sides, axis=0)
    up = np.where((level | thin)[:, None], one + two, normals[four].sum(axis=1))
    lengths = np.linalg.norm(up, axis=1, keepdims=True)
    up = np.divide(up, lengths, out=np.zeros_like(up), where=lengths > 0)
    triangles = ((d, a, b), (c, a, b), (c, d, b), (c, d, a))
    areas = [(np.cross(y - x, z - x) * up).sum(axis=1) for x, y, z in triangles]
    size = np.sqrt(np.sum([x**2 for x in areas], axis=0))
    offsets: FloatArray = np.divide(volume, size, out=np.zeros_like(volume), where=size > 0)
    return offsets


def flying_vertices(v: FloatArray, faces: IntArray, plane: FloatArray) -> npt.NDArray[np.bool_]:
    """Find vertices far out of a surface: with long edges around a small ring, and out of their faces, (n,) bool.

    `plane`, (n,), is the median of :func:`plane_offsets` around each vertex: of two that are neighbours, the faces to
    the other one are flat. Up to three of them may be neighbours: a third of the edges may be short, and less than half
    of the ring long.
    """
    n = len(v)
    longest, opposite = np.zeros(n), np.full(n, np.inf)
    sides = [np.linalg.norm(v[faces[:, (k + 1) % 3]] - v[faces[:, (k + 2) % 3]], axis=1) for k in range(3)]
    for k in range(3):
        np.minimum.at(opposite, faces[:, k], sides[k])
        np.maximum.at(longest, faces[:, k], np.maximum(sides[k - 1], sides[k - 2]))
    flying = np.zeros(n, bool)
    # the medians are of the few vertices that may be flying
    may = (longest > _LONG * opposite) & (plane > _APEX * opposite)
    if not may.any():
        return flying
    corner = faces.T.ravel()
    across = np.concatenate(sides)
    edges = np.stack([np.concatenate([sides[k - j] for k in range(3)]) for j in (1, 2)], axis=1)
    few = may[corner]
    corner, across, edges = corner[few], across[few], edges[few]
    order = np.lexsort((across, corner))
    count = np.bincount(corner, minlength=n)
    ring = np.nan_to_num(sorted_medians(across[order], np.concatenate([[0], np.cumsum(count)])))
    long = np.bincount(corner, (edges > _LONG * ring[corner, None]).mean(axis=1), n)
    flying = may & (long >= _MOSTLY * count) & (plane > _APEX * ring) & (ring > 0)
    return flying


def without_spikes(
    v: FloatArray, graph: Graph, M: Any, plane: FloatArray, flying: npt.NDArray[np.bool_]
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Find single vertices far from the mean of their neighbours, compared with the edges and other vertices around.

    A spike is not in a plane with the faces around: `plane`, (n,), is the noise seen there; `flying`, (n,), are spikes.

    Returns
    -------
    vertices : (n, 3) float array
        The vertices, spikes at the mean of their neighbours without spikes.
    spikes : (n,) bool array
    """
    rows, enough = graph.edge_rows(), np.diff(graph.indptr) > 2
    spikes = np.zeros(len(v), bool)
    smooth = v
    if flying.any():
        # several of them that are neighbours hide each other in means
        share = M @ (~flying).astype(np.float64)
        begin = (M @ np.where(flying[:, None], 0.0, v)) / np.where(share > 0, share, 1.0)[:, None]
        smooth = np.where((flying & (share > 0))[:, None], begin, v)
    for _ in range(_PASSES):
        means = M @ smooth
        own = row_medians(graph.indptr, np.linalg.norm(smooth[rows] - smooth[graph.indices], axis=1))
        around = row_medians(graph.indptr, own[graph.indices])
        usual = ring_medians(graph, ring_medians(graph, np.linalg.norm(smooth - means, axis=1)))
        far = np.linalg.norm(v - means, axis=1)
        found = enough & (far > _SPIKE * around) & (flying | ((far > _TIMES * usual) & (plane > _BENT * far)))
        if (found == spikes).all():
            break
        spikes = found
        smooth = np.where(spikes[:, None], means, v)
    return smooth, spikes


@door
def estimate_mesh_noise(mesh: Any, faces: npt.ArrayLike | None = None, *, per: Per = "mesh") -> Any:
    """Estimate the standard deviation of the noise of a mesh along its normals, in the units of its coordinates.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
    faces : (F, 3) int array, optional
        The faces, if `mesh` is only the vertices, (n, 3).
    per : {"mesh", "component", "vertex"}, default "mesh"
        "mesh" returns one number, the root mean square over the vertices: if only half of the vertices are noisy, 0.71
        of their noise. "component" returns one number for each connected component with a face, in the order of
        their first vertices. "vertex" returns a map, (n,), each from the neighbourhood of the vertex.

    Returns
    -------
    float or float array
        NaN where the noise cannot be told: in components with fewer than 12 vertices or pairs of faces, and at vertices
        without a face.

    Raises
    ------
    TypeError, ValueError
        Not a triangle mesh; an unknown `per`.

    Warns
    -----
    UserWarning
        The noise of a component cannot be told.

    Notes
    -----
    There are two samples of the noise at a vertex u. The first is h(u) - mean of h around u, where h(u) is the height
    of u above the mean of its neighbours, along the normal: constant curvature cancels. The second is the distance of
    the four vertices of two faces from a plane: on flat faces it is noise, for triangles of any shape. Both are divided
    by their value for white noise of standard deviation 1. The estimate is the smaller of the medians of both around u,
    divided by 0.674, so that a few spikes do not count. Details as fine as the mesh count as noise.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> x, y = (axis.ravel() for axis in np.mgrid[:30, :30])
    >>> corner = np.arange(900).reshape(30, 30)[:-1, :-1].ravel()
    >>> faces = np.concatenate([np.stack([corner, corner + 30, corner + 1], 1),
    ...                         np.stack([corner + 1, corner + 30, corner + 31], 1)])
    >>> heights = np.where(x < 15, 0, np.random.default_rng(0).normal(0, 0.1, 900))
    >>> noise = gr.estimate_mesh_noise((np.stack([x, y, heights], axis=1), faces), per="vertex")
    >>> noise[x < 5].max().round(3), noise[x > 20].mean().round(1)
    (np.float64(0.0), np.float64(0.1))
    """
    choice("per", per, ("mesh", "component", "vertex"))
    surface, which = surface_of(mesh, faces).welded()
    corners = used_faces(surface.vertices, surface.faces)
    graph = mesh_graph(surface.vertices, corners)
    parts = Components.of(graph)
    noise = measured(parts.centred(surface.vertices), corners, graph, parts)
    used = np.bincount(parts.labels, np.diff(graph.indptr), parts.count) > 0
    warn_unknown(np.isnan(noise.parts[used]))
    if per == "mesh":
        return noise.whole
    return noise.parts[used] if per == "component" else noise.local[which]


def warn_unknown(unknown: npt.NDArray[np.bool_], then: str = "the estimate is NaN there") -> None:
    """Warn that the noise of components, (c,) bool, cannot be told, and say what happens `then`."""
    if unknown.any():
        which = f"{unknown.sum()} of {len(unknown)} components of the mesh" if len(unknown) > 1 else "the mesh"
        warnings.warn(
            f"the noise of {which} cannot be told, with fewer than {TELLING} vertices or pairs of faces: {then}",
            stacklevel=outside(),
        )
