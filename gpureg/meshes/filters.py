"""Filters that denoise the positions of a mesh's vertices, or values on them (section 5.3)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.csr import Graph
from ..graphs.of_shapes import adjacent_faces
from ..model.result import Result
from ..noise.fidelity import fidelities_to_values, fidelity_to_normals
from ..noise.local import ranges
from ..noise.values import alike_channels, mean_squares, value_noise
from ..progress import progress_bar
from ..regularization.options import MODEL, RUN, Model
from ..regularization.regularize import regularize
from ..shapes.surface import Surface, face_normals
from ..solvers import Jacobi, resolve
from ..weights import Weights
from ..weights.triangles import Cotangent
from .noise import LEFT, TELLING, MeshNoise, measured, warn_unknown
from .normals import fitted_vertices, noise_of_normals, regularized_normals
from .report import TAUBIN, MeshDenoising
from .rounds import BELIEVABLE, ROUNDS, denoised_in_rounds

Filter = Literal["normals", "positions"]
FILTERS: tuple[Filter, ...] = get_args(Filter)

# Rounds in which normals are regularized with a given model, and iterations per round; a fourth round makes curved
# shapes worse.
_ROUNDS, _ITERATIONS = 3, 30

# How often the fidelity is raised so that the vertices move by at most BELIEVABLE times the noise: the displacement is
# 0.96 to 1.27 on the pairs of bunny, nicolo, fandisk, block and dodecahedron; 1.9 to 14 where a mesh collapsed.
_TRIES = 8

# Steps that fit the vertices to the normals: more steps make flat faces flatter and curved ones worse.
_FIT = 10

# Noise below this share of the mean edge is the rounding of coordinates.
_NEGLIGIBLE = 1e-5

# Smoothing of the gradient norm in the range of the values, without their outer hundredths.
_EPS = 1e-3


@dataclass(frozen=True, eq=False)
class Task:
    """A function on the vertices of a mesh without repeated vertices, and the settings of the filter.

    Attributes
    ----------
    surface : Surface
        The input mesh, n vertices.
    faces : (F, 3) int array
        Its triangles with an area on the k vertices without repetitions.
    graph : Graph
        The graph of these vertices, with their positions, centred in each component.
    parts : Components
        The components of the graph.
    f0 : (k, m) float array
        The function.
    pinned : (k,) bool array
        Vertices whose position or value does not change.
    lam : float, (k,) array or None
    sigma, p : float or None
    weights : Weights, array or None
    max_iter : int or None
    options : Model
        Other settings of :func:`gpureg.regularize`.
    """

    surface: Surface
    faces: IntArray
    graph: Graph
    parts: Components
    f0: FloatArray
    pinned: npt.NDArray[np.bool_]
    lam: float | FloatArray | None
    sigma: float | None
    p: float | None
    weights: Weights | npt.ArrayLike | None
    max_iter: int | None
    options: Model

    @property
    def positions(self) -> FloatArray:
        """Centred positions of the vertices, (k, 3)."""
        assert self.graph.positions is not None
        return self.graph.positions

    @cached_property
    def noise(self) -> MeshNoise:
        """The noise along the normals, measured."""
        return measured(self.positions, self.faces, self.graph, self.parts)

    @cached_property
    def used(self) -> npt.NDArray[np.bool_]:
        """The components with a face, (c,) bool."""
        return self.parts.sums(np.diff(self.graph.indptr).astype(np.float64)) > 0

    @cached_property
    def edges(self) -> FloatArray:
        """Mean length of the edges of each component, (c,); 0 without edges."""
        u, x = self.graph.edge_rows(), self.positions if self.sigma is not None else self.noise.smooth
        lengths = np.linalg.norm(x[u] - x[self.graph.indices], axis=1)
        return self.parts.means(lengths, self.parts.labels[u])

    def filtered(self, filter: Filter) -> MeshDenoising:
        """Regularize the positions, or the normals of the faces and then fit the positions to them."""
        if filter == "positions":
            return self._positions()
        told = {**MODEL, **self.options}
        free = self.p is None and self.lam is None and self.weights is None and self.max_iter is None
        if free and all(told[name] == MODEL[name] for name in ("norm", "eps", "solver", "tol")):
            return self._in_rounds()
        return self._by_normals()

    def _of_parts(self) -> FloatArray:
        """Return the noise of each component, (c,): given, or measured."""
        if self.sigma is not None:
            return np.full(self.parts.count, self.sigma)
        return self.noise.parts

    def _in_rounds(self) -> MeshDenoising:
        """Denoise by rounds of guided normals until what is removed is no longer noise."""
        options = {name: self.options[name] for name in RUN if name in self.options}  # type: ignore[literal-required]
        sigma = self._of_parts()
        noisy = sigma > _NEGLIGIBLE * self.edges
        start = self.positions
        if self.sigma is None:
            # faces to a vertex far away would decide for others; smaller spikes are removed by the rounds
            start = np.where((self.noise.flying & ~self.pinned)[:, None], self.noise.smooth, start)
            noisy |= self.parts.sums(self.noise.spikes.astype(np.float64)) > 0
            sigma = np.nan_to_num(self.noise.local)
        else:
            sigma = sigma[self.parts.labels]
        with progress_bar(options.pop("progress", False), ROUNDS, "rounds") as report:
            found = denoised_in_rounds(
                start,
                self.faces,
                self.graph,
                self.parts,
                moves=~self.pinned & noisy[self.parts.labels],
                sigma=sigma,
                given=self.sigma is not None,
                report=report,
                **options,
            )
        value = self.f0 + (found.vertices - self.positions)
        return self._found(value, "normals", found.results, p=2.0, lam=0.0, rounds=found.rounds[self.used])

    def _positions(self) -> MeshDenoising:
        """Regularize the positions, each vertex by the noise around it."""
        p = 2.0 if self.p is None else self.p
        lam = self.lam
        if lam is None:
            sigma = np.full(len(self.f0), self.sigma) if self.sigma is not None else self.noise.local
            edges = self.edges[self.parts.labels]
            known = (sigma > 0) & (edges > 0)
            scale = np.where(known, edges, 1.0) ** (p - 1) * 2 ** (p - 3)
            lam = np.where(known, scale / np.where(known, sigma, 1.0), np.inf)
            if self.sigma is None:
                lam[self.noise.spikes] = 0.0
                return self._regularized("positions", p, _alike(lam), self.noise.smooth)
        return self._regularized("positions", p, _alike(lam))

    def values(self) -> MeshDenoising:
        """Regularize values other than positions, each vertex by the noise around it, and alike channels together."""
        if self.sigma is None and self.lam is None and self.weights is None:
            groups = alike_channels(self.f0, self.graph)
            if len(groups) > 1:
                return self._in_groups(groups)
        p = 1.0 if self.p is None else self.p
        labels, n = self.parts.labels, len(self.f0)
        noise = np.full(n, math.nan if self.sigma is None else self.sigma)
        unknown = self.used & (self.parts.sizes() < TELLING) & (self.sigma is None)
        far, smooth = np.zeros(n, bool), self.f0
        if self.sigma is None:
            noise, smooth, far = value_noise(self.f0, self.graph, self.parts, (self.used & ~unknown)[labels])
        lam = self.lam
        if lam is None:
            degree = self.parts.means(np.diff(self.graph.indptr).astype(np.float64))[labels]
            lam = fidelities_to_values(degree, noise, p, self.f0.shape[1])
            lam[far] = 0.0
            warn_unknown(unknown[self.used], LEFT)
        found = self._regularized("values", p, _alike(lam), smooth if self.lam is None else None)
        known = noise[~np.isnan(noise)]
        sigma = float(np.sqrt(np.mean(known**2))) if known.size else math.nan
        return replace(found, sigma=sigma, noise=noise, spikes=int(far.sum()), unknown=int(unknown.sum()))

    def _in_groups(self, groups: list[IntArray]) -> MeshDenoising:
        """Regularize groups of channels one after another."""
        sizes, value = [len(group) for group in groups], self.f0.copy()
        each = [replace(self, f0=self.f0[:, group]).values() for group in groups]
        for group, part in zip(groups, each, strict=True):
            value[:, group] = part.value
        return replace(
            each[0],
            value=value,
            results=tuple(result for part in each for result in part.results),
            sigma=float(mean_squares([np.array(part.sigma) for part in each], sizes)),
            noise=mean_squares([part.noise for part in each], sizes),
            spikes=max(part.spikes for part in each),
        )

    def _found(self, value: FloatArray, filter: str, results: Iterable[Result], **more: Any) -> MeshDenoising:
        sigma, measured = self.sigma, "noise" in self.__dict__
        if sigma is None:
            sigma = self.noise.whole if measured else math.nan
        unknown = np.isnan(self.noise.parts[self.used]) if measured and self.sigma is None else np.zeros(0, bool)
        warn_unknown(unknown, LEFT)
        sizes = self.edges[self.parts.labels[self.graph.edge_rows()]]
        return MeshDenoising(
            value=value,
            filter=filter,
            results=tuple(results),
            sigma=sigma,
            estimated=self.sigma is None,
            surface=self.surface,
            edge=float(sizes.mean()) if sizes.size else 0.0,
            noise=self.noise.local if measured else np.empty(0),
            spikes=int(self.noise.spikes.sum()) if measured else 0,
            components=int(self.used.sum()),
            unknown=int(unknown.sum()),
            **more,
        )

    def _regularized(
        self, name: str, p: float, lam: float | FloatArray, smooth: FloatArray | None = None
    ) -> MeshDenoising:
        """Regularize the function on the graph of the mesh; `smooth`, (k, m), is it without spikes or impulses.

        Each component is regularized around its median, over the range of its values: so the smoothing eps of the
        gradient norm is that of the component alone, whatever others and a few far values are.
        """
        f, results = self.f0, []
        if not np.all(np.isinf(lam)):
            f = f if smooth is None else np.where(self.pinned[:, None], f, smooth)
            middle, scale = self._frame(p)
            held = lam * scale[:, 0] ** (2 - p) if np.any(scale != 1) else lam
            held = np.where(self.pinned, math.inf, held) if self.pinned.any() else held
            options: Model = dict(self.options)  # type: ignore[assignment]
            if p != 2 and np.any(scale != 1) and resolve(options.get("solver", "jacobi")).smooths:
                options["eps"] = _EPS
            most = 100 if self.max_iter is None else self.max_iter
            results = [
                regularize(
                    (f - middle) / scale, self.graph, p=p, lam=held, weights=self.weights, max_iter=most, **options
                )
            ]
            f = middle + scale * results[0].value.astype(np.float64)
        return self._found(f, name, results, p=p, lam=lam)

    def _frame(self, p: float) -> tuple[FloatArray, FloatArray]:
        """Return for each vertex the median of its component, (k, m), and the range of its values, (k, 1)."""
        parts, f = self.parts, self.f0
        middle = f - parts.centred(f)
        scale = np.ones((len(f), 1))
        # given weights and eps are in the units of the data
        if self.options.get("eps") is not None or not isinstance(self.weights, Cotangent | None):
            return middle, scale
        found = np.linalg.norm([ranges(x, parts) for x in f.T], axis=0)
        whole = np.linalg.norm([parts.quantiles(x, 1.0) - parts.quantiles(x, 0.0) for x in f.T], axis=0)
        found = np.where(found > 0, found, np.where(whole > 0, whole, 1.0))
        if p == 2:
            # the result does not depend on the scale, but float32 has a smallest and a largest number
            found = 2.0 ** np.rint(np.log2(found))
        return middle, found[parts.labels][:, None]

    def _by_normals(self) -> MeshDenoising:
        """Fit the vertices to regularized normals, with the given fidelity or the default of each component.

        The default is multiplied by four while the vertices of a component move by more than noise would. With thin
        triangles, or few triangles on a round shape, the normals differ by shape and not by noise: a cylinder of 64
        vertices lost its whole volume.
        """
        lam = self.lam
        if lam is not None:
            return self._fitted(lam[self.faces].mean(axis=1) if isinstance(lam, np.ndarray) else lam)
        sigma = self._of_parts()
        of_face = self.parts.labels[self.faces[:, 0]]
        turned = noise_of_normals(
            face_normals(self.positions, self.faces), *adjacent_faces(self.faces), self.parts, of_face
        )
        rule = np.where(sigma > 0, [fidelity_to_normals(float(x)) for x in turned], np.inf)
        for _ in range(_TRIES + 1):
            found = self._fitted(_alike(rule[of_face]))
            moved = np.sqrt(self.parts.means(((found.value - self.f0) ** 2).sum(axis=1)))
            far = moved > BELIEVABLE * sigma
            if not far.any() or not found.results:
                break
            rule = np.where(far, 4 * rule, rule)
        return found

    def _fitted(self, lam: float | FloatArray) -> MeshDenoising:
        p = 1.0 if self.p is None else self.p
        normals, results = regularized_normals(
            self.positions,
            self.faces,
            lam,
            p=p,
            weights=self.weights,
            rounds=_ROUNDS if self.weights is None else 1,
            max_iter=_ITERATIONS if self.max_iter is None else self.max_iter,
            **self.options,
        )
        f = self.f0
        if results:
            moved = fitted_vertices(self.positions, self.faces, normals, ~self.pinned, _FIT)
            f = f + (moved - self.positions)
        return self._found(f, "normals", results, p=p, lam=lam)

    def taubin(self) -> MeshDenoising:
        """Alternate steps towards the mean of the neighbours and away from it."""
        f, results = self.positions, []
        options: Model = {**self.options, "solver": Jacobi(damping=1), "tol": None}
        for k in range(10 if self.max_iter is None else self.max_iter):
            results.append(regularize(f, self.graph, p=2, lam=0, weights=self.weights, max_iter=1, **options))
            step = TAUBIN[k % 2] * (results[-1].value - f)
            f = np.where(self.pinned[:, None], f, f + step)
        return self._found(self.f0 + (f - self.positions), "Taubin", results, p=2.0, lam=0.0)


def _alike(lam: float | FloatArray) -> float | FloatArray:
    """Return a single number if all are equal."""
    return float(lam[0]) if isinstance(lam, np.ndarray) and (lam == lam[0]).all() else lam
