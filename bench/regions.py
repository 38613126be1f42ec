"""Simplification: the whole chain, its links beside scikit-image and Higra, its growth, and what it saves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends
from gpureg.regions.partition import edge_lengths, vertex_values

from .filters import psnr
from .growth import GROWN
from .iterations import NUMPY64
from .model import HOST, Bar, Case, Entry, Image, Setup, apart, missing, peer

WATERSHED = "scikit-image watershed and rag_mean_color"
HIGRA = "Higra's region graph"
PIXELS = "on pixels"
# Relative. p < 1 is not convex: rounding decides which of two neighbours a region goes with. Measured 3e-4.
FLATTENED = 2e-3
EXACT: dict[str, Any] = {"backend": "numpy", "dtype": np.float64}
# Fig. 4: p = 2, w2^0, 30 iterations
ITERATIONS = 30


def _picture(setup: Setup, side: int) -> tuple[Image, str]:
    """Camera in 8 bits; tiled it gets noise of its own, so that no two tiles are alike."""
    clean, name = setup.picture(side)
    if name == "camera, tiled":
        clean = clean + np.random.default_rng(5).normal(0, 2, clean.shape)
        name += ", noise of standard deviation 2"
    return np.clip(np.rint(clean), 0, 255).astype(np.uint8), name


def _simplify(device: str, image: Image) -> gr.Regions:
    return gr.simplify_image(image, p=2, lam=0, max_iter=ITERATIONS, backend=device)


def _same(found: gr.Regions, image: Image) -> tuple[bool, str]:
    """Whether the labels are those of numpy, scipy's Dijkstra."""
    exact = _simplify("numpy", image)
    good = np.array_equal(found.labels, exact.labels)
    return good, f"{found.n_regions} regions, {'the' if good else 'NOT the'} labels of scipy's Dijkstra"


def _stages(device: str, image: Image) -> str:
    seconds = _simplify(device, image).seconds
    return ", ".join(f"{stage} {1000 * s:.0f}" for stage, s in seconds.items()) + " ms"


def chain(setup: Setup) -> Iterator[Case]:
    """A picture to its simplified one, beside what people do today: a watershed and a region graph of networkx."""
    side = setup.pick(512, 128, 24)
    image, name = _picture(setup, side)
    entries = []
    filters, segmentation, graphs = (peer(f"skimage.{part}") for part in ("filters", "segmentation", "graph"))
    if segmentation is None:
        entries.append(missing(WATERSHED))
    else:
        morphology, measure = peer("skimage.morphology"), peer("skimage.measure")

        def watershed() -> Any:
            seen = filters.gaussian(image.astype(np.float64), 0.75, preserve_range=True)
            extremal = morphology.local_minima(seen, connectivity=1) | morphology.local_maxima(seen, connectivity=1)
            labels = segmentation.watershed(filters.sobel(seen), measure.label(extremal, connectivity=1))
            return graphs.rag_mean_color(np.stack([image] * 3, axis=-1), labels, connectivity=1)

        entries.append(Entry(WATERSHED, watershed, is_peer=True, note="sources, partition and graph alone"))
    for device in setup.devices:
        if device == "numpy" and setup.size == "full":
            continue  # the oracle of the others

        def ours(device: str = device) -> Image:
            return _simplify(device, image).value

        def check(device: str = device) -> tuple[bool, str]:
            good, said = _same(_simplify(device, image), image)
            return good, f"{said}; {_stages(device, image)}"

        entries.append(Entry(device, ours, check=check, transfers=HOST))
    yield Case(
        "simplify",
        f"{side}x{side}, 8 bits: extrema, energy partition, region graph, means, {ITERATIONS} iterations, painted",
        entries,
        [f"picture: {name}"],
        [Bar(WATERSHED, 0.2)],
        f"{side}x{side}",
        image.size,
    )


def graph_of_labels(setup: Setup) -> Iterator[Case]:
    """The region graph alone, of one partition, beside Higra's."""
    side = setup.pick(512, 128, 24)
    image, name = _picture(setup, side)
    labels = gr.simplify_image(image, max_iter=0).labels
    rag = gr.region_graph(labels)
    higra, graphs = peer("higra"), peer("skimage.graph")
    entries = []
    if higra is None:
        entries.append(Entry(HIGRA, None, is_peer=True, note="not installed: pip install higra"))
    else:

        def by_higra() -> Any:
            grid = higra.get_4_adjacency_graph(labels.shape)
            return higra.make_region_adjacency_graph_from_labelisation(grid, labels.ravel())

        entries.append(Entry(HIGRA, by_higra, is_peer=True, note=f"{by_higra().num_edges()} borders, without lengths"))
    if graphs is None:
        entries.append(missing("scikit-image rag_mean_color"))
    else:
        colour = np.stack([image] * 3, axis=-1)
        entries.append(
            Entry(
                "scikit-image rag_mean_color",
                lambda: graphs.rag_mean_color(colour, labels, connectivity=1),
                is_peer=True,
            )
        )

    def check() -> tuple[bool, str]:
        crossing = (labels[1:] != labels[:-1]).sum() + (labels[:, 1:] != labels[:, :-1]).sum()
        good = rag.borders.sum() == 2 * crossing and rag.sizes.sum() == labels.size
        return bool(good), f"{rag.n_vertices} regions, {rag.n_edges // 2} borders, lengths that add up"

    entries.append(Entry("numpy", lambda: gr.region_graph(labels), check=check, transfers=HOST))
    yield Case(
        "region-graph",
        f"{side}x{side} labels to a region graph, with sizes, centroids and lengths of borders",
        entries,
        [f"labels: the partition of {name}"],
        [Bar(HIGRA, 1.0, on="numpy")],
        f"{side}x{side}",
        labels.size,
    )


def growth(setup: Setup) -> Iterator[Case]:
    """The whole chain by size: the best device of each backend."""
    for side in setup.pick((512, 1024, 2048, 4096), (64, 128, 256), (24, 37)):
        image, name = _picture(setup, side)
        entries = []
        for device in setup.best_of_each():
            if device == "numpy" and side > 512:
                continue

            def ours(device: str = device, image: Image = image) -> Image:
                return _simplify(device, image).value

            def check(device: str = device, image: Image = image, side: int = side) -> tuple[bool, str]:
                return _same(_simplify(device, image), image) if side <= 512 else _settled(image, device)

            entries.append(Entry(device, ours, check=check, transfers=HOST))
        yield Case(
            "growth-simplify",
            f"simplification by size: p = 2, {ITERATIONS} iterations, host to host",
            entries,
            [f"{name}; the best device of each backend"],
            [Bar(GROWN, 1.6, growth=True)],
            f"{side}x{side}",
            image.size,
        )


def _settled(image: Image, device: str) -> tuple[bool, str]:
    """Whether the partition is one where numpy cannot reach.

    No pixel's neighbour offers it less, and each pixel but a source's has its energy and its label from a neighbour.
    """
    grid = gr.GridGraph(image.shape, 1, "cityblock")
    lengths, _ = edge_lengths(vertex_values(image, grid), grid)
    seeds = gr.sources.extrema(image, grid, backend=device)
    found = backends.get(device, np.float32).influence_zones(grid, lengths, seeds.reshape(-1))
    mu, labels = (x.reshape(image.shape) for x in found)
    along = lengths.reshape(*image.shape, -1)
    least, given = True, (seeds >= 0) & (labels == seeds) & (mu == 0)
    for h, step in enumerate(grid.forward_offsets):
        start, end = grid.ends(step)
        rise, length, same = mu[end] - mu[start], along[..., h][start], labels[end] == labels[start]
        least &= bool((np.abs(rise) <= length).all())
        given[end] |= same & (rise == length) & (seeds[end] < 0)
        given[start] |= same & (rise == -length) & (seeds[start] < 0)
    return least and bool(given.all()), f"{seeds.max() + 1} zones: energies at rest, each pixel's from a neighbour"


def speed_up(setup: Setup) -> Iterator[Case]:
    """What regularizing regions instead of pixels saves, once the partition is there: the paper's claim.

    One energy on both: borders as weights and sizes in the fidelity make that of the regions the pixels' own (G_0,
    every edge by itself), taken at pictures that are constant on each region.
    """
    side = setup.pick(512, 128, 24)
    image, name = _picture(setup, side)
    grid = gr.GridGraph(image.shape, 1, "cityblock")
    most = setup.pick(20_000, 2000, 50)
    fixed = setup.pick(200, 50, 10)
    jobs: list[tuple[float, float, dict[str, Any], str, Any, float | None]] = [
        (2.0, 0.05, {"tol": 1e-4, "max_iter": most}, "p = 2 to 1e-4", "extrema", 0.5),
        (0.5, 0.2, {"max_iter": fixed}, f"p = 0.5, {fixed} iterations", "extrema", None),
        (0.5, 0.2, {"max_iter": fixed}, f"p = 0.5, {fixed} iterations", setup.pick(8, 8, 4), 0.5),
    ]
    for p, lam, course, label, sources, bar in jobs:
        fine = gr.simplify_image(image, max_iter=0, sources=sources)
        assert fine.graph.sizes is not None
        entries = []
        for device in setup.best_of_each():
            if device == "numpy" and p == 2:
                continue  # thousands of iterations
            settings: dict[str, Any] = {"p": p, "norm": "edge", "backend": device, **course}

            regions = {"lam": lam, "weights": "border", "by_size": True} | settings
            pixels = {"lam": lam / float(fine.graph.sizes.mean())} | settings

            def on_pixels(settings: dict[str, Any] = pixels) -> Image:
                return gr.regularize(image.astype(np.float32), grid, **settings).value

            def on_regions(settings: dict[str, Any] = regions, fine: gr.Regions = fine) -> gr.Regions:
                return fine.regularized(**settings)

            def check(
                settings: dict[str, Any] = regions,
                on_regions: Callable[[], gr.Regions] = on_regions,
                on_pixels: Callable[[], Image] = on_pixels,
            ) -> tuple[bool, str]:
                found, other = on_regions(), on_pixels()
                assert found.result is not None
                exact = found.regularized(**(settings | EXACT))
                good, said = apart(found.values, exact.values, FLATTENED, NUMPY64)
                clean, painted = image.astype(np.float64), found.value.astype(np.float64)
                said += (
                    f"; {found.result.iterations} iterations; PSNR {psnr(painted, other, 255.0):.1f} dB from that on"
                )
                said += (
                    f" pixels; {psnr(painted, clean, 255.0):.1f} and {psnr(other, clean, 255.0):.1f} from the picture"
                )
                return good, said

            entries.append(Entry(f"{PIXELS}, {device}", on_pixels, is_peer=True))
            entries.append(Entry(device, lambda run=on_regions: run().value, check=check, transfers=HOST))
        best = setup.best_of_each()[0]
        yield Case(
            "simplify-speed-up",
            "regularization of regions, painted, beside that of their pixels: one energy; the partition is there",
            entries,
            [f"picture: {name}, {image.size} pixels; lam = {lam:g} over the mean size of a region"],
            [] if bar is None else [Bar(f"{PIXELS}, {best}", bar)],
            f"{fine.n_regions} regions, {label}",
            image.size,
        )
