"""Simplification: the whole chain, its links beside scikit-image and Higra, its growth, and what it saves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import gpureg as gr
from gpureg import backends
from gpureg.partition import edge_lengths, vertex_values

from .filters import psnr
from .growth import GROWN
from .iterations import NUMPY64
from .model import HOST, TOLERANCE, Bar, Case, Entry, Image, Setup, apart, missing, peer

WATERSHED = "scikit-image watershed and rag_mean_color"
HIGRA = "Higra's region graph"
PIXELS = "the same on pixels, same device"
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


def _simplify(device: str, image: Image, **settings: Any) -> gr.Regions:
    return gr.simplify_image(image, p=2, lam=0, max_iter=ITERATIONS, backend=device, **settings)


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
    """What regularizing regions instead of pixels saves, with the partition made before: the paper's claim."""
    side = setup.pick(512, 128, 24)
    image, name = _picture(setup, side)
    fine = gr.simplify_image(image, max_iter=0)
    grid = gr.GridGraph(image.shape, 1, "cityblock")
    h = 2 * float(np.median(fine.graph.distances(fine.models)))
    device = setup.devices[0]
    for p, iterations in ((2.0, ITERATIONS), (0.5, setup.pick(200, 50, 10))):
        settings: dict[str, Any] = {"p": p, "lam": 0.02, "max_iter": iterations, "backend": device}

        def on_pixels(settings: dict[str, Any] = settings) -> Image:
            return gr.regularize(image.astype(np.float32), grid, weights=gr.weights.patch(0, h), **settings).value

        def on_regions(settings: dict[str, Any] = settings) -> Image:
            return fine.regularized(weights="similarity", h=h, **settings).value

        def check(
            settings: dict[str, Any] = settings,
            on_regions: Callable[[], Image] = on_regions,
            on_pixels: Callable[[], Image] = on_pixels,
        ) -> tuple[bool, str]:
            values = fine.regularized(weights="similarity", h=h, **settings).values
            exact = fine.regularized(weights="similarity", h=h, **(settings | EXACT)).values
            good, said = apart(values, exact, TOLERANCE["float32"], NUMPY64)
            painted, other, clean = (x.astype(np.float64) for x in (on_regions(), on_pixels(), image))
            said += f"; PSNR {psnr(painted, other, 255.0):.1f} dB from that on pixels"
            return (
                good,
                f"{said}; {psnr(painted, clean, 255.0):.1f} and {psnr(other, clean, 255.0):.1f} from the picture",
            )

        yield Case(
            "simplify-speed-up",
            f"regularization of {fine.n_regions} regions and of {image.size} pixels, w2^0 with h = {h:.2f}",
            [
                Entry(PIXELS, on_pixels, is_peer=True),
                Entry(device, on_regions, check=check, transfers=HOST, note="painted; the partition is there"),
            ],
            [f"picture: {name}; lam = 0.02"],
            [Bar(PIXELS, 0.5)],
            f"p = {p:g}, {iterations} iterations",
            image.size,
        )
