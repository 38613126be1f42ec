"""What the parsers of mesh files find, and the mesh that is made of it: :class:`Contents`."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .beside import KEY, Beside, Told
from .polygons import triangulated

CHANNELS = ("red", "green", "blue", "alpha")


class Fault(ValueError):
    """A file is damaged; the message says where."""


def same_rows(rows: npt.NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Number equal rows, (m, k), in the order in which they come first; return the first rows and the numbers, (m,)."""
    order = np.lexsort(rows.T[::-1])
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    first = order[new]  # the sort is stable
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    number = np.empty(len(rows), np.int64)
    number[order] = rank[np.cumsum(new) - 1]
    return np.sort(first), number


def numbers_of(text: str, dtype: type[np.generic]) -> npt.NDArray[Any]:
    """Convert words to numbers; raise Fault if some are not."""
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*could not be read to its end.*")
        try:
            return np.fromstring(text, dtype, sep=" ")
        except (ValueError, DeprecationWarning):
            raise Fault("it has words that are not numbers") from None


@dataclass
class Contents:
    """What a file has: n vertices, P polygons with c corners in all.

    Attributes
    ----------
    vertices : (n, 3) float array
    sizes : (P,) int array
    corners : (c,) int array
        The vertices of the polygons, one polygon after the other.
    dtype : numpy.dtype
        Type of the coordinates in the file.
    at_vertices, of_faces : dict of arrays (n, ...) and (P, ...)
        Numbers by name; colours are named "colours", (n, 3 or 4) uint8.
    uv : (m, 2) float array or None
        Places in the texture, at the vertices if `uv_of` is None.
    uv_of : (c,) int array or None
        The place of each corner.
    normals : (k, 3) float array or None
        At the vertices if `normal_of` is None.
    normal_of : (c,) int array or None
    names, comments, libraries, units, materials
        As in :class:`Beside`.
    told : Told
        What was not read.
    """

    vertices: FloatArray
    sizes: IntArray
    corners: IntArray
    dtype: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float64))
    at_vertices: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    of_faces: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    uv: FloatArray | None = None
    uv_of: IntArray | None = None
    normals: FloatArray | None = None
    normal_of: IntArray | None = None
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    comments: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    units: str | None = None
    materials: tuple[Any, ...] = ()
    told: Told = field(default_factory=Told)

    def assembled(self) -> Any:
        """Make a trimesh.Trimesh with all data, and what it has no place for as :class:`Beside` in its metadata."""
        import trimesh

        self._without_short()
        n = len(self.vertices)
        if len(self.corners) and not (0 <= self.corners.min() and self.corners.max() < n):
            wrong = self.corners[(self.corners < 0) | (self.corners >= n)][0]
            raise Fault(f"faces must name vertices 0..{n - 1}, got {wrong}")
        at = triangulated(self.vertices, self.sizes, self.corners)
        polygon = np.repeat(np.arange(len(self.sizes)), self.sizes)[at[:, 0]]
        if self.normals is not None and self.normal_of is None:
            # copies of a vertex with one normal, as at the seam of a texture, share it
            rows = np.concatenate([self.vertices, self.normals], axis=1)
            first, number = same_rows(rows)
            self.normals, self.normal_of = self.normals[first], number[self.corners]
        copies, uv = self._split()
        vertices, faces = self.vertices[copies], self.corners[at]
        # a trimesh has colours at vertices, of faces, or a texture: channels of others are numbers like any
        colours: dict[str, Any] = {}
        if uv is None and "colours" in self.at_vertices:
            colours["vertex_colors"] = self.at_vertices.pop("colours")[copies]
        elif uv is None and "colours" in self.of_faces:
            colours["face_colors"] = self.of_faces.pop("colours")[polygon]
        for data in (self.at_vertices, self.of_faces):
            if "colours" in data:
                data |= dict(zip(CHANNELS, data.pop("colours").T, strict=False))
        mesh = trimesh.Trimesh(vertices=vertices, faces=faces, process=False, **colours)
        if uv is not None or (self.materials and not colours):
            mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=next(iter(self.materials), None))
        mesh.vertex_attributes.update({name: x[copies] for name, x in self.at_vertices.items()})
        mesh.face_attributes.update({name: x[polygon] for name, x in self.of_faces.items()})
        mesh.metadata[KEY] = Beside(
            vertices,
            self.sizes,
            self.corners,
            at,
            copies,
            self.normals,
            self.normal_of,
            self.names,
            self.comments,
            self.libraries,
            self.units,
            self.materials,
        )
        return mesh

    def _without_short(self) -> None:
        """Leave out polygons with fewer than three corners."""
        short = self.sizes < 3
        if not short.any():
            return
        self.told.lost.append(f"{short.sum()} faces with fewer than three corners")
        keep = np.repeat(~short, self.sizes)
        self.corners, self.sizes = self.corners[keep], self.sizes[~short]
        self.uv_of, self.normal_of = (None if x is None else x[keep] for x in (self.uv_of, self.normal_of))
        self.of_faces = {name: x[~short] for name, x in self.of_faces.items()}

    def _split(self) -> tuple[IntArray, FloatArray | None]:
        """Repeat vertices with several places in the texture, after all others; change `corners`.

        Return the vertex of the file of each vertex, and their places.
        """
        n = len(self.vertices)
        if self.uv is None or self.uv_of is None:
            return np.arange(n), self.uv
        missing = int((self.uv_of < 0).sum())
        if missing:
            self.told.notes.append(f"{missing} corners have no place in the texture: they are at (0, 0)")
            self.uv = np.concatenate([self.uv, np.zeros((1, 2))])
            self.uv_of = np.where(self.uv_of < 0, len(self.uv) - 1, self.uv_of)
        # equal places are one, whatever their numbers
        one, equal = same_rows(self.uv)
        uv = self.uv[one]
        pairs = np.stack([self.corners, equal[self.uv_of]], axis=1)
        found, first, number = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
        # the first place of a vertex in the file stays with it
        order = np.lexsort((first, found[:, 0]))
        again = np.zeros(len(found), bool)
        again[order[1:]] = found[order[1:], 0] == found[order[:-1], 0]
        new = found[:, 0].copy()
        extra = np.flatnonzero(again)
        extra = extra[np.argsort(first[extra])]
        new[extra] = n + np.arange(len(extra))
        copies = np.concatenate([np.arange(n), found[extra, 0]])
        places = np.zeros((len(copies), 2))
        places[new] = uv[found[:, 1]]
        self.corners = new[number.ravel()]
        return copies, places
