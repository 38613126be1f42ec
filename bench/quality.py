"""PSNR of ``denoise_image`` without parameters against scikit-image's filters tuned by an oracle.

    export GPUREG_DATA=...                     # the folder of test data: its pictures
    python -m bench.quality                    # everything, about half an hour, most of it the peers' tuning
    python -m bench.quality --peers peers.json # reads what is there, computes and adds what is not: may be interrupted
    python -m bench.quality --only camera --sigma 20 --json out.json

Pictures hold float64 in [0, 255]. The noise is ``default_rng(0).standard_normal(shape) * sigma``; nothing is clipped,
neither the noisy picture nor a result, and the PSNR is that of a range of 255.

scikit-image's filters are told the true sigma where they take one, and every other parameter is chosen by the true
PSNR, by coordinate ascent on the grids below, for each picture and each sigma anew. Ours choose by themselves. The
bilateral filter gets the picture raised to positive values and replicated borders; nonlocal means in slow mode is tuned
on the 256 x 256 pixels of the picture's middle, the others on the whole. Wavelet shrinkage (with PyWavelets; plain, and
averaged over 16 shifts) is told, but is no filter of this kind: it is not part of "best of scikit-image".
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import gpureg as gr
from gpureg.files.pictures import read_picture, write_atomically

from . import machine
from .model import NEEDS_DATA, data, peer

Image = npt.NDArray[np.float64]
Settings = dict[str, Any]
Rows = dict[str, dict[str, dict[str, Any]]]

PICTURES = {
    "camera": "camera.png",
    "house": "set12_02_house.png",
    "coins": "coins.png",
    "brick": "brick.png",
    "astronaut": "astronaut.png",
    "kodim08": "kodim08.png",
    "kodim19": "kodim19.png",
    "bsd68_003": "bsd68_003.png",
    "bsd68_033": "bsd68_033.png",
    "bsd68_044": "bsd68_044.png",
}
SIGMAS = (10, 20, 40)

# Side of the part on which a slow filter is tuned.
MIDDLE = 256


def picture(name: str) -> Image:
    """One of the pictures, grey (y, x) or colour (y, x, 3)."""
    path = data("images", PICTURES[name])
    if path is None:
        raise FileNotFoundError(f"no picture {PICTURES[name]}: {NEEDS_DATA}")
    return np.asarray(read_picture(path).pixels, np.float64)


def noisy_of(clean: Image, sigma: float) -> Image:
    """The picture with its noise."""
    return clean + np.random.default_rng(0).standard_normal(clean.shape) * sigma


def psnr(value: Image, clean: Image) -> float:
    """Peak signal-to-noise ratio in dB, of a range of 255."""
    return 10 * math.log10(255**2 / float(np.mean((value - clean) ** 2)))


def climb(grid: Mapping[str, Sequence[Any]], quality: Callable[[Settings], float]) -> Settings:
    """Coordinate ascent on a grid, from its middle: neighbours along each axis in turn, until none is better."""
    axes = {name: list(values) for name, values in grid.items()}
    at = {name: len(values) // 2 for name, values in axes.items()}
    known: dict[tuple[int, ...], float] = {}

    def look(place: Mapping[str, int]) -> float:
        key = tuple(place.values())
        if key not in known:
            known[key] = quality({name: axes[name][k] for name, k in place.items()})
        return known[key]

    improved = True
    while improved:
        improved = False
        for name in axes:
            for step in (1, -1):
                while 0 <= at[name] + step < len(axes[name]):
                    there = {**at, name: at[name] + step}
                    if look(there) <= look(at):
                        break
                    at, improved = there, True
    return {name: axes[name][k] for name, k in at.items()}


Filter = Callable[..., Image]
"""Of the noisy picture in [0, 1], its noise, its channel axis, and settings."""


def _nl_means(noisy: Image, sigma: float, axis: int | None, *, slow: bool = False, h: float, **sizes: int) -> Image:
    from skimage.restoration import denoise_nl_means

    return denoise_nl_means(noisy, h=h * sigma, sigma=sigma, fast_mode=not slow, channel_axis=axis, **sizes)


def _slow_nl_means(noisy: Image, sigma: float, axis: int | None, **settings: Any) -> Image:
    return _nl_means(noisy, sigma, axis, slow=True, **settings)


def _tv_chambolle(noisy: Image, sigma: float, axis: int | None, *, weight: float) -> Image:
    from skimage.restoration import denoise_tv_chambolle

    return denoise_tv_chambolle(noisy, weight * sigma, eps=1e-5, max_num_iter=500, channel_axis=axis)


def _tv_bregman(noisy: Image, sigma: float, axis: int | None, *, weight: float) -> Image:
    from skimage.restoration import denoise_tv_bregman

    return denoise_tv_bregman(noisy, weight / sigma, eps=1e-4, channel_axis=axis)


def _bilateral(noisy: Image, sigma: float, axis: int | None, *, sigma_color: float, sigma_spatial: float) -> Image:
    from skimage.restoration import denoise_bilateral

    raised = 0.01 - float(noisy.min())
    settings = dict(sigma_color=sigma_color * sigma, sigma_spatial=sigma_spatial, mode="edge", channel_axis=axis)
    return denoise_bilateral(noisy + raised, **settings) - raised


def _wavelet(noisy: Image, sigma: float, axis: int | None, *, method: str, share: float, wavelet: str) -> Image:
    from skimage.restoration import denoise_wavelet

    settings = dict(method=method, sigma=share * sigma, wavelet=wavelet, channel_axis=axis)
    return denoise_wavelet(noisy, convert2ycbcr=axis is not None, rescale_sigma=True, **settings)


def _shifted_wavelet(noisy: Image, sigma: float, axis: int | None, **settings: Any) -> Image:
    from skimage.restoration import cycle_spin

    def denoise(image: Image) -> Image:
        return _wavelet(image, sigma, axis, **settings)

    return cycle_spin(noisy, denoise, max_shifts=3, channel_axis=axis, workers=1)


def _steps(low: float, ratio: float, count: int) -> list[float]:
    return [round(low * ratio**k, 4) for k in range(count)]


# h, weight (that of Bregman: 1/weight) and sigma_color are in sigma.
_NL_MEANS = {"patch_size": [3, 5, 7, 9], "patch_distance": [4, 6, 8, 11], "h": _steps(0.3, 1.08, 21)}
_WAVELET = {
    "method": ["VisuShrink", "BayesShrink"],
    "wavelet": ["db1", "db2", "sym4", "sym8"],
    "share": _steps(0.4, 1.16, 13),
}
PEERS: dict[str, tuple[Filter, Mapping[str, Sequence[Any]]]] = {
    "nl_means fast": (_nl_means, _NL_MEANS),
    "tv_chambolle": (_tv_chambolle, {"weight": _steps(0.2, 1.1, 28)}),
    "tv_bregman": (_tv_bregman, {"weight": _steps(0.3, 1.15, 24)}),
    "bilateral": (
        _bilateral,
        {"sigma_spatial": [0.7, 1.0, 1.4, 2.0, 2.8, 4.0], "sigma_color": _steps(0.5, 1.25, 16)},
    ),
    "wavelet": (_wavelet, _WAVELET),
    "wavelet, shifts": (_shifted_wavelet, _WAVELET),
    "nl_means slow": (_slow_nl_means, _NL_MEANS),
}
"""Every filter of scikit-image with what it may choose from; the slow ones last."""

SLOW = {"nl_means slow"}
OTHER_KIND = {"wavelet", "wavelet, shifts"}
JUDGED = tuple(who for who in PEERS if who not in OTHER_KIND)


def tuned(who: str, clean: Image, noisy: Image, sigma: float) -> dict[str, Any]:
    """A peer's PSNR at the settings that give the best one, these settings, and the seconds of that one call."""
    apply, grid = PEERS[who]
    axis = 2 if clean.ndim == 3 else None
    middle = tuple(
        slice(max(0, (side - MIDDLE) // 2), max(0, (side - MIDDLE) // 2) + MIDDLE) if who in SLOW else slice(None)
        for side in clean.shape[:2]
    )

    def quality(settings: Settings) -> float:
        return psnr(255 * apply(noisy[middle] / 255, sigma / 255, axis, **settings), clean[middle])

    best = climb(grid, quality)
    begin = time.perf_counter()
    value = 255 * apply(noisy / 255, sigma / 255, axis, **best)
    return {"psnr": psnr(value, clean), "settings": best, "seconds": time.perf_counter() - begin}


OURS: dict[str, Callable[[Image, float, int | None], Image]] = {
    "ours": lambda noisy, sigma, axis: gr.denoise_image(noisy, channel_axis=axis),
    "ours, sigma given": lambda noisy, sigma, axis: gr.denoise_image(noisy, sigma=sigma, channel_axis=axis),
}
"""What is compared with the peers: of the noisy picture, the true sigma and the channel axis. The first is judged."""


def installed(who: str) -> bool:
    """Whether what a peer needs is there."""
    return peer("skimage") is not None and (who not in OTHER_KIND or peer("pywt") is not None)


def measure(
    names: Sequence[str], sigmas: Sequence[float], peers: Sequence[str], rows: Rows, save: Callable[[], None]
) -> Rows:
    """Fill `rows` with the peers that are missing, saving after each, and return a copy with our columns."""
    report: Rows = {}
    for name in names:
        clean = picture(name)
        axis = 2 if clean.ndim == 3 else None
        for sigma in sigmas:
            noisy = noisy_of(clean, sigma)
            row = rows.setdefault(f"{name} {sigma:g}", {})
            for who in peers:
                if who not in row and installed(who):
                    row[who] = tuned(who, clean, noisy, sigma)
                    print(f"{name} {sigma:g}, {who}: {row[who]}", file=sys.stderr, flush=True)
                    save()
            line = {"noisy": {"psnr": psnr(noisy, clean)}, **row}
            for who, denoise in OURS.items():
                begin = time.perf_counter()
                value = denoise(noisy, sigma, axis)
                line[who] = {"psnr": psnr(value, clean), "seconds": time.perf_counter() - begin}
            report[f"{name} {sigma:g}"] = line
    return report


def best_peer(line: Mapping[str, Mapping[str, Any]]) -> tuple[str, float] | None:
    """The best filter of scikit-image in a row and its PSNR; None where the row has none."""
    found = [(who, float(line[who]["psnr"])) for who in JUDGED if who in line]
    return max(found, key=lambda pair: pair[1], default=None)


def markdown(report: Rows) -> str:
    """The table, the judged column's difference in each row, and the worst and the mean of these."""
    ours = list(OURS)
    columns = ["noisy", *PEERS, *ours]
    header = ["picture", "sigma", *columns, "best of scikit-image", f"{ours[0]} - best"]
    lines = [f"| {' | '.join(header)} |", "|---|" + "---:|" * (len(header) - 3) + "---|---:|"]
    differences = {}
    for key, line in report.items():
        best = best_peer(line)
        cells = [f"{line[who]['psnr']:.2f}" if who in line else "-" for who in columns]
        if best is None:
            cells += ["-", "-"]
        else:
            differences[key] = line[ours[0]]["psnr"] - best[1]
            cells += [f"{best[1]:.2f} {best[0]}", f"{differences[key]:+.2f}"]
        lines.append(f"| {' | '.join([*key.rsplit(' ', 1), *cells])} |")
    if differences:
        worst = min(differences, key=differences.__getitem__)
        mean = sum(differences.values()) / len(differences)
        lines += [
            "",
            f"{ours[0]} - best of scikit-image: worst {differences[worst]:+.2f} dB ({worst}), mean {mean:+.2f} dB",
        ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", metavar="SUBSTRING", default="", help="pictures whose name contains it")
    parser.add_argument("--sigma", type=float, action="append", help="once or several times; default 10, 20 and 40")
    parser.add_argument(
        "--filters", metavar="SUBSTRING", default="", help="filters of scikit-image with it in their name"
    )
    parser.add_argument("--peers", type=Path, metavar="FILE", help="keeps the peers' results: read, completed, written")
    parser.add_argument("--json", type=Path, metavar="FILE", help="where the whole report goes")
    wanted = parser.parse_args(arguments)
    names = [name for name in PICTURES if wanted.only in name]
    if not names:
        parser.error(f"no picture has {wanted.only!r} in its name; there are {', '.join(PICTURES)}")
    if missing := [name for name in names if data("images", PICTURES[name]) is None]:
        parser.error(f"there is no picture {', '.join(missing)}: {NEEDS_DATA}")
    kept: Path | None = wanted.peers
    rows: Rows = json.loads(kept.read_text("utf-8")) if kept is not None and kept.exists() else {}

    def write(path: Path, what: Any) -> None:
        write_atomically(path, lambda temporary: temporary.write_text(json.dumps(what, indent=1), "utf-8"))

    about = machine.describe()
    chosen = [who for who in PEERS if wanted.filters in who]
    save = functools.partial(write, kept, rows) if kept is not None else lambda: None
    report = measure(names, wanted.sigma or SIGMAS, chosen, rows, save)
    if wanted.json is not None:
        write(wanted.json, {"machine": about, "rows": report})
    print(f"- {about['date']}, {about['cpu']}, {about['cores']} cores, {about['system']}")
    print(f"- {', '.join(f'{name} {version}' for name, version in about['versions'].items())}")
    print(f"- ours on {next(iter(about['devices'].values()), 'numpy')}\n")
    print(markdown(report))
    return 0


if __name__ == "__main__":
    sys.exit(main())
