"""What a mesh file has beside the data of a trimesh.Trimesh: :class:`Beside`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..arrays import FloatArray, IntArray
from ..shapes.carried import Split
from ..shapes.renewed_normals import side_of, summed_areas, unit

# Its name among the metadata of a trimesh.Trimesh.
KEY = "of the file"


@dataclass
class Told:
    """What a file has no place for, or was not read, as nouns, and other notes, as sentences."""

    lost: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def lines(self, begin: str) -> list[str]:
        """Return all as sentences; the first begins with these words if something is lost."""
        return [*([f"{begin} {', '.join(self.lost)}"] if self.lost else []), *self.notes]


@dataclass(frozen=True, eq=False)
class Beside:
    """What a file has beside the data of a trimesh.Trimesh of n vertices and F triangles.

    Attributes
    ----------
    vertices : (n, 3) float array
        The vertices as they were read.
    sizes : (P,) int array
        Numbers of corners of the polygons.
    corners : (c,) int array
        Their vertices, one polygon after the other.
    at : (F, 3) int array
        The corner of a polygon that each corner of a triangle is.
    copies : (n,) int array
        The vertex of the file that each vertex is; those at the seam of a texture are repeated.
    normals : (m, 3) float array or None
        The normals of the file.
    normal_of : (c,) int array or None
        The normal at each corner.
    names : dict of tuples of str
        For data of faces that are numbers of names, such as material, group or object: the names.
    comments : tuple of str
    libraries : tuple of str
        Files of materials.
    units : str or None
    materials : tuple
        Objects of trimesh, numbered by the data "material" of faces.
    """

    vertices: FloatArray
    sizes: IntArray
    corners: IntArray
    at: IntArray
    copies: IntArray
    normals: FloatArray | None = None
    normal_of: IntArray | None = None
    names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    comments: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    units: str | None = None
    materials: tuple[Any, ...] = ()

    def __deepcopy__(self, memo: Any) -> Beside:
        # it does not change: copies of a mesh share it
        return self

    def fits(self, faces: Any) -> bool:
        """Return whether these are the triangles that it belongs to."""
        return np.array_equal(self.corners[self.at], faces)

    @property
    def first(self) -> IntArray:
        """The first triangle of each polygon, (P,)."""
        polygon = np.repeat(np.arange(len(self.sizes)), self.sizes)[self.at[:, 0]]
        return np.unique(polygon, return_index=True)[1]

    def normals_of(self, vertices: FloatArray) -> tuple[FloatArray | None, IntArray | None]:
        """Return the normals, (m, 3), and that of each corner, (c,); computed again if the vertices have moved.

        Corners at one vertex with the same old normal are on one side of a crease, and have the same new normal.
        """
        if self.normals is None or self.normal_of is None or np.array_equal(vertices, self.vertices, equal_nan=True):
            return self.normals, self.normal_of
        keys = np.stack([self.copies[self.corners], self.normal_of], axis=1)
        found, items = np.unique(keys, axis=0, return_inverse=True)
        items = items.ravel()
        faces, at = self.corners[self.at], items[self.at]
        before, now = (summed_areas(v, faces, at, len(found)) for v in (self.vertices, vertices))
        given = self.normals[found[:, 1]]
        renewed = side_of(given, before) * unit(now)
        return np.where((now != 0).any(axis=1)[:, None], renewed, given), items

    def carried_to(self, split: Split) -> tuple[Beside, list[str]]:
        """Return what is left for a simplified mesh, and what was lost, in words."""
        carried, faces = split.carried, split.faces
        least = replace(
            self,
            vertices=split.vertices,
            sizes=np.full(len(faces), 3),
            corners=faces.ravel(),
            at=np.arange(faces.size).reshape(-1, 3),
            copies=split.copies,
            normals=None,
            normal_of=None,
        )
        many = int((self.sizes > 3).sum())
        lost = [f"{many} polygons of more than three corners, which are triangles now"] if many else []
        if self.normals is None or self.normal_of is None:
            return least, lost
        # corners at one vertex with one normal are on one side of a crease
        old = self.normal_of[self.at]
        corners = carried.corners
        keys, items = np.unique(
            np.stack([carried.which[corners].ravel(), old.ravel()], axis=1), axis=0, return_inverse=True
        )
        place = np.full(len(keys), -1)
        place[items.ravel()] = carried.labels[corners].ravel()
        items = items.reshape(-1, 3)
        side = carried.sides(items, place)
        _, normal_of = np.unique(side[items[carried.origin]], return_inverse=True)
        count = int(normal_of.max()) + 1
        before = summed_areas(self.vertices, corners, old, len(self.normals))
        sums = summed_areas(split.vertices, faces, normal_of.reshape(-1, 3), count)
        normals = side_of(self.normals, before) * unit(sums)
        return replace(least, normals=normals, normal_of=normal_of.ravel()), lost
