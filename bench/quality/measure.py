"""The measurement: PSNR and seconds of every method, by scene, sigma and seed; what is known is not computed again."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .methods import OURS, PEERS, Noisy, apply, settings_of, takes
from .scenes import SCENES, noisy_of, psnr

Draws = dict[str, dict[str, Any]]
"""What a method reached, by seed: "psnr", "seconds", "run" (when that run began), "settings" of a tuned filter."""
Rows = dict[str, dict[str, Draws]]
"""Methods by the row's name, a scene and its sigma."""


@dataclass
class Run:
    """What is asked for.

    Attributes
    ----------
    name : str
        When the run began: seconds measured in another one are marked.
    seeds : int
        Draws of noise.
    peers : sequence of str
        Those that are wanted.
    rows : dict
        The peers' results that are known; filled.
    save : callable
        Called after each result of a peer.
    again : bool
        Whether a peer whose result is of another run is called once more, on the first draw, for its seconds.
    """

    name: str
    seeds: int
    peers: Sequence[str] = PEERS
    rows: Rows = field(default_factory=dict)
    save: Callable[[], None] = lambda: None
    again: bool = False
    _warm: set[tuple[str, str]] = field(default_factory=set)

    def measure(self, name: str, sigma: float) -> dict[str, Any]:
        """A row of the report: the scene's group and size, and the draws of each method."""
        scene = SCENES[name]
        clean = scene.clean()
        known = self.rows.setdefault(f"{name} {sigma:g}", {})
        found: dict[str, Draws] = {"noisy": {}}
        for seed in range(min(self.seeds, scene.seeds)):
            noisy = Noisy(noisy_of(clean, sigma, seed), clean, sigma, scene.group)
            found["noisy"][str(seed)] = {"psnr": psnr(noisy.values, clean)}
            for who in PEERS:
                if who in self.peers and takes(who, scene.group):
                    self._peer(who, noisy, seed, known.setdefault(who, {}), f"{name} {sigma:g}")
                if str(seed) in known.get(who, {}):
                    found.setdefault(who, {})[str(seed)] = known[who][str(seed)]
            for who in OURS:
                found.setdefault(who, {})[str(seed)] = self._ours(who, noisy)
        return {"scene": name, "sigma": sigma, "group": scene.group, "shape": list(clean.shape), "methods": found}

    def _peer(self, who: str, noisy: Noisy, seed: int, draws: Draws, row: str) -> None:
        """Complete what is known of a peer. Its settings are chosen on the first draw and serve for the others."""
        if str(seed) in draws and not (self.again and seed == 0 and draws["0"]["run"] != self.name):
            return
        settings = next((draw["settings"] for draw in draws.values() if "settings" in draw), None)
        if settings is None:
            settings = settings_of(who, noisy)
        value, seconds = apply(who, noisy, settings)
        draws[str(seed)] = {"psnr": psnr(value, noisy.clean), "seconds": seconds, "run": self.name}
        if settings:
            draws[str(seed)]["settings"] = settings
        print(f"{row}, seed {seed}, {who}: {draws[str(seed)]}", file=sys.stderr, flush=True)
        self.save()

    def _ours(self, who: str, noisy: Noisy) -> dict[str, Any]:
        """One of our methods; the first call on each kind of image builds kernels and is not timed."""
        if (who, noisy.group) not in self._warm:
            apply(who, noisy, {})
            self._warm.add((who, noisy.group))
        value, seconds = apply(who, noisy, {})
        return {"psnr": psnr(value, noisy.clean), "seconds": seconds, "run": self.name}


def reached(row: dict[str, Any], who: str) -> float | None:
    """Mean PSNR of a method over the draws of a row; None where it has not all of them."""
    draws = row["methods"].get(who, {})
    if len(draws) < len(row["methods"]["noisy"]):
        return None
    return float(np.mean([draws[seed]["psnr"] for seed in row["methods"]["noisy"]]))


def taken(row: dict[str, Any], who: str) -> tuple[float, str] | None:
    """Least seconds of a method over the draws of the latest run that measured it, and this run."""
    draws = [draw for draw in row["methods"].get(who, {}).values() if "seconds" in draw]
    if not draws:
        return None
    latest = max(draw["run"] for draw in draws)
    return min(draw["seconds"] for draw in draws if draw["run"] == latest), latest
