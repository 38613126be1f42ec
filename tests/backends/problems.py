"""What the primitives are called with: graphs with weights or gamma, functions on their vertices and edges, patches.

All on the host, in float64, of values that float32 holds exactly, the same for the oracle and for the devices.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import bounds
import cases
import numpy as np

from gpureg import backends
from gpureg.backends import PatchForm, Smoothness
from gpureg.graphs.csr import Graph
from gpureg.graphs.edges import opposite_edges
from gpureg.graphs.grid import GridGraph

DTYPES = ("float32", "float64")

# p and eps, one a class of the proximal step (kernels/README.md): closed forms, and Newton's method below and above 2.
CLASSES = ((1.0, 0.0), (2.0, 0.0), (1.5, 0.0), (3.0, 0.0), (1.0, cases.EPS), (1.5, cases.EPS), (3.0, cases.EPS))
HOT, GENERAL = CLASSES[:1], (CLASSES[0], CLASSES[5])


@functools.cache
def oracle() -> Any:
    """numpy in float64."""
    return backends.get("numpy", "float64")


def rounded(x: Any) -> Any:
    """To float32 and back, so that both types hold it exactly."""
    return None if x is None else x.astype(np.float32).astype(np.float64)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A setup in one type, with one form of gamma and one norm; `classes` are the p and eps of the dual steps.

    `directed` gives gamma one value per directed edge instead of sqrt(w).
    """

    setup: cases.Setup
    dtype: str = "float32"
    directed: bool = False
    edge_norm: bool = False
    classes: tuple[tuple[float, float], ...] = ()

    @property
    def id(self) -> str:
        """A name for pytest."""
        words = ("gamma", self.directed), ("edge norm", self.edge_norm), (f"{len(self.classes)} p", self.classes)
        extras = [word for word, there in words if there]
        return "-".join([self.setup.id, self.dtype, *extras])

    def make(self) -> Problem:
        """The problem, made once."""
        return problem(self)


class Problem:
    """A setup's functions, weights and gamma."""

    def __init__(self, kind: Kind) -> None:
        self.kind, self.setup, self.dtype = kind, kind.setup, kind.dtype
        self.directed, self.edge_norm = kind.directed, kind.edge_norm
        self.channels, self.coupled = kind.setup.channels, kind.setup.coupled
        self.graph, self.weights = cases.graph(kind.setup.graph), cases.weights(kind.setup.graph)
        self.f, self.f0, self.f_before = (cases.function(self.graph, self.channels, seed) for seed in (11, 13, 17))
        self.lam = cases.fidelity(self.graph)
        # for what divides by it
        self.positive = np.where(self.lam == 0, 0.5, self.lam)
        self.tau = 0.125 * cases.rng(61).random((self.graph.n_vertices, 1), dtype=np.float32).astype(np.float64)
        # what the oracle gave, under the primitive and the call
        self.exact: dict[Any, Any] = {}

    @property
    def plain(self) -> bool:
        """Whether gamma = sqrt(w) and the norm is that of the vertices: there the bounds are sharp."""
        return not self.directed and not self.edge_norm

    @functools.cached_property
    def csr(self) -> Graph:
        """The graph with its weights, stored."""
        return self.graph if isinstance(self.graph, Graph) else self.graph.to_graph(self.weights)

    @functools.cached_property
    def rows(self) -> Any:
        return self.csr.edge_rows()

    @property
    def columns(self) -> Any:
        return self.csr.indices

    @functools.cached_property
    def opposite(self) -> Any:
        return opposite_edges(self.csr.indptr, self.csr.indices)

    def _random(self, seed: int, channels: int) -> Any:
        shape = (len(self.rows), channels)
        return cases.rng(seed).random(shape, dtype=np.float32).astype(np.float64)

    @functools.cached_property
    def random_gamma(self) -> Any:
        """One value per directed edge, one in nine of them 0, (n_edges, 1)."""
        values = self._random(53, 1)
        values[::9] = 0
        return values

    @functools.cached_property
    def own(self) -> Any:
        """gamma(u, v), (n_edges, 1)."""
        if self.directed:
            return self.random_gamma
        w = np.ones(len(self.rows)) if self.csr.weights is None else self.csr.weights.astype(np.float64)
        return np.sqrt(w)[:, None]

    @property
    def other(self) -> Any:
        """gamma(v, u), (n_edges, 1)."""
        return self.own[self.opposite]

    @functools.cached_property
    def H(self) -> Any:
        """A function on the edges, (n_edges, m)."""
        return self._random(59, self.channels) - 0.5

    @functools.cached_property
    def y(self) -> Any:
        """A dual variable: short and long vectors, inside the unit ball and outside."""
        return 4 * self.H * (self.rows % 3 > 0)[:, None]

    @functools.cached_property
    def y_before(self) -> Any:
        return self._random(67, self.channels) - 0.5

    def inside(self, y: Any) -> Any:
        """The dual variable y, scaled where needed into a ball a little smaller than the unit ball."""
        r = np.sqrt(self.dual.norms(y**2))
        factor = np.minimum(1, 0.875 * self.dual.share / np.maximum(r, 1e-9))
        return rounded(y * (factor if self.edge_norm else factor[self.rows]))

    def host(self, edges: Any) -> Any:
        """A function on the edges as a backend takes it."""
        return self.graph.edges.scatter(edges) if isinstance(self.graph, GridGraph) else edges

    def edges(self, host: Any) -> Any:
        """The reverse, (n_edges, m)."""
        return self.graph.edges.gather(host) if isinstance(self.graph, GridGraph) else host

    def on(self, backend: Any) -> Any:
        """The graph with its weights or gamma on a device."""
        if self.directed:
            return backend.prepare_gamma(self.graph, self.host(self.random_gamma))
        return backend.prepare(self.graph, self.weights)

    @functools.cached_property
    def on_oracle(self) -> Any:
        return self.on(oracle())

    def smoothness(self, p: float, eps: float = cases.EPS) -> Smoothness:
        return Smoothness(p, eps, self.coupled, self.edge_norm)

    def conductances(self, p: float) -> Any:
        """What every p but 2 needs, exact in both types: a primitive is held to its own errors alone."""
        if self.edge_norm:
            return self.smoothness(p)
        if self.plain:
            return None if p == 2 else rounded(self.q ** ((p - 2) / 2))
        return rounded(oracle().conductances(self.on_oracle, self.f, self.smoothness(p)))

    @functools.cached_property
    def q(self) -> Any:
        """|grad f|^2 + eps^2."""
        return oracle().gradient_norm(self.on_oracle, self.f, power=1, eps=cases.EPS, coupled=self.coupled)

    # How far a device may be off

    @functools.cached_property
    def bounds(self) -> bounds.Bounds:
        return bounds.Bounds(self.graph, self.weights, self.dtype)

    @functools.cached_property
    def dual(self) -> bounds.DualBounds:
        return bounds.DualBounds(
            self.graph.n_vertices,
            self.rows,
            self.columns,
            self.own,
            self.other,
            directed=self.directed,
            coupled=self.coupled,
            edge_norm=self.edge_norm,
            dtype=self.dtype,
        )

    def around(self, edges: Any) -> Any:
        """Sums over the edges of each vertex, (n, m)."""
        n = self.graph.n_vertices
        return np.stack([np.bincount(self.rows, column, minlength=n) for column in edges.T], axis=1)

    @functools.cached_property
    def sizes(self) -> Any:
        """|gamma_vu f(v)| + |gamma_uv f(u)|, what the two terms of a difference can be, (n_edges, m)."""
        return self.other * np.abs(self.f[self.columns]) + self.own * np.abs(self.f[self.rows])

    @functools.cached_property
    def largest_flow(self) -> float:
        return float(self.around(self.own * self.sizes).max(initial=0))

    def push(self, p: float) -> float:
        """A bound on the terms of a p-Laplacian: the largest conductance times the largest flow."""
        largest = (self.around(self.sizes**2).sum(axis=1).max(initial=0) + cases.EPS**2) ** 0.5
        return 2 * max(cases.EPS ** (p - 2), largest ** (p - 2)) * self.largest_flow


@functools.cache
def problem(kind: Kind) -> Problem:
    """The problem of this kind."""
    return Problem(kind)


# Patches


@dataclasses.dataclass(frozen=True)
class PatchCase:
    """Weights from patches: the patch, similarity or bare distance, with a spatial factor or not."""

    graph: str
    channels: int = 1
    radius: int = 1
    gaussian: bool = False
    shift: float = 0.0
    scale: float | None = None
    spatial: bool = False
    wide: bool = False
    maps: bool = False
    cut: float = 0.0

    @property
    def id(self) -> str:
        kind = "distance" if self.scale is None else "similarity"
        extras = [name for name in ("gaussian", "spatial", "maps", "shift", "cut") if getattr(self, name)]
        return f"{self.graph}, {self.channels}, radius {self.radius}, {' '.join([kind, *extras])}"

    def form(self, graph: cases.AnyGraph) -> PatchForm:
        r = self.radius
        profile = np.ones(2 * r + 1)
        if self.gaussian:
            profile = np.exp(-(np.arange(-r, r + 1) ** 2) / 2)
            profile /= profile.sum()
        spatial = None
        if self.spatial and isinstance(graph, GridGraph):
            spatial = np.exp(-(graph.forward_offsets**2).sum(axis=1) / 4)
        elif self.spatial:
            spatial = np.exp(-np.abs(graph.edge_rows() - graph.indices) / 64)
        maps = None
        if self.maps:
            # exact in both types: what is taken off, and strengths that differ by a factor of 8 at most
            a = cases.rng(31).integers(0, 16, graph.n_vertices) / 64
            maps = np.stack([a, 2.0 ** cases.rng(37).integers(-1, 3, graph.n_vertices)], axis=-1)
        return PatchForm(profile, self.shift, self.scale, spatial, maps, self.cut)


@dataclasses.dataclass(frozen=True)
class PatchKind:
    """A patch case in one type; for a step, lam as a "number" or an "array", and whether a guide is compared."""

    case: PatchCase
    dtype: str = "float32"
    lam: str = "number"
    guided: bool = False

    @property
    def id(self) -> str:
        return f"{self.case.id}-{self.dtype}-lam a {self.lam}{'-guided' if self.guided else ''}"

    def make(self) -> PatchProblem:
        return patch_problem(self)


class PatchProblem:
    """A function whose patches are compared, the form of the weights, and how far a weight may be off."""

    directed = edge_norm = False

    def __init__(self, kind: PatchKind) -> None:
        case = kind.case
        self.kind, self.dtype, self.channels = kind, kind.dtype, case.channels
        self.graph, self.weights = cases.graph(case.graph), None
        self.f, self.f0 = (cases.function(self.graph, case.channels, seed) for seed in (11, 13))
        self.guide = cases.function(self.graph, case.channels + 1, seed=19) if kind.guided else None
        self.form = case.form(self.graph)
        self.lam = 0.75 if kind.lam == "number" else cases.fidelity(self.graph)
        self.exact: dict[Any, Any] = {}

    def on(self, backend: Any) -> Any:
        return None  # these primitives make their own weights

    on_oracle = None

    @property
    def compared(self) -> Any:
        return self.f if self.guide is None else self.guide

    def weights_of(self, **changes: Any) -> Any:
        """The oracle's weights of this form, with changes."""
        form = dataclasses.replace(self.form, **changes)
        return oracle().get_weights(oracle().patch_distance(self.graph, self.compared, form))

    @functools.cached_property
    def spatial(self) -> Any:
        """The spatial factor per weight; 0 where an edge leaves the grid or the mask."""
        if isinstance(self.graph, GridGraph):
            inside = self.graph.edges.unit_half()
            return (
                inside if self.form.spatial is None else inside * self.form.spatial.reshape(-1, *(1,) * self.graph.ndim)
            )
        return np.ones(self.graph.n_edges) if self.form.spatial is None else self.form.spatial

    @functools.cached_property
    def bounds(self) -> bounds.Bounds:
        """For the steps: of the graph with these weights."""
        return bounds.Bounds(self.graph, self.weights_of(), self.dtype)

    @functools.cached_property
    def off(self) -> Any:
        """How far a weight may be off, leaving `cut` aside."""
        graph = self.graph
        ndim = graph.ndim if isinstance(graph, GridGraph) else 1 if graph.grid is None else graph.grid.ndim
        rho = self.weights_of(scale=None, cut=0.0)
        limit = bounds.Bounds(graph, cases.weights(self.kind.case.graph), self.dtype)
        channels = self.compared.shape[1]
        return limit.patch_distance(rho, self.form, self.spatial, channels, ndim, *self._at_both_ends())

    def _at_both_ends(self) -> tuple[Any, ...]:
        """a(u) + a(v) and q(u) q(v) per weight, of a form with maps."""
        graph, form = self.graph, self.form
        if form.maps is None:
            return ()
        a, q = form.maps.T
        if isinstance(graph, Graph):
            return a[graph.edge_rows()] + a[graph.indices], q[graph.edge_rows()] * q[graph.indices]
        taken, strength = np.zeros((2, graph.half_window, *graph.shape))
        a, q = a.reshape(graph.shape), q.reshape(graph.shape)
        for h, step in enumerate(graph.forward_offsets):
            u, v = graph.ends(step)
            taken[h][u], strength[h][u] = a[u] + a[v], q[u] * q[v]
        return taken, strength


@functools.cache
def patch_problem(kind: PatchKind) -> PatchProblem:
    """The problem of this kind."""
    return PatchProblem(kind)
